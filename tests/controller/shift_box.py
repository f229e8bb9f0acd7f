"""The shift sequence alone, on a gearbox of a few lines that moves as the data sheet says.

No bus, no sensors' errors, no estimators: speeds and angles are given to the sequence as they are.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, Final

from chamber_sleeve import ChamberSleeve

from meshpoint.controller.estimate.reference import PhaseReferences
from meshpoint.controller.measure.gearbox_view import GearboxView
from meshpoint.controller.measure.inputs import ShaftSpeeds
from meshpoint.controller.models.layshaft import (
    LayshaftState,
    first_order_law,
    free_motion,
)
from meshpoint.controller.models.swing import ShaftState
from meshpoint.controller.plan.strategy import BUS_US
from meshpoint.controller.settings.learned import SleeveLawRecords, SleeveRecords
from meshpoint.controller.settings.settings import ControllerSettings, Timing
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.controller.shift.sequence import ShiftSequence
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.table import ShiftRecord
from meshpoint.controller.shift.valve_board import ValveBoard
from meshpoint.controller.sleeve.law import Prior, SleeveLaw, law_record
from meshpoint.dbc.messages import (
    ClutchAction,
    FaultCode,
    SleevesAux,
    SleevesMain,
)
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.dbc.sensor_time import READ_CYCLE_US
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
OIL_NM: Final = 16.0
"""Drag at the layshaft."""
PUSH_M_S2: Final = 2.0 * CONTACT_M / (SHEET.sleeve.delay_s - 1e-3 * DELAY_MS) ** 2
"""Of splitter and range."""
LEARNED_SHARE: Final = 0.3
"""Of what the sheet leaves open of a sleeve, this is left where its law is known."""
SPOOL_US: Final = 100
"""What is commanded is looked at so often."""


def side_of(step: Split | Range) -> int:
    return 1 if step.name == "HIGH" else -1


@dataclass
class Box:
    """The gearbox, the engine, the clutch, and the sequence that shifts them, a tick a step. The
    sensors are read each 10 ms."""

    gear: int = 7
    input_rad_s: float = 150.0
    settings: ControllerSettings = field(default_factory=ControllerSettings)
    phase_rad: float | None = None
    """Of all gears at angles of zero, and the sleeves' laws are known; None: nothing is."""
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
    drag_nm: float = 0.0
    """At the layshaft, as the sequence knows it."""

    def __post_init__(self) -> None:
        gear = DRIVE_GEARS[self.gear]
        self.now_us, self.seen = 5_000_000, []
        self.tick_us = self.settings.timing.tick_us
        self.position_m = dict.fromkeys(Sleeve, 0.0)
        side = SLEEVE_OF_MAIN[gear.main]
        self.position_m[side.sleeve] = STROKE_M * side.direction
        self.position_m[Sleeve.SPLITTER] = STROKE_M * side_of(gear.split)
        self.position_m[Sleeve.RANGE] = STROKE_M * side_of(gear.range_)
        self.tracks = {sleeve: deque([at], 11) for sleeve, at in self.position_m.items()}
        self.speed_m_s = dict.fromkeys(Sleeve, 0.0)
        self.sleeves = {one: ChamberSleeve(self.position_m[one]) for one in MAIN_SLEEVES}
        self.clutch, self.engine, self.torque = 1.0, self.input_rad_s, self.pull
        self.layshaft = self.input_rad_s * SHEET.split_mesh(gear.split).ratio
        self.main = self.layshaft * SHEET.main_mesh(gear.main).ratio
        self.propeller = self.main * SHEET.range_mesh(gear.range_).ratio
        self.theta_layshaft = self.theta_main = 0.0
        self.pressure_pa = 0.0
        self.out_us = self.air_us = 0
        waiting = [False] * ((BUS_US + DELAY_MS * MS_US) // SPOOL_US)
        self.spools: dict[ValveName, deque[bool]] = {one: deque(waiting) for one in ValveName}
        """What each valve's spool does in the next tenths of a millisecond."""
        self.split, self.range = gear.split, gear.range_
        self.board = ValveBoard(self.settings.valve_timing)
        self.references = PhaseReferences(SHEET)
        if self.phase_rad is not None:
            for each in SLEEVE_OF_MAIN:
                self.references.adopt(each, -self.phase_rad, 1)  # type: ignore[arg-type]
        self.view = GearboxView(SHEET)
        self.sequence = ShiftSequence(SHEET, self.settings, self.board, self.references)
        if self.phase_rad is not None:
            prior = SleeveLaw(SHEET).prior(SHEET)
            law = law_record(Prior(prior.mean, LEARNED_SHARE**2 * prior.covariance), 10)
            known = {one.name.lower(): law for one in MAIN_SLEEVES}
            self.sequence.sleeves.restore(SleeveRecords(), SleeveLawRecords(**known))
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

    def phase(self, gear: MainGear, after_s: float = 0.0) -> float:
        """True phase of a gear, now or so much later."""
        ratio = SHEET.main_mesh(gear).ratio
        angle = ratio * self.theta_layshaft - self.theta_main + (self.phase_rad or 0.0)
        return math.remainder(angle + after_s * self.slip(gear), PITCH)

    def step(self) -> State:
        """A tick of the gearbox by what the last step has commanded, then the next step."""
        self._command()
        for _ in range(self.tick_us // MS_US):
            self._millisecond(self.now_us + MS_US)
            self.now_us += MS_US
            for sleeve, at in self.position_m.items():
                self.tracks[sleeve].appendleft(at)
            if self.has_read:
                self.sense({one: tuple(samples)[:10] for one, samples in self.tracks.items()})
        self.sequence.step(self.snapshot())
        for change in self.sequence.take_mesh_changes():
            self.references.take(change)
        self.seen.append((self.now_us, self.state))
        if self.sequence.finished is not None:
            self.records.append(self.sequence.finished)
        return self.state

    @property
    def has_read(self) -> bool:
        """Whether the sensors are read now."""
        return self.now_us % READ_CYCLE_US == 0

    def _command(self) -> None:
        """Sends what is commanded: it takes effect after the bus and the valve's delay."""
        self.sequence.notify_actuators(self.now_us)
        arrives_us = self.now_us + BUS_US
        for valve, spool in self.spools.items():
            times = range(arrives_us, arrives_us + self.tick_us, SPOOL_US)
            is_taken = valve not in self.refused
            spool.extend(is_taken and self.board.driven(valve, at_us) for at_us in times)
        for low, high in (PUSHED[sleeve] for sleeve in MAIN_SLEEVES):
            both = zip(self.spools[low], self.spools[high], strict=True)
            assert not any(one and other for one, other in both), "both coils of a sleeve are on"

    def _millisecond(self, at_us: int) -> None:
        dt, meshed = 1e-3, self.mesh
        for sleeve in MAIN_SLEEVES:
            self._push_main(sleeve)
        for sleeve in (Sleeve.SPLITTER, Sleeve.RANGE):
            low, high = (self._on_share(valve) for valve in PUSHED[sleeve])
            push = 0 if sleeve in self.stuck else round(high) - round(low)
            before = self.speed_m_s[sleeve] if push * self.speed_m_s[sleeve] > 0.0 else 0.0
            self.speed_m_s[sleeve] = before + push * PUSH_M_S2 * dt
            at_m = self.position_m[sleeve] + self.speed_m_s[sleeve] * dt
            self.position_m[sleeve] = min(max(at_m, -STROKE_M), STROKE_M)
        if meshed is not MainGear.NEUTRAL and self.mesh is MainGear.NEUTRAL:
            self.out_us = at_us
        self._shafts(self._on_share(ValveName.BRAKE), dt)
        if self.pressure_pa > 0.0 and self.air_us == 0:
            self.air_us = at_us

    def _on_share(self, valve: ValveName) -> float:
        """For how much of the next millisecond a valve's spool lets air in."""
        spool = self.spools[valve]
        return sum(spool.popleft() for _ in range(MS_US // SPOOL_US)) * SPOOL_US / MS_US

    def _push_main(self, sleeve: Sleeve) -> None:
        moved, (low, high) = self.sleeves[sleeve], PUSHED[sleeve]
        if self.position_m[sleeve] != moved.x_m:
            moved.put(self.position_m[sleeve])
        gears = {side.direction: g for g, side in SLEEVE_OF_MAIN.items() if side.sleeve is sleeve}
        for since_us in range(0, MS_US, SPOOL_US):
            on = (self.spools[low].popleft(), self.spools[high].popleft())
            moved.advance(
                on,
                self.supply_pa,
                lambda way, at=since_us: self.face(self.phase(gears[way], 1e-6 * at)),
                sleeve in self.stuck,
            )
        self.position_m[sleeve] = moved.x_m

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

    def sense(self, tracks: dict[Sleeve, tuple[float, ...]]) -> None:
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
        self.view.brake_gauge_pa = self.pressure_pa
        self.view.work_out()

    def snapshot(self, **other: Any) -> StepSnapshot:
        """What the sequence is given."""
        state = LayshaftState(
            self.now_us, self.theta_layshaft, self.layshaft, self.pressure_pa, 1e-4, 0.01, 1e3
        )
        law = first_order_law(1.0 / SHEET.brake.time_constant_s, SHEET.air.supply_gauge_pa)
        free = self.mesh is MainGear.NEUTRAL and self.clutch < 0.3
        tracker: Any = SimpleNamespace(
            free=free, latest=lambda: state, at=lambda _: state, drag_nm=lambda _: self.drag_nm,
            model=free_motion(SHEET, self.split, law, self.settings.crossing_filter),
        )  # fmt: skip
        main = ShaftState(self.now_us, self.theta_main, self.main, 1e-4, 0.01)
        propeller = self.propeller if self.hears_propeller else None
        split = self.split
        input_ = None if split is None else self.layshaft / SHEET.split_mesh(split).ratio
        speeds = ShaftSpeeds(SHEET, input_, self.layshaft, self.main, propeller)
        reported = tuple(
            valve not in self.refused and not self.board.command(valve).rests(self.now_us)
            for valve in ValveName
        )
        values = {
            "now_us": self.now_us, "earliest_us": self.now_us + LEAD_US, "view": self.view,
            "layshaft": tracker, "main_at": lambda _: main, "speeds": speeds, "lost": self.lost,
            "driven": reported, "supply_pa": self.supply_pa, "engine_rad_s": self.engine,
            "engine_torque_share": round(self.torque, 2),
            "is_self_tested": self.is_self_tested,
            "brake_delays_us": (DELAY_MS * MS_US, DELAY_MS * MS_US),
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


def ticking(tick_ms: int) -> ControllerSettings:
    """Settings with this tick."""
    return ControllerSettings(timing=Timing(tick_ms=tick_ms))


def aimed(gear: int, input_rad_s: float = 150.0, **other: Any) -> Box:
    """A box whose phases are known, in gear."""
    return Box(gear, input_rad_s, phase_rad=0.01, **other).ready()


UP, DOWN, SPLIT, RANGED = (7, 150.0, 9), (9, 110.0, 7), (7, 150.0, 8), (6, 190.0, 7)
FAST_UP: Final = (7, 190.0, 9)
"""Here the brake is released before the sleeve is fired, on the way UP after it."""
WAYS: Final = {
    UP: [State.IN_GEAR, State.CLUTCH_OPENING, State.DISENGAGING, State.SYNCHRONISING,
         State.ENGAGING, State.CLUTCH_CLOSING, State.IN_GEAR],
    FAST_UP: [State.IN_GEAR, State.CLUTCH_OPENING, State.DISENGAGING, State.SYNCHRONISING,
              State.COASTING, State.ENGAGING, State.CLUTCH_CLOSING, State.IN_GEAR],
    DOWN: [State.IN_GEAR, State.CLUTCH_OPENING, State.DISENGAGING, State.SPEED_RAISING,
           State.CLUTCH_PARTING, State.COASTING, State.ENGAGING, State.CLUTCH_CLOSING,
           State.IN_GEAR],
    SPLIT: [State.IN_GEAR, State.CLUTCH_OPENING, State.SPLITTER_CHANGING, State.CLUTCH_CLOSING,
            State.IN_GEAR],
}  # fmt: skip
