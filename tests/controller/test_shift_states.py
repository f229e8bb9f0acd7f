"""The shift sequence alone, on a gearbox of a few lines that moves as the data sheet says: what it
commands in which order, and how each part of the box that fails ends the shift.

No bus, no sensors' errors, no estimators: speeds and angles are given to the sequence as they are.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, Final

import pytest

from meshpoint.controller.motion.brake_input import BrakeInput
from meshpoint.controller.motion.models import LayshaftState, first_order_law, free_motion
from meshpoint.controller.motion.swing import ShaftState
from meshpoint.controller.phase.reference import PhaseReferences
from meshpoint.controller.sensing.gearbox_view import GearboxView
from meshpoint.controller.settings import ControllerSettings
from meshpoint.controller.shift.sequence import ShiftSequence
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.table import ShiftRecord
from meshpoint.controller.shift.valve_board import ValveBoard
from meshpoint.controller.valve_name import ValveName
from meshpoint.dbc.messages import (
    ClutchAction,
    FaultCode,
    ShiftResult,
    SleevesAux,
    SleevesMain,
    Strategy,
)
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox import MainGear, Range, Sleeve, Split, load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS, SLEEVE_OF_MAIN

SHEET = load_sheet("truck12")
PITCH = SHEET.dog.pitch_rad
MS_US: Final = 1_000
TICK_US, LEAD_US, DELAY_MS = 10 * MS_US, 4 * MS_US, 12
PUSHED: Final = {
    Sleeve.FIRST_SECOND: (ValveName.MAIN_FIRST, ValveName.MAIN_SECOND),
    Sleeve.CRAWL_THIRD: (ValveName.MAIN_CRAWL, ValveName.MAIN_THIRD),
    Sleeve.SPLITTER: (ValveName.SPLIT_LOW, ValveName.SPLIT_HIGH),
    Sleeve.RANGE: (ValveName.RANGE_LOW, ValveName.RANGE_HIGH),
}
MAIN_SLEEVES: Final = (Sleeve.FIRST_SECOND, Sleeve.CRAWL_THIRD)
STROKE_M, CONTACT_M = SHEET.sleeve.stroke_m, SHEET.sleeve.to_contact_m
PUSH_M_S2: Final = 2.0 * CONTACT_M / (SHEET.sleeve.delay_s - 1e-3 * DELAY_MS) ** 2
"""A sleeve is at its gear's teeth after the time the sheet says, the valve's delay included."""


def side_of(step: Split | Range) -> int:
    return 1 if step.name == "HIGH" else -1


@dataclass
class Box:
    """The gearbox, the engine, the clutch, and the sequence that shifts them, 10 ms a step."""

    gear: int = 7
    input_rad_s: float = 150.0
    settings: ControllerSettings = field(default_factory=ControllerSettings)
    phase_rad: float | None = None
    """Of all gears at angles of zero; None: the sequence does not know it."""
    pull: float = 0.0
    """The engine's torque in gear, as a share."""
    lost: FaultCode = FaultCode.NONE
    stuck: set[Sleeve] = field(default_factory=set)
    stuck_clutch: bool = False
    weak_engine: bool = False
    refused: set[ValveName] = field(default_factory=set)
    """Valves whose commands the valve side does not take."""
    face: Callable[[float], bool] = lambda _: False
    """Whether a tooth is in the way at a phase."""
    supply_pa: float = 9.5e5
    is_self_tested: bool = True
    hears_propeller: bool = True

    def __post_init__(self) -> None:
        gear = DRIVE_GEARS[self.gear]
        self.now_us, self.seen = 5_000_000, []
        self.position_m = dict.fromkeys(Sleeve, 0.0)
        side = SLEEVE_OF_MAIN[gear.main]
        self.position_m[side.sleeve] = STROKE_M * side.direction
        self.position_m[Sleeve.SPLITTER] = STROKE_M * side_of(gear.split)
        self.position_m[Sleeve.RANGE] = STROKE_M * side_of(gear.range_)
        self.speed_m_s = dict.fromkeys(Sleeve, 0.0)
        self.caught: set[Sleeve] = set()
        self.clutch, self.engine, self.torque = 1.0, self.input_rad_s, self.pull
        self.layshaft = self.input_rad_s * SHEET.split_mesh(gear.split).ratio
        self.main = self.layshaft * SHEET.main_mesh(gear.main).ratio
        self.propeller = self.main * SHEET.range_mesh(gear.range_).ratio
        self.theta_layshaft = self.theta_main = 0.0
        self.pressure_pa = 0.0
        self.out_us = self.air_us = 0
        self.driven: dict[ValveName, list[float]] = {
            valve: [0.0] * (DELAY_MS + TICK_US // MS_US) for valve in ValveName
        }
        self.split, self.range = gear.split, gear.range_
        self.board = ValveBoard(self.settings.valve_timing)
        self.references = PhaseReferences(SHEET)
        if self.phase_rad is not None:
            for each in SLEEVE_OF_MAIN:
                self.references.adopt(each, -self.phase_rad, 1)  # type: ignore[arg-type]
        self.brake = BrakeInput(DELAY_MS * MS_US)
        self.view = GearboxView(SHEET)
        self.sequence = ShiftSequence(SHEET, self.settings, self.board, self.brake, self.references)
        self.records: list[ShiftRecord] = []

    @property
    def state(self) -> State:
        return self.sequence.state

    @property
    def mesh(self) -> MainGear:
        for gear, side in SLEEVE_OF_MAIN.items():
            if self.position_m[side.sleeve] * side.direction > CONTACT_M:
                return gear
        return MainGear.NEUTRAL

    def slip(self, gear: MainGear) -> float:
        return SHEET.main_mesh(gear).ratio * self.layshaft - self.main

    def phase(self, gear: MainGear) -> float:
        """True phase of a gear."""
        ratio = SHEET.main_mesh(gear).ratio
        angle = ratio * self.theta_layshaft - self.theta_main + (self.phase_rad or 0.0)
        return math.remainder(angle, PITCH)

    def step(self) -> State:
        """10 ms of the gearbox, then one of the sequence."""
        tracks = {sleeve: [at] for sleeve, at in self.position_m.items()}
        for ms in range(TICK_US // MS_US):
            self._millisecond(self.now_us + MS_US * (ms + 1))
            for sleeve, at in self.position_m.items():
                tracks[sleeve].insert(0, at)
        self.now_us += TICK_US
        self._sense({sleeve: tuple(samples[:10]) for sleeve, samples in tracks.items()})
        self.sequence.step(self.snapshot())
        self.seen.append((self.now_us, self.state))
        if self.sequence.finished is not None:
            self.records.append(self.sequence.finished)
        self._command()
        return self.state

    def _command(self) -> None:
        """What each valve is commanded for the next 10 ms, as shares of a millisecond."""
        for valve in ValveName:
            for ms in range(TICK_US // MS_US):
                tenths = [self.now_us + MS_US * ms + 100 * k for k in range(10)]
                on = sum(self.board.driven(valve, t) for t in tenths) / 10.0
                self.driven[valve].append(0.0 if valve in self.refused else on)

    def _millisecond(self, at_us: int) -> None:
        dt, meshed = 1e-3, self.mesh
        for sleeve, valves in PUSHED.items():
            low, high = (self.driven[valve].pop(0) for valve in valves)
            push = 0.0 if sleeve in self.stuck else round(high) - round(low)
            before_m = self.position_m[sleeve]
            if push * self.speed_m_s[sleeve] < 0.0 or not push:
                self.speed_m_s[sleeve] = 0.0
                self.caught.discard(sleeve)
            push = 0 if sleeve in self.caught else push
            self.speed_m_s[sleeve] += push * PUSH_M_S2 * dt
            at_m = before_m + self.speed_m_s[sleeve] * dt
            gear = next((g for g, s in SLEEVE_OF_MAIN.items()
                         if (s.sleeve, s.direction) == (sleeve, push)), None)  # fmt: skip
            if gear and before_m * push <= CONTACT_M < at_m * push and self.face(self.phase(gear)):
                at_m, self.speed_m_s[sleeve] = before_m, 0.0
            if before_m * at_m < 0.0 and sleeve in MAIN_SLEEVES:
                at_m, self.speed_m_s[sleeve] = 0.0, 0.0  # into the detent of neutral
                self.caught.add(sleeve)
            self.position_m[sleeve] = min(max(at_m, -STROKE_M), STROKE_M)
        if meshed is not MainGear.NEUTRAL and self.mesh is MainGear.NEUTRAL:
            self.out_us = at_us
        self._shafts(self.driven[ValveName.BRAKE].pop(0), dt)
        if self.pressure_pa > 0.0 and self.air_us == 0:
            self.air_us = at_us

    def _shafts(self, brake: float, dt: float) -> None:
        sequence = self.sequence
        opens = sequence.clutch is ClutchAction.OPEN
        if not self.stuck_clutch:
            rate = -1.0 / SHEET.clutch.open_delay_s if opens else 1.0 / SHEET.clutch.close_delay_s
            self.clutch = min(max(self.clutch + rate * dt, 0.0), 1.0)
        share = self.pull if sequence.engine_share is None else sequence.engine_share
        self.torque += (share - self.torque) * dt / SHEET.engine.lag_s
        if sequence.engine_rad_s is not None and not self.weak_engine:
            self.engine += min(max(sequence.engine_rad_s - self.engine, -0.3), 0.3)
        for sleeve, attribute in ((Sleeve.SPLITTER, "split"), (Sleeve.RANGE, "range")):
            if abs(self.position_m[sleeve]) > STROKE_M - 1e-3:
                low, high = type(getattr(self, attribute))
                setattr(self, attribute, high if self.position_m[sleeve] > 0.0 else low)
        self.main = self.propeller / SHEET.range_mesh(self.range).ratio
        supply = SHEET.air.supply_gauge_pa
        self.pressure_pa += (supply * brake - self.pressure_pa) * dt / SHEET.brake.time_constant_s
        ratio = SHEET.split_mesh(self.split).ratio
        if self.mesh is not MainGear.NEUTRAL:
            self.layshaft = self.main / SHEET.main_mesh(self.mesh).ratio
            self.engine += (self.layshaft / ratio - self.engine) * (self.clutch > 0.35) * 0.05
        elif self.clutch > 0.9:
            self.layshaft = self.engine * ratio
        else:
            inertia = SHEET.inertia_kgm2(self.split)
            lost = SHEET.shafts.friction_nms * self.layshaft
            lost += SHEET.brake_nm_per_pa * self.pressure_pa
            self.layshaft -= lost / inertia * dt
        self.theta_layshaft += self.layshaft * dt
        self.theta_main += self.main * dt

    def _sense(self, tracks: dict[Sleeve, tuple[float, ...]]) -> None:
        at_us = self.now_us
        self.view.sleeves_main(
            SleevesMain(
                sleeve_first_second_m=tracks[Sleeve.FIRST_SECOND],
                sleeve_crawl_third_m=tracks[Sleeve.CRAWL_THIRD],
            ),
            at_us,
        )
        self.view.sleeves_aux(
            SleevesAux(sleeve_splitter_m=tracks[Sleeve.SPLITTER],
                       sleeve_range_m=tracks[Sleeve.RANGE]), at_us,
        )  # fmt: skip
        self.view.clutch.take(at_us, self.clutch)
        self.view.work_out()

    def snapshot(self, **other: Any) -> StepSnapshot:
        """What the sequence is given."""
        state = LayshaftState(
            self.now_us, self.theta_layshaft, self.layshaft, self.pressure_pa, 1e-4, 0.01, 1e3
        )
        law = first_order_law(1.0 / SHEET.brake.time_constant_s, SHEET.air.supply_gauge_pa)
        free = self.mesh is MainGear.NEUTRAL and self.clutch < 0.3
        tracker: Any = SimpleNamespace(
            free=free, latest=lambda: state, at=lambda _: state, drag_nm=lambda _: 0.0,
            model=free_motion(SHEET, self.split, law, self.settings.crossing_filter),
        )  # fmt: skip
        main = ShaftState(self.now_us, self.theta_main, self.main, 1e-4, 0.01)
        speeds: Any = SimpleNamespace(
            layshaft=self.layshaft, main=self.main,
            propeller=self.propeller if self.hears_propeller else None,
            slip_rad_s=self.slip,
            split_turns_together=lambda split: self.split is split,
            range_turns_together=lambda range_: self.range is range_,
        )  # fmt: skip
        reported = tuple(
            valve not in self.refused
            and (self.board.command(valve).on or self.board.driven(valve, self.now_us))
            for valve in ValveName
        )
        values = {
            "now_us": self.now_us, "earliest_us": self.now_us + LEAD_US, "view": self.view,
            "layshaft": tracker, "main": main, "speeds": speeds, "lost": self.lost,
            "driven": reported, "supply_pa": self.supply_pa, "engine_rad_s": self.engine,
            "engine_torque_share": round(self.torque, 2),
            "is_self_tested": self.is_self_tested,
        }  # fmt: skip
        return StepSnapshot(**(values | other))

    def ready(self) -> Box:
        """In gear, and at rest for long enough."""
        for _ in range(5):
            self.step()
        assert self.state is State.IN_GEAR
        return self

    def ask(self, number: int) -> str | None:
        return self.sequence.request(number, self.snapshot())

    def until(self, *states: State, most: int = 400) -> Box:
        """Steps until the sequence is in one of these states."""
        for _ in range(most):
            if self.step() in states:
                return self
        raise AssertionError(f"{self.state.name} after {most} steps, not {states}")

    def shift(self, number: int) -> ShiftRecord:
        """A whole shift, to the end of the clutch's way."""
        self.ask(number)
        self.until(State.IN_GEAR, State.NEUTRAL, State.FAULTED)
        return self.records[-1]

    def running(self) -> bool:
        """Whether the shift asked for is under way; it has 5 s for it."""
        assert len(self.seen) < 500, self.trajectory
        return not self.records

    @property
    def trajectory(self) -> list[State]:
        """The states it went through, each once in a row."""
        states = [state for _, state in self.seen]
        return [s for k, s in enumerate(states) if k == 0 or s is not states[k - 1]]


FIRST_SECOND: Final = Sleeve.FIRST_SECOND


def aimed(gear: int, input_rad_s: float = 150.0, **other: Any) -> Box:
    """A box whose phases are known, in gear."""
    return Box(gear, input_rad_s, phase_rad=0.01, **other).ready()


UP, DOWN, SPLIT, RANGED = (7, 150.0, 9), (9, 110.0, 7), (7, 150.0, 8), (6, 190.0, 7)
WAYS: Final = {
    UP: [State.IN_GEAR, State.CLUTCH_OPENING, State.DISENGAGING, State.SYNCHRONISING,
         State.COASTING, State.ENGAGING, State.CLUTCH_CLOSING, State.IN_GEAR],
    DOWN: [State.IN_GEAR, State.CLUTCH_OPENING, State.DISENGAGING, State.SPEED_RAISING,
           State.CLUTCH_PARTING, State.COASTING, State.ENGAGING, State.CLUTCH_CLOSING,
           State.IN_GEAR],
    SPLIT: [State.IN_GEAR, State.CLUTCH_OPENING, State.SPLITTER_CHANGING, State.CLUTCH_CLOSING,
            State.IN_GEAR],
}  # fmt: skip


def test_no_request_is_taken_before_the_guard_s_self_test_is_passed() -> None:
    """A shift begun before would open the clutch and then find every valve blocked (row 12)."""
    box = Box(7, 150.0, phase_rad=0.01, is_self_tested=False).ready()
    for _ in range(60):
        box.ask(9)
        assert box.step() is State.IN_GEAR
    assert (box.records, box.clutch) == ([], 1.0)
    box.is_self_tested = True
    assert box.shift(9).result is ShiftResult.ENGAGED


@pytest.mark.parametrize("way", WAYS)
def test_a_shift_takes_its_way_and_ends_in_its_gear(way: tuple[int, float, int]) -> None:
    box = aimed(*way[:2])
    record = box.shift(way[2])
    assert box.trajectory == WAYS[way]
    assert (record.result, record.fault) == (ShiftResult.ENGAGED, FaultCode.NONE)
    assert box.view.gear_number == way[2]
    assert (record.from_number, record.to_number) == (way[0], way[2])
    assert record.raises == (1 if way is DOWN else 0)
    assert record.pulses == (1 if way is UP else 0)
    assert record.attempts == (0 if way is SPLIT else 1)
    assert (box.sequence.engine_rad_s, box.sequence.engine_share) == (None, None)
    assert not any(box.board.command(valve).on for valve in ValveName)


def test_splitter_and_range_change_while_the_main_box_is_in_neutral() -> None:
    box = aimed(6, 110.0)
    box.ask(7)
    moved = set()
    while box.running() or box.state is not State.IN_GEAR:
        box.step()
        for valve in (ValveName.SPLIT_LOW, ValveName.RANGE_HIGH):
            if box.board.driven(valve, box.now_us):
                moved.add(valve)
                assert box.state is State.STEPS_CHANGING
                assert box.view.main_gear is MainGear.NEUTRAL
        for valve in (ValveName.SPLIT_HIGH, ValveName.RANGE_LOW):
            assert not box.board.driven(valve, box.now_us)
    assert moved == {ValveName.SPLIT_LOW, ValveName.RANGE_HIGH}
    assert box.records[-1].result is ShiftResult.ENGAGED
    assert box.view.gear_number == 7


@pytest.mark.parametrize(
    ("rests", "pushed"), [(False, ValveName.SPLIT_LOW), (True, ValveName.SPLIT_HIGH)]
)
def test_a_splitter_left_between_its_steps_is_brought_in_by_the_high_one_if_the_layshaft_rests(
    rests: bool, pushed: ValveName
) -> None:
    """As an outage in its change leaves it. The new gear has the low step, which the guard forbids
    while the layshaft rests: it comes behind the high one."""
    box, seen = aimed(9, 110.0), set()
    box.position_m |= dict.fromkeys((*MAIN_SLEEVES, Sleeve.SPLITTER), 0.0)
    box.clutch, shows = 0.0, box.snapshot

    def snapshot(**other: Any) -> StepSnapshot:
        shot = shows(**other)
        if rests and box.view.split is None:
            shot.speeds.layshaft = None  # type: ignore[misc]
        return shot

    box.snapshot = snapshot  # type: ignore[method-assign]
    box.until(State.NEUTRAL)
    box.ask(7)
    while box.view.split is None and box.running():
        seen |= {valve for valve in PUSHED[Sleeve.SPLITTER] if box.board.command(valve).on}
        box.step()
    assert seen == {pushed}
    assert box.view.split is (Split.HIGH if rests else Split.LOW)


def events(box: Box, number: int) -> dict[str, int]:
    """When things first happen in a shift, in us since it was asked for."""
    box.ask(number)
    began_us, found = box.now_us, {}

    def note(name: str, happens: bool) -> None:
        if happens:
            found.setdefault(name, box.now_us - began_us)

    while box.running():
        box.step()
        gear = SLEEVE_OF_MAIN[DRIVE_GEARS[number].main]
        note("opens", box.sequence.clutch is ClutchAction.OPEN)
        note("parted", box.clutch <= SHEET.clutch.kiss_share - SHEET.clutch.kiss_tolerance)
        note("moves", abs(box.position_m[FIRST_SECOND]) < STROKE_M - 1e-5)
        note("out", box.mesh is MainGear.NEUTRAL)
        note("brakes", box.pressure_pa > 0.0)
        note("in", box.position_m[gear.sleeve] * gear.direction > CONTACT_M)
    return found


def test_clutch_sleeve_and_brake_follow_each_other_without_waiting() -> None:
    """The old gear's sleeve moves as the plates part, and the brake's air comes as the gear is
    out, no sooner."""
    found = events(aimed(*UP[:2]), UP[2])
    assert found["opens"] <= 10_000
    assert -10_000 <= found["moves"] - found["parted"] <= 20_000
    assert 0 <= found["brakes"] - found["out"] <= 20_000


@pytest.mark.parametrize("phase", [k / 8.0 for k in range(8)])
def test_a_tooth_meets_the_middle_of_its_gap_from_any_angle(phase: float) -> None:
    """Both when the gear is braked down to its speed and when the engine brought it up."""
    for gear, speed, target in (UP, DOWN):
        box, met = Box(gear, speed, phase_rad=phase * PITCH), []
        box.face = lambda at, met=met: met.append(at) or False  # type: ignore[func-returns-value]
        box.ready()
        record = box.shift(target)
        assert (record.aimed, record.reference_known, record.attempts) == (True, True, 1)
        assert len(met) == 1
        assert abs(met[0]) < 0.5 * SHEET.dog.backlash_rad
        assert record.estimated_phase_rad == pytest.approx(met[0], abs=0.02 * PITCH)
        assert record.measured_contact_us is not None
        assert record.plan is not None
        travelled_us = record.measured_contact_us - record.plan.fire_us
        assert travelled_us == pytest.approx(1e6 * SHEET.sleeve.delay_s, abs=2_000)


def test_without_a_known_phase_the_sleeve_goes_by_the_slip_alone_and_the_record_says_so() -> None:
    box = Box(*UP[:2]).ready()
    record = box.shift(UP[2])
    assert (record.aimed, record.reference_known) == (False, False)
    assert record.strategy is Strategy.SPEED_WINDOW
    assert record.result is ShiftResult.ENGAGED
    assert aimed(*UP[:2]).shift(UP[2]).strategy is Strategy.TARGET_PHASE


def test_a_sleeve_that_meets_a_tooth_goes_back_and_is_fired_again_until_its_attempts_are_used() -> (
    None
):
    for blocked in (1, 2, 3):
        left, box = [blocked], aimed(*UP[:2])

        def face(_: float, left: list[int] = left) -> bool:
            left[0] -= 1
            return left[0] >= 0

        box.face = face
        # A tooth lets no sleeve in that rests on it.
        record = rested(box, left)
        assert record.attempts == min(blocked + 1, box.settings.limits.attempts)
        ended = ShiftResult.ENDED_IN_NEUTRAL if blocked == 3 else ShiftResult.ENGAGED
        fault = FaultCode.ENGAGE_FAILED if blocked == 3 else FaultCode.NONE
        assert (record.result, record.fault) == (ended, fault)
        assert box.trajectory.count(State.RETRACTING) == blocked


def rested(box: Box, left: list[int]) -> ShiftRecord:
    """The shift up; a sleeve that rests on a tooth stays there for as long as it is pushed."""
    passes, gear, resting = box.face, SLEEVE_OF_MAIN[DRIVE_GEARS[UP[2]].main], [False]

    def face(phase: float) -> bool:
        resting[0] = resting[0] or passes(phase)
        return resting[0]

    box.face = face
    box.ask(UP[2])
    began_us = None
    while box.running():
        box.step()
        if resting[0] and began_us is None:
            began_us = box.now_us
        if box.state is not State.ENGAGING and began_us is not None:
            limit_us = 1_000 * box.settings.limits.face_ms
            assert limit_us - 10_000 <= box.now_us - began_us <= limit_us + 20_000
            assert not box.board.command(PUSHED[gear.sleeve][1]).on
            box.position_m[gear.sleeve] *= 0.1  # its spring pulls it back
            resting[0], began_us = False, None
    box.until(State.IN_GEAR, State.NEUTRAL)
    return box.records[-1]
