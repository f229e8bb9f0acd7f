"""Tests on a real SocketCAN bus: run them by `make vcan`, or where vcan0 is up with mtu 72."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from meshpoint.bus.light_can import load_can

load_can()  # before cantools loads all of it, pandas too: half a minute on an emulated processor
HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parents[1])]

from skipping import skip_below, tools_missing  # noqa: E402 (found by the path above)

TOOLS = ("candump", "cansend", "cangen", "ip")


def why_not() -> str | None:
    """What is missing here, in words."""
    try:
        mtu = int(Path("/sys/class/net/vcan0/mtu").read_text())
    except OSError:
        return "no vcan0 here; `make vcan` runs these tests, in an emulated machine if need be"
    if mtu != 72:
        return f"vcan0 has mtu {mtu}, CAN FD needs 72"
    return tools_missing(TOOLS)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skips with the reason where there is no such bus."""
    skip_below(HERE, items, why_not())


@pytest.fixture
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[object]:
    """Rig and controller of this test alone, in gear 14, and candump beside them; a test may name
    another wire than that of CAN FD."""
    from vcan_bench import Bench

    with Bench(tmp_path, getattr(request, "param", None)) as bench:
        bench.dump.in_gear(14)
        yield bench
