"""A bus that two processes share: each runs its own nodes, and the frames are those of one bus."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from meshpoint.bench.adapter_profiles import PROFILES
from meshpoint.bench.bench_builder import virtual_bench
from meshpoint.bench.setup import Setup
from meshpoint.bench.shared_bus import WINDOW_US, Elsewhere, HandOver, SharedBus
from meshpoint.bench.simulate import rig_of, simulate
from meshpoint.bench.virtual_bus import VirtualBus, duration_us
from meshpoint.bench.virtual_time import VirtualTime
from meshpoint.bus.core import Step
from meshpoint.bus.profile import WireProfile
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox import load_sheet

TRUCK12 = load_sheet("truck12")


class TwoHalves:
    """Rig here, controller and bench there: each with its own copy of the bus."""

    def __init__(self, setup: Setup) -> None:
        self.bus = SharedBus()
        self._rig_bus = SharedBus()
        self._rig = virtual_bench(
            setup, Elsewhere(), rig_of(setup), Elsewhere(), shared=self._rig_bus
        ).time

    def run(
        self, time: VirtualTime, until: Callable[[], bool], limit_us: int, end: Callable[[], Step]
    ) -> None:
        ours, theirs = list[HandOver](), list[HandOver]()
        for now_us in range(0, limit_us, WINDOW_US):
            self.bus.begin(now_us, theirs)
            self._rig_bus.begin(now_us, ours)
            is_over = time.run(until, now_us + WINDOW_US - 1)
            self._rig.run(lambda: False, now_us + WINDOW_US - 1)
            ours, theirs = self.bus.handed(), self._rig_bus.handed()
            if is_over:
                self.bus.begin(time.now_us + 1, [h for h in theirs if h.time_us <= time.now_us])
                end()
                return


@pytest.mark.parametrize(
    "setup",
    [
        Setup(TRUCK12, ControllerSettings(), shifts=1),
        Setup(TRUCK12, ControllerSettings(), shifts=1, wire=WireProfile.CLASSIC),
        Setup(TRUCK12, ControllerSettings(), shifts=1, adapter=PROFILES["kvaser"]),
    ],
    ids=["fd", "classic", "adapter"],
)
def test_two_halves_put_the_frames_of_one_bus_on_theirs(setup: Setup) -> None:
    whole, halves = list[tuple[int, Frame]](), list[tuple[int, Frame]]()
    expected = simulate(setup, lambda *each: whole.append(each))
    found = simulate(setup, lambda *each: halves.append(each), apart=TwoHalves(setup))
    assert len(whole) > 1000
    assert halves == whole
    assert found == expected


def test_no_frame_is_shorter_than_a_window() -> None:
    assert min(duration_us(n, False) for n in range(9)) >= WINDOW_US
    assert min(duration_us(n, True) for n in range(65)) >= WINDOW_US


def test_what_two_nodes_hand_over_in_one_microsecond_leaves_in_the_order_of_the_nodes() -> None:
    low, high = Frame(0x10, bytes(8)), Frame(0x20, bytes(8))
    one = VirtualBus()
    one.send(0, [high], 50)
    one.send(1, [low], 50)
    here, there = SharedBus(), SharedBus()
    here.send(0, [high], 50)
    there.send(1, [low], 50)
    ours, theirs = here.handed(), there.handed()
    here.begin(WINDOW_US, theirs)
    there.begin(WINDOW_US, ours)
    assert here.next_us == there.next_us == one.next_us
    assert here.take() == there.take() == one.take() == (0, high)
