"""Old, invalid or damaged input is not used: one statement a channel.

Each kills a mutant that the suite let live: `Receiver.all_valid` always true, the youngest sample
for the oldest in the guard's view, limits of staleness ten times as long.
"""

from __future__ import annotations

from typing import Any

import pytest

from meshpoint.controller.estimation.cruise import ESTIMATE_STALE_US, CruiseTracker
from meshpoint.controller.estimation.main_tracker import MainTracker
from meshpoint.controller.guard.limits import guard_limits
from meshpoint.controller.guard.view import GUARD_FRESH_US, SLOW, GuardView
from meshpoint.controller.sensing.edge_speed import SPEED_STALE_US
from meshpoint.controller.sensing.shaft_speeds import ShaftSpeeds
from meshpoint.controller.sensing.step_inputs import StepInputs
from meshpoint.controller.sensing.wheel_edges import WheelEdges
from meshpoint.controller.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import FrameVerdict, Receiver, Transmitter
from meshpoint.dbc.messages import (
    EdgesInputRise,
    EdgesLayshaftRise,
    EdgesMainRise,
    EdgesPropellerRise,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet

SHEET = load_sheet("truck12")
SETTINGS = ControllerSettings()
CYCLE_US = 10_000
NOW_US = 5_000_000
INTERVAL_US = 700
SHAFTS = (EdgesInputRise, EdgesLayshaftRise, EdgesMainRise, EdgesPropellerRise)
CYCLIC = [
    codec.message_type
    for codec in CODECS.values()
    if codec.spec.is_cyclic and Node.TRANSMISSION_CONTROL in codec.spec.receivers
]
PROTECTED = [kind for kind in CYCLIC if CODECS[kind.__name__].spec.is_protected]


class Traffic:
    """All that the controller hears in cycles, as its receiver gets it."""

    def __init__(self) -> None:
        self.receiver = Receiver(Node.TRANSMISSION_CONTROL)
        self._senders = {node: Transmitter(node) for node in Node}
        self._now_us = 0

    def cycle(self, without: Any = None, damage: Any = None) -> None:
        """Ten milliseconds in which every message comes, but one, or one with a wrong CRC."""
        self._now_us += CYCLE_US
        for kind in CYCLIC:
            frame = self._senders[CODECS[kind.__name__].spec.sender].encode(kind())
            if kind is damage:
                frame = _with_wrong_crc(frame)
            if kind is not without:
                verdict = self.receiver.receive(frame).verdict
                assert verdict is (FrameVerdict.E2E if kind is damage else FrameVerdict.OK)
        self.receiver.tick(self._now_us)


def _with_wrong_crc(frame: Frame) -> Frame:
    """The counter is live."""
    return frame._replace(data=bytes([frame.data[0] ^ 0x5A]) + frame.data[1:])


@pytest.mark.parametrize("kind", CYCLIC, ids=lambda kind: kind.__name__)
def test_a_silent_channel_is_the_one_that_is_not_valid(kind: Any) -> None:
    traffic = Traffic()
    for _ in range(5):
        traffic.cycle()
    receiver = traffic.receiver
    assert receiver.all_valid(CYCLIC)
    cycles = CODECS[kind.__name__].spec.cycle_time_us * 5 // CYCLE_US
    for _ in range(cycles):
        traffic.cycle(without=kind)
    assert not receiver.all_valid((kind,))
    assert not receiver.all_valid(CYCLIC)
    assert receiver.all_valid([other for other in CYCLIC if other is not kind])


@pytest.mark.parametrize("kind", PROTECTED, ids=lambda kind: kind.__name__)
def test_a_wrong_crc_under_a_live_counter_makes_a_channel_invalid(kind: Any) -> None:
    traffic = Traffic()
    for _ in range(5):
        traffic.cycle()
    for _ in range(3):
        traffic.cycle(damage=kind)
    assert not traffic.receiver.all_valid((kind,))
    assert traffic.receiver.all_valid([other for other in CYCLIC if other is not kind])


def slow_inputs(*old: Any, age_us: int = 0) -> StepInputs:
    """Positions and pressures sampled just now, but of some kinds earlier."""
    inputs = StepInputs()
    for kind in SLOW:
        sample_us = NOW_US - (age_us if kind in old else 0)
        inputs.take(kind(sample_time_us=sample_us))
    return inputs


def all_heard() -> Receiver:
    traffic = Traffic()
    for _ in range(5):
        traffic.cycle()
    return traffic.receiver


@pytest.mark.parametrize("kind", SLOW, ids=lambda kind: kind.__name__)
def test_one_old_sample_is_enough_for_the_guard_to_see_nothing(kind: Any) -> None:
    """Its counters are live: the frame is new, what it says is old."""
    receiver = all_heard()
    for age_us, valid in ((GUARD_FRESH_US, True), (GUARD_FRESH_US + 1, False)):
        view = GuardView(SHEET, guard_limits(SHEET, SETTINGS))
        assert view.take(slow_inputs(kind, age_us=age_us), receiver, NOW_US).valid is valid


@pytest.mark.parametrize("kind", SLOW, ids=lambda kind: kind.__name__)
def test_one_invalid_channel_is_enough_for_the_guard_to_see_nothing(kind: Any) -> None:
    view = GuardView(SHEET, guard_limits(SHEET, SETTINGS))
    traffic = Traffic()
    for _ in range(5):
        traffic.cycle()
    assert view.take(slow_inputs(), traffic.receiver, NOW_US).valid
    for _ in range(3):
        traffic.cycle(damage=kind)
    assert not view.take(slow_inputs(), traffic.receiver, NOW_US).valid


def edges(kind: Any, newest_us: int, read_us: int, index: int = 500) -> Any:
    """A frame of steady teeth whose newest edge was at `newest_us`."""
    stamps = tuple((newest_us - INTERVAL_US * back) & 0xFFFF for back in range(27))
    return kind(read_us, index, len(stamps), False, False, False, stamps)


def all_turning() -> StepInputs:
    inputs = StepInputs()
    for kind in SHAFTS:
        inputs.take(edges(kind, NOW_US, NOW_US))
    return inputs


@pytest.mark.parametrize("shaft", range(4), ids=["input", "layshaft", "main", "propeller"])
@pytest.mark.parametrize("late_us", [SPEED_STALE_US, SPEED_STALE_US + 1])
def test_the_speed_of_a_shaft_without_frames_is_lost_to_the_guard(shaft: int, late_us: int) -> None:
    """25 ms, as docs/guard.md has it, whatever a constant may say; the others go on."""
    assert SPEED_STALE_US == 25_000
    view, now_us = GuardView(SHEET, guard_limits(SHEET, SETTINGS)), NOW_US + late_us
    receiver = all_heard()
    view.take(all_turning(), receiver, NOW_US)
    inputs = StepInputs()
    for kind in SHAFTS:
        if kind is not SHAFTS[shaft]:
            inputs.take(edges(kind, now_us, now_us, 510))
    seen = view.take(inputs, receiver, now_us)
    expected = [True] * 4
    expected[shaft] = late_us <= SPEED_STALE_US
    assert [speed is not None for speed in seen.speeds] == expected


@pytest.mark.parametrize(("kind", "name"), [(EdgesLayshaftRise, "layshaft"),
                                            (EdgesMainRise, "main"),
                                            (EdgesPropellerRise, "propeller")])  # fmt: skip
def test_the_speed_of_a_shaft_without_frames_is_lost_to_the_sequence(kind: Any, name: str) -> None:
    speeds = ShaftSpeeds(SHEET)
    speeds.take(all_turning(), NOW_US)
    for late_us, there in ((SPEED_STALE_US, True), (SPEED_STALE_US + 1, False)):
        speeds.take(StepInputs(), NOW_US + late_us)
        assert (getattr(speeds, name) is not None) is there


@pytest.mark.parametrize("kind", SHAFTS, ids=lambda kind: kind.__name__)
def test_a_frozen_payload_under_live_frames_is_no_speed(kind: Any) -> None:
    """Frames come, their read times go on, their newest edge does not."""
    view, receiver = GuardView(SHEET, guard_limits(SHEET, SETTINGS)), all_heard()
    shaft = SHAFTS.index(kind)
    found = []
    for late_us in range(0, 50_000, CYCLE_US):
        inputs = StepInputs()
        inputs.take(edges(kind, NOW_US, NOW_US + late_us))
        found.append(view.take(inputs, receiver, NOW_US + late_us).speeds[shaft] is not None)
    assert found == [True, True, True, False, False]


@pytest.mark.parametrize("tracker", ["crossing", "baseline"])
def test_the_main_shaft_without_edges_for_60_ms_has_no_state(tracker: str) -> None:
    assert ESTIMATE_STALE_US == 60_000
    wheel = SHEET.wheels.main
    main: Any = (
        MainTracker(SETTINGS.crossing_filter, wheel.teeth, wheel.missing, None)
        if tracker == "crossing"
        else CruiseTracker(SETTINGS.cruise_filter, wheel.pitch_rad)
    )
    reader, clock = WheelEdges.of(wheel), _Clock()
    for step in range(1, 30):
        at_us = step * CYCLE_US
        newest = at_us - at_us % INTERVAL_US
        index = newest // INTERVAL_US
        frame = edges(EdgesMainRise, newest, at_us, index)
        main.edges(reader.read([frame], [], clock, at_us))  # type: ignore[arg-type]
    assert main.at(newest + 60_000) is not None
    assert main.at(newest + 60_001) is None


class _Clock:
    """A sensor clock that is the controller's."""

    jumps = 0

    def stamp(self, stamp: int, now_us: int) -> int:
        return stamp
