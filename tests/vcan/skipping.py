"""Tests that need something of the machine are skipped with the reason where it has not got it."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest


def tools_missing(tools: Sequence[str]) -> str | None:
    """Which of these programs are not installed, in words."""
    missing = [tool for tool in tools if shutil.which(tool) is None]
    return f"not installed: {', '.join(missing)} (can-utils, iproute2)" if missing else None


def skip_below(folder: Path, items: list[pytest.Item], reason: str | None) -> None:
    """Skips what is in the folder; nothing without a reason."""
    if reason is None:
        return
    for item in items:
        if folder in item.path.parents:
            item.add_marker(pytest.mark.skip(reason=reason))
