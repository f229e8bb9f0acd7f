"""Tests on a real SocketCAN bus: run them by `make vcan`, or where vcan0 is up with mtu 72."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parents[1])]

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
        if HERE in item.path.parents:
            item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[object]:
    """Rig and controller of this test alone, in gear 14, and candump beside them."""
    from vcan_bench import Bench

    with Bench(tmp_path) as bench:
        bench.dump.in_gear(14)
        yield bench
