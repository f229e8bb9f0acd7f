"""Each row of the guard against the rig's truth: a sequence gone mad does damage, unless guarded.

The same controller, rig and bus twice. At a moment the sequence is replaced by one that commands
what the row forbids; once the guard looks at its frames, once it is told to look away. The rig's
own account says what came of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import pytest
from loop_bench import Loop

from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.header import RunHeader
from meshpoint.controller.settings.settings import (
    ControllerSettings,
    ShiftLimits,
    ValveTiming,
)
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import (
    TC1,
    ClutchAction,
    ControllerState,
    EngagementEvent,
    ReferenceEngagement,
    RigFault,
    ValveAction,
    ValveCommand,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import Sleeve, load_sheet
from meshpoint.rig_sim.settings import Preset, Profile
from meshpoint.rig_sim.shared.engagement import Violation
from meshpoint.rig_sim.shared.sleeves import SleeveState
from meshpoint.units import RPM

TRUCK12 = load_sheet("truck12")
State = ControllerState
LIMIT_US = 4_000_000
AGAIN_US = 60_000
CONTACTS = (EngagementEvent.GAP_CONTACT, EngagementEvent.TOOTH_CONTACT)


class MadCore(ControllerCore):
    """From a moment on its valves are driven by `deed`, its clutch held; the guard may be blind."""

    def __init__(self, header: RunHeader, deed: Deed, guarded: bool) -> None:
        super().__init__(header)
        self.deed = deed
        self.is_mad = False
        self.rows: list[int] = []
        self.truth: Any = None
        self._passes = self._guarded.guard.passes
        self._is_guarded = guarded
        self._guarded.guard.passes = self._watched  # type: ignore[method-assign]

    def _watched(self, payload: bytes, seen: Any) -> bool:
        passes = self._passes(payload, seen)
        if self.is_mad and self._guarded.guard.blocked_row is not None:
            self.rows.append(self._guarded.guard.blocked_row)
        return passes or not self._is_guarded

    def _decide(self, requested: int | None, snapshot: StepSnapshot, events: list[str]) -> None:
        if not self.is_mad:
            super()._decide(requested, snapshot, events)
            return
        self.sequence.finished = self.sequence.decision = None
        self.sequence.clutch = self.deed.clutch
        for valve in self.deed.valves:
            command = self._board.command(valve)
            if not command.on or snapshot.now_us - command.time_us > AGAIN_US:
                self._board.schedule(valve, True, snapshot.earliest_us, snapshot.now_us)


@dataclass
class Deed:
    """What is commanded against a row, from when on, and how the rig says that it was done."""

    row: int
    valves: tuple[ValveName, ...]
    harm: Callable[[Loop], bool]
    """Asked after every step."""
    begins: State = State.IN_GEAR
    clutch: ClutchAction = ClutchAction.OPEN
    held: ClutchAction | None = None
    """Where the clutch is held before; None: where the deed wants it."""
    gear: int = 8
    layshaft_rpm: float = 1400.0
    before: Callable[[Loop], None] = lambda _: None
    lasts_us: int = 700_000
    valve_on_ms: int = 3_000
    timing: ValveTiming = ValveTiming.SCHEDULED


def truth(loop: Loop) -> Any:
    core = loop.rig_core
    return core.truth


def violated(what: Violation) -> Callable[[Loop], bool]:
    return lambda loop: truth(loop).violations.get(what, 0) > 0


def met_a_gear_at(slip_rpm: float) -> Callable[[Loop], bool]:
    def harm(loop: Loop) -> bool:
        events = loop.of(ReferenceEngagement)
        return any(e.event in CONTACTS and abs(e.slip_rad_s) > slip_rpm * RPM for e in events)

    return harm


def moved(loop: Loop) -> bool:
    return truth(loop).sleeve_state(Sleeve.FIRST_SECOND) is not SleeveState.NEUTRAL


def left_the_flank(loop: Loop) -> bool:
    return truth(loop).sleeve_state(Sleeve.FIRST_SECOND) is not SleeveState.LOCKED


def out_before_the_plates_part(loop: Loop) -> bool:
    """Teeth that leave each other while the engine still turns the input shaft."""
    kinds = [event.event for event in loop.of(ReferenceEngagement)]
    parted, out = EngagementEvent.PLATES_PARTED, EngagementEvent.RELEASED
    return out in kinds and parted not in kinds[: kinds.index(out)]


def stands_still(loop: Loop) -> bool:
    return bool(truth(loop).speeds_rad_s[1] < 20.0 * RPM)


def overspeeds(loop: Loop) -> bool:
    return bool(truth(loop).speeds_rad_s[0] > 1.02 * TRUCK12.limits.input_max_rad_s)


def parts_the_range(loop: Loop) -> bool:
    _, _, main, propeller = truth(loop).speeds_rad_s
    return bool(abs(propeller / main - 1.0) > 0.02)


def driven_for(limit_us: int) -> Callable[[Loop], bool]:
    def harm(loop: Loop) -> bool:
        runs = groupby(loop.of(ValveStatus), key=lambda status: status.split_high_energised)
        return any(on and 10_000 * len(list(run)) > limit_us for on, run in runs)

    return harm


def dead_layshaft_sensor(loop: Loop) -> None:
    loop.fault(RigFault.HALL_DROPOUT, 2)
    loop.run(loop.time.now_us + 40_000)


def no_air(loop: Loop) -> None:
    loop.fault(RigFault.SUPPLY_DROP, 0, 4.0)
    loop.run(loop.time.now_us + 20_000)


def jammed(loop: Loop) -> None:
    loop.fault(RigFault.SLEEVE_JAMMED, 0)
    loop.run(loop.time.now_us + 20_000)


def position_says_neutral(loop: Loop) -> None:
    loop.fault(RigFault.POSITION_OFFSET, 0, 12.0)


def main_box_rests(loop: Loop) -> None:
    """The sleeve that was pulled out stands in neutral, and has been seen to."""
    stands = lambda: not moved(loop)  # noqa: E731
    assert loop.until(stands, loop.time.now_us + 100_000)
    loop.run(loop.time.now_us + 30_000)


FIRST, SECOND, CRAWL = ValveName.MAIN_FIRST, ValveName.MAIN_SECOND, ValveName.MAIN_CRAWL
NEUTRAL = State.SYNCHRONISING
DEEDS = [
    # By commands that act at once: of two that wait for a time the valve side keeps one on.
    Deed(1, (FIRST, SECOND), violated(Violation.BOTH_VALVES), timing=ValveTiming.IMMEDIATE),
    Deed(2, (CRAWL,), violated(Violation.TWO_GEARS)),
    Deed(3, (ValveName.MAIN_THIRD,), met_a_gear_at(200.0), begins=NEUTRAL),
    Deed(4, (SECOND,), moved, begins=NEUTRAL, before=dead_layshaft_sensor),
    Deed(5, (ValveName.BRAKE,), violated(Violation.BRAKE_IN_GEAR)),
    Deed(5, (SECOND, ValveName.BRAKE), violated(Violation.BRAKE_IN_GEAR)),
    Deed(5, (SECOND, ValveName.BRAKE), violated(Violation.BRAKE_IN_GEAR), before=jammed),
    Deed(6, (ValveName.BRAKE,), stands_still, begins=NEUTRAL, lasts_us=1_500_000),
    Deed(7, (ValveName.SPLIT_HIGH,), driven_for(1_050_000), lasts_us=1_300_000, valve_on_ms=1_000),
    Deed(8, (ValveName.RANGE_LOW,), parts_the_range),
    Deed(9, (ValveName.SPLIT_LOW,), overspeeds, gear=12, layshaft_rpm=2300.0),
    Deed(10, (SECOND,), left_the_flank, clutch=ClutchAction.CLOSE),
    Deed(10, (SECOND,), out_before_the_plates_part, held=ClutchAction.CLOSE),
    Deed(11, (SECOND,), moved, begins=State.COASTING, before=no_air),
    Deed(13, (ValveName.BRAKE,), violated(Violation.BRAKE_IN_GEAR), before=position_says_neutral),
]


def run(deed: Deed, guarded: bool) -> tuple[MadCore, Loop, bool]:
    loop = Loop(
        [(300_000, 10)] if deed.begins is not State.IN_GEAR else [],
        settings=ControllerSettings(
            valve_timing=deed.timing, limits=ShiftLimits(valve_on_ms=deed.valve_on_ms)
        ),
        sheet=TRUCK12,
        preset=Preset.TRUCK,
        start_gear=deed.gear,
        layshaft_rad_s=deed.layshaft_rpm * RPM,
        seed=6,
    )
    mad = MadCore(loop.header, deed, guarded)
    loop.controller.core = mad
    loop.run_to_state(deed.begins, LIMIT_US)
    if deed.begins is NEUTRAL:
        main_box_rests(loop)
    deed.before(loop)
    if deed.begins is State.IN_GEAR:
        meant, deed.clutch = deed.clutch, deed.held or deed.clutch
        hold_clutch(mad, loop, 500_000 if deed.row == 13 else 300_000)
        deed.clutch = meant
        ask_for(loop, 10 if deed.gear == 8 else 11)
    mad._board.all_off()
    mad.is_mad = True
    harmed = loop.until(lambda: deed.harm(loop), loop.time.now_us + deed.lasts_us)
    return mad, loop, harmed


def ask_for(loop: Loop, gear: int) -> None:
    """A driver asks for a gear, so that row 17 has nothing to say."""
    loop.controller.receive(Transmitter(Node.BENCH).encode(TC1(requested_gear=gear)))


def hold_clutch(mad: MadCore, loop: Loop, for_us: int) -> None:
    """Goes on for a while with no valve driven and the clutch where the deed wants it."""
    valves, mad.deed.valves = mad.deed.valves, ()
    mad.is_mad = True
    loop.run(loop.time.now_us + for_us)
    mad.deed.valves = valves


@pytest.mark.parametrize(
    "deed", DEEDS, ids=[f"row {deed.row}, {k}" for k, deed in enumerate(DEEDS)]
)
def test_what_a_row_forbids_does_harm_and_under_guard_does_none(deed: Deed) -> None:
    _, _, harmed = run(deed, guarded=False)
    assert harmed
    mad, loop, harmed = run(deed, guarded=True)
    assert not harmed, loop.events
    assert mad.rows
    assert mad.rows[0] == deed.row


def test_row_13_a_gear_that_crosses_its_backlash_is_still_in_mesh() -> None:
    """A position sensor shows neutral in gear; on a driveline that swings the gear crosses the
    backlash of its teeth again and again, and turns with its sleeve in between."""
    deed = Deed(13, (ValveName.BRAKE,), lambda _: False)
    loop = Loop(
        sheet=TRUCK12, preset=Preset.TRUCK, profile=Profile.HARSH, start_gear=8, seed=2,
        layshaft_rad_s=1400.0 * RPM,
    )  # fmt: skip
    mad = MadCore(loop.header, deed, guarded=True)
    loop.controller.core = mad
    loop.run_to_state(State.IN_GEAR, LIMIT_US)
    position_says_neutral(loop)
    hold_clutch(mad, loop, 500_000)
    ask_for(loop, 10)
    assert loop.until(lambda: 13 in mad.rows, loop.time.now_us + 100_000)
    assert not loop.until(
        lambda: "brake_energised" in loop.valves_driven, loop.time.now_us + 600_000
    )
    assert set(mad.rows) == {13}


def test_row_12_nothing_is_driven_before_the_inputs_are_proven() -> None:
    """Mad from power-up: the guard lets nothing out until all was valid three steps in a row."""
    deed = Deed(12, (ValveName.SPLIT_HIGH,), lambda _: False)
    first: dict[bool, int] = {}
    for guarded in (False, True):
        loop = Loop(sheet=TRUCK12, preset=Preset.TRUCK)
        mad = MadCore(loop.header, deed, guarded)
        mad.is_mad = True
        loop.controller.core = mad
        ask_for(loop, 11)
        loop.run(8_000)
        ask_for(loop, 11)  # once more, when the sensor clock is known
        loop.run(200_000)
        first[guarded] = next(
            time_us
            for time_us, message in loop.messages
            if isinstance(message, ValveCommand) and message.split_high_action is ValveAction.ON_AT
        )
        assert set(mad.rows) <= {12, 17}
        assert mad.rows[0] == 12
    assert first[True] > first[False] + 20_000
