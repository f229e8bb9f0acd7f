"""Old, invalid or damaged input is not used: one statement a channel.

Each kills a mutant that the suite let live: `Receiver.all_valid` always true, the youngest sample
for the oldest in the guard's view, limits of staleness ten times as long.
"""

from __future__ import annotations

from typing import Any

import pytest

from meshpoint.controller.estimate.baselines import CruiseTracker
from meshpoint.controller.estimate.main_tracker import MainTracker
from meshpoint.controller.estimate.wheel_tracker import ESTIMATE_STALE_US
from meshpoint.controller.guard.limits import guard_limits
from meshpoint.controller.guard.listening import GOOD_TO_BEGIN
from meshpoint.controller.guard.own_speed import NO_FRAME_US
from meshpoint.controller.guard.view import GUARD_FRESH_US, GuardInputs, GuardView
from meshpoint.controller.measure.inputs import SPEED_STALE_US, ShaftSpeedMeter, StepInputs
from meshpoint.controller.measure.wheel_edges import WheelEdges
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import FrameVerdict, Receiver, Transmitter
from meshpoint.dbc.messages import (
    EdgesInputRise,
    EdgesLayshaftRise,
    EdgesMainRise,
    EdgesPropellerRise,
    GearboxSensors,
    SleevesAux,
    SleevesMain,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet

SHEET = load_sheet("truck12")
SETTINGS = ControllerSettings()
CYCLE_US = 10_000
NOW_US = 5_000_000
INTERVAL_US = 700
SLOW = (SleevesMain, SleevesAux, GearboxSensors, ValveStatus)
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


class Heard:
    """The guard's view, and frames of the gearbox for it, every 10 ms and read at that moment."""

    def __init__(self) -> None:
        self.view = GuardView(SHEET, guard_limits(SHEET, SETTINGS))
        self.sender = Transmitter(Node.GEARBOX_IO)
        self.now_us = NOW_US
        self.behind_us = 0
        """By how much the sensors' clock is behind the controller's."""
        for _ in range(GOOD_TO_BEGIN):
            self.cycle()

    def cycle(self, without: Any = None, damage: Any = None, old: Any = None, age_us: int = 0,
              turning: bool = True) -> GuardInputs:  # fmt: skip
        """All frames of a read but one; or one with a wrong CRC, or with an old sample."""
        self.now_us += CYCLE_US
        read_us = self.now_us - self.behind_us
        frames = []
        for kind in SLOW:
            message = kind(sample_time_us=read_us - (age_us if kind is old else 0))
            frames.append((kind, self.sender.encode(message)))
        for kind in SHAFTS:
            newest_us = read_us if turning else NOW_US
            message = edges(kind, newest_us, read_us, newest_us // INTERVAL_US & 0xFFFF)
            frames.append((kind, self.sender.encode(message)))
        return self.view.take(
            [_with_wrong_crc(f) if k is damage else f for k, f in frames if k is not without],
            self.now_us,
            self.now_us,
        )

    def wait(self, late_us: int, *kinds: Any) -> GuardInputs:
        """Nothing but edges of some wheels comes, so long after the last cycle."""
        now_us = self.now_us + late_us
        frames = [self.sender.encode(edges(kind, now_us, now_us, 510)) for kind in kinds]
        return self.view.take(frames, now_us, now_us)


@pytest.mark.parametrize("kind", SLOW, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("age_us", [40_000, 40_001])
def test_one_old_sample_is_enough_for_the_guard_to_see_nothing(kind: Any, age_us: int) -> None:
    """Its counters are live: the frame is new, what it says is old."""
    assert GUARD_FRESH_US == 40_000
    assert Heard().cycle(old=kind, age_us=age_us).valid is (age_us <= GUARD_FRESH_US)


@pytest.mark.parametrize("kind", SLOW, ids=lambda kind: kind.__name__)
def test_one_invalid_channel_is_enough_for_the_guard_to_see_nothing(kind: Any) -> None:
    heard = Heard()
    assert heard.cycle().valid
    assert [heard.cycle(damage=kind).valid for _ in range(3)] == [True, True, False]
    assert [heard.cycle().valid for _ in range(4)] == [False, False, False, True]  # a step of 4


@pytest.mark.parametrize("kind", SLOW, ids=lambda kind: kind.__name__)
def test_one_silent_channel_is_enough_for_the_guard_to_see_nothing(kind: Any) -> None:
    """Three cycles may be missed."""
    heard = Heard()
    assert [heard.cycle(without=kind).valid for _ in range(4)] == [True, True, True, False]


@pytest.mark.parametrize("shaft", range(4), ids=["input", "layshaft", "main", "propeller"])
def test_three_wrong_edge_frames_lose_a_speed_to_the_guard(shaft: int) -> None:
    heard = Heard()
    for _ in range(3):
        seen = heard.cycle(damage=SHAFTS[shaft])
    assert [speed is None for speed in seen.speeds] == [k == shaft for k in range(4)]


def edges(kind: Any, newest_us: int, read_us: int, index: int = 500) -> Any:
    """A frame of steady teeth whose newest edge was at `newest_us`."""
    stamps = tuple((newest_us - INTERVAL_US * back) & 0xFFFF for back in range(27))
    return kind(read_us, index, len(stamps), False, False, False, stamps)


@pytest.mark.parametrize("shaft", range(4), ids=["input", "layshaft", "main", "propeller"])
@pytest.mark.parametrize("late_us", [SPEED_STALE_US, SPEED_STALE_US + 1])
def test_the_speed_of_a_shaft_without_frames_is_lost_to_the_guard(shaft: int, late_us: int) -> None:
    """25 ms, as docs/guard.md has it, whatever a constant may say; the others go on."""
    assert SPEED_STALE_US == NO_FRAME_US == 25_000
    others = [kind for kind in SHAFTS if kind is not SHAFTS[shaft]]
    seen = Heard().wait(late_us, *others)
    expected = [True] * 4
    expected[shaft] = late_us <= NO_FRAME_US
    assert [speed is not None for speed in seen.speeds] == expected


def all_turning() -> StepInputs:
    inputs = StepInputs()
    for kind in SHAFTS:
        inputs.take(edges(kind, NOW_US, NOW_US))
    return inputs


@pytest.mark.parametrize(("kind", "name"), [(EdgesLayshaftRise, "layshaft"),
                                            (EdgesMainRise, "main"),
                                            (EdgesPropellerRise, "propeller")])  # fmt: skip
def test_a_frozen_payload_is_no_speed_to_the_sequence(kind: Any, name: str) -> None:
    meter, found = ShaftSpeedMeter(SHEET), []
    for late_us in range(0, 160_000, CYCLE_US):
        inputs = StepInputs()
        inputs.take(edges(kind, NOW_US, NOW_US + late_us))
        speeds = meter.take(inputs, NOW_US + late_us)
        found.append(getattr(speeds, name) is not None)
    assert found == [True] * 3 + [False] * 13


@pytest.mark.parametrize(("kind", "name"), [(EdgesLayshaftRise, "layshaft"),
                                            (EdgesMainRise, "main"),
                                            (EdgesPropellerRise, "propeller")])  # fmt: skip
def test_the_speed_of_a_shaft_without_frames_is_lost_to_the_sequence(kind: Any, name: str) -> None:
    meter = ShaftSpeedMeter(SHEET)
    meter.take(all_turning(), NOW_US)
    for late_us, there in ((SPEED_STALE_US, True), (SPEED_STALE_US + 1, False)):
        speeds = meter.take(StepInputs(), NOW_US + late_us)
        assert (getattr(speeds, name) is not None) is there


@pytest.mark.parametrize("kind", SHAFTS, ids=lambda kind: kind.__name__)
def test_a_frozen_payload_under_live_frames_is_no_speed(kind: Any) -> None:
    """Frames come, their read times go on, their newest edge does not; not when its 16 bits have
    gone round either, 65.5 ms later."""
    heard, shaft, found = Heard(), SHAFTS.index(kind), []
    last_us = heard.now_us
    for late_us in range(CYCLE_US, 160_000, CYCLE_US):
        frame = heard.sender.encode(edges(kind, last_us, last_us + late_us))
        seen = heard.view.take([frame], last_us + late_us, last_us + late_us)
        found.append(seen.speeds[shaft] is not None)
    assert found == [True, True] + [False] * 13


@pytest.mark.parametrize("tracker", ["crossing", "baseline"])
def test_the_main_shaft_without_edges_for_60_ms_has_no_state(tracker: str) -> None:
    assert ESTIMATE_STALE_US == 60_000
    wheel = SHEET.wheels.main
    main: Any = (
        MainTracker(SETTINGS.crossing_filter, wheel.teeth, wheel.missing)
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


def test_sensors_that_start_anew_are_known_by_an_array_that_gets_emptier() -> None:
    """Their clock may read nearly as before: it is taken at once all the same."""
    heard = Heard()
    for _ in range(50):
        heard.cycle()
    behind_us = 63_000
    first = edges(EdgesMainRise, heard.now_us - behind_us, heard.now_us + CYCLE_US - behind_us, 3)
    frame = heard.sender.encode(first._replace(valid_stamps=3))
    now_us = heard.now_us + CYCLE_US
    seen = heard.view.take([frame], now_us, now_us)
    assert seen.now_us % (1 << 32) == now_us - behind_us


@pytest.mark.parametrize("step_us", [10_001, 15_000, 19_000, 29_000, 60_000])
def test_a_clock_that_steps_back_by_more_than_a_cycle_is_followed_at_once(step_us: int) -> None:
    """A message whose counter goes on and whose time goes back is of a clock that was set back, not
    late: frames of one identifier keep their order."""
    heard = Heard()
    for _ in range(50):
        heard.cycle()
    heard.behind_us = step_us
    assert heard.cycle().now_us % (1 << 32) == heard.now_us - step_us
    assert heard.cycle().now_us % (1 << 32) == heard.now_us - step_us


def test_what_the_clock_gains_in_a_step_is_seen() -> None:
    """Frames that have waited on a full bus come faster than they were sent."""
    heard = Heard()
    assert heard.cycle().clock_gained_us == 0
    heard.behind_us = 30_000  # of a clock that reads so much less
    assert heard.cycle().clock_gained_us == -30_000
    for behind_us in (20_000, 10_000, 0):
        heard.behind_us = behind_us
        assert heard.cycle().clock_gained_us == 10_000
    assert heard.cycle().clock_gained_us == 0
    assert GuardView(SHEET, guard_limits(SHEET, SETTINGS)).take([], 0, 0).clock_gained_us == 0
