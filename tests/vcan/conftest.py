"""Tests on a real SocketCAN bus: run them by `make vcan`, or where vcan0 is up with mtu 72."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

TOOLS = ("candump", "cansend", "cangen", "ip")


def why_not() -> str | None:
    """What is missing here, in words."""
    try:
        mtu = int(Path("/sys/class/net/vcan0/mtu").read_text())
    except OSError:
        return "no vcan0 here; `make vcan` runs these tests, in an emulated machine if need be"
    if mtu != 72:
        return f"vcan0 has mtu {mtu}, CAN FD needs 72"
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    return f"not installed: {', '.join(missing)} (can-utils, iproute2)" if missing else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skips with the reason where there is no such bus."""
    reason = why_not()
    if reason is None:
        return
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.skip(reason=reason))
