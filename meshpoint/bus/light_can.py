"""python-can without asammdf.

python-can loads asammdf, and pandas with it, wherever they are installed: two seconds of processor
time for every command, of which only one that reads an MF4 log has any use.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType


def load_can() -> None:
    """Loads python-can as if asammdf were not installed, unless it is loaded already."""
    if "can" in sys.modules or "asammdf" in sys.modules:
        return
    sys.modules["asammdf"] = None  # type: ignore[assignment]  # Python's own mark: not to be had
    try:
        importlib.import_module("can")
    finally:
        del sys.modules["asammdf"]


def mf4_module() -> ModuleType:
    """python-can's MF4 module with asammdf, where that is installed."""
    module = importlib.import_module("can.io.mf4")
    if module.asammdf is None:
        module = importlib.reload(module)
    return module
