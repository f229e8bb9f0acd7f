"""Tests on emulated CAN controllers with their real Linux drivers: run them by `make controllers`.

They take links down, set them up otherwise and fill queues, so they run in the emulated machine of
`tools/with-vcan --controllers` and nowhere else: a can0 that is somebody's bench is not touched.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from meshpoint.bus.light_can import load_can

load_can()  # before cantools loads all of it, pandas too
HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "vcan"), str(HERE.parent), str(HERE.parents[1])]

from skipping import skip_below, tools_missing  # noqa: E402 (found by the path above)

DRIVERS = {
    "can0": "kvaser_pci",
    "can1": "kvaser_pci",
    "can2": "ctucanfd_pci",
    "can3": "ctucanfd_pci",
}
TOOLS = ("candump", "cansend", "ip", "tc")


def why_not() -> str | None:
    """What is missing here, in words."""
    if os.environ.get("WITH_VCAN") != "qemu":
        return "not in the machine of tools/with-vcan; `make controllers` runs these tests there"
    for name, driver in DRIVERS.items():
        link = Path(f"/sys/class/net/{name}/device/driver")
        if not link.exists():
            return f"no {name} here; tools/with-vcan has it with --controllers"
        if link.resolve().name != driver:
            return f"{name} is driven by {link.resolve().name}, not by {driver}"
    return tools_missing(TOOLS)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skips with the reason where there are no such controllers."""
    skip_below(HERE, items, why_not())
