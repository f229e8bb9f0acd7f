"""Libraries that are not installed with meshpoint itself."""

from __future__ import annotations

import importlib
from typing import Any

from meshpoint.base.errors import CommandError


def needed(module: str, extra: str) -> Any:
    """A module of an extra. CommandError where it is not installed, with what installs it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise CommandError(
            f"{module} is not installed: pip install 'meshpoint[{extra}]'"
        ) from error
