"""The guard's inputs, taken directly from the sensor frames of each step.

Nothing here comes from the observer. Speeds are teeth over time in the newest frames; positions and
pressures are the newest samples. A gear that is in mesh although the position sensors show neutral
is recognised by the shafts' turns (row 13).
"""

from __future__ import annotations

from collections import deque
from typing import Any, Final, NamedTuple

from meshpoint.controller.guard.limits import GUARD_NEUTRAL_M, GuardLimits
from meshpoint.controller.sensing.edge_speed import EdgeSpeed, Speed, Turned
from meshpoint.controller.sensing.step_inputs import StepInputs
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import (
    EdgesInputRise,
    EdgesLayshaftRise,
    EdgesMainRise,
    EdgesPropellerRise,
    GearboxSensors,
    SleevesAux,
    SleevesMain,
)
from meshpoint.gearbox import GearboxSheet
from meshpoint.units import TURN

GUARD_FRESH_US: Final = 45_000
"""Samples older than this count as lost, even if the counters of their frames are valid."""
AGREE_US: Final = 100_000
"""Turns of gear and sleeve are compared over two consecutive intervals of this length."""
AGREE_RAD_S: Final = 0.15
"""If the mean slip is below this (1.4 rpm) in both intervals, gear and sleeve turn as one."""
TURNING_RAD_S: Final = 10.0
"""Below this layshaft speed the ratios of the gears cannot be told apart."""
HALF_WRAP: Final = 1 << 31
OVER_SAMPLES: Final = 3
SAMPLE_S: Final = 1e-3
"""A sleeve's speed is taken over so many samples of 1 ms."""
CLUTCH_GAP_US: Final = 25_000
"""Samples of the clutch further apart say nothing of its speed."""
SLOW: Final = (SleevesMain, SleevesAux, GearboxSensors)


class GuardInputs(NamedTuple):
    """The inputs of one step, SI. Speeds: input shaft, layshaft, main shaft, propeller shaft; None
    if stale or invalid."""

    now_us: int
    positions_m: tuple[float, float, float, float]
    """First/second, crawl/third, splitter, range."""
    clutch_closed: float
    supply_pa: float
    brake_pa: float
    speeds: tuple[Speed | None, Speed | None, Speed | None, Speed | None]
    agreeing: int
    """Number of the main valve whose gear turns with its sleeve although both sleeves are measured
    in neutral; 0 if there is none."""
    valid: bool
    """Positions, clutch and pressures come from channels whose E2E state is VALID and are recent,
    and no sensor reports itself out of range."""
    engine_rad_s: float | None = None
    """The engine's speed; None where it says none any more."""
    requested_gear: int | None = None
    """The gear asked for in this step; None where none was."""
    positions_us: int = 0
    """When the positions of the main sleeves were sampled."""
    speeds_m_s: tuple[float, float] = (0.0, 0.0)
    """Of the two main sleeves, over their newest samples."""
    clutch_us: int = 0
    """When the clutch's position was sampled."""
    engine_torque_share: float | None = None
    """The engine's torque, as a share of its reference torque; None where it says none any more."""
    clutch_per_s: float = 0.0
    """How fast the clutch closes; negative: opens."""


class GuardView:
    """Makes `GuardInputs` from the frames of each step."""

    def __init__(self, sheet: GearboxSheet, limits: GuardLimits) -> None:
        wheels = sheet.wheels
        self._main = limits.main
        self._teeth = (wheels.layshaft.teeth, wheels.main.teeth)
        self._shafts: dict[type, EdgeSpeed] = {
            EdgesInputRise: EdgeSpeed(wheels.input_.teeth),
            EdgesLayshaftRise: EdgeSpeed(wheels.layshaft.teeth),
            EdgesMainRise: EdgeSpeed(wheels.main.teeth),
            EdgesPropellerRise: EdgeSpeed(wheels.propeller.teeth),
        }
        self._newest: dict[type, Any] = {}
        self._engine: tuple[int, float | None, float | None] = (0, None, None)
        self._clutch: tuple[int, float] | None = None
        self._clutch_per_s = 0.0
        self._turns: deque[tuple[Turned, Turned]] = deque()

    def take(self, inputs: StepInputs, receiver: Receiver, now_us: int) -> GuardInputs:
        """Takes one step's frames; now_us: sensor time of the step."""
        for kind, shaft in self._shafts.items():
            for frame in inputs.edges[kind]:
                shaft.take(frame, now_us)
        for messages in (inputs.sleeves_main, inputs.sleeves_aux, inputs.sensors):
            if messages:
                self._newest[type(messages[-1])] = messages[-1]
        for sample in inputs.sensors:
            self._see_clutch(now_us - _age_us(sample, now_us), sample.clutch_position_fraction)
        for engine in inputs.engine:
            torque = engine.actual_engine_torque_fraction
            self._engine = (now_us, engine.engine_speed_rad_s, torque)
        heard_us, engine_rad_s, torque_share = self._engine
        if now_us - heard_us > GUARD_FRESH_US:
            engine_rad_s = torque_share = None
        a, b, c, d = [shaft.at(now_us) for shaft in self._shafts.values()]
        if len(self._newest) < len(SLOW):
            unseen = GuardInputs(now_us, (0.0,) * 4, 1.0, 0.0, 0.0, (a, b, c, d), 0, valid=False)
            return unseen._replace(requested_gear=inputs.requested_gear)
        main, aux, sensors = [self._newest[kind] for kind in SLOW]
        positions = (
            main.sleeve_first_second_m[0],
            main.sleeve_crawl_third_m[0],
            aux.sleeve_splitter_m[0],
            aux.sleeve_range_m[0],
        )
        return GuardInputs(
            now_us,
            positions,
            sensors.clutch_position_fraction,
            sensors.supply_pressure_pa,
            sensors.brake_pressure_pa,
            (a, b, c, d),
            self._agreeing(positions, b, c, now_us),
            self._valid(receiver, now_us),
            engine_rad_s,
            inputs.requested_gear,
            now_us - _age_us(main, now_us),
            (_speed_m_s(main.sleeve_first_second_m), _speed_m_s(main.sleeve_crawl_third_m)),
            now_us - _age_us(sensors, now_us),
            torque_share,
            self._clutch_per_s,
        )

    def _see_clutch(self, time_us: int, closed: float) -> None:
        before, self._clutch = self._clutch, (time_us, closed)
        self._clutch_per_s = 0.0
        if before is not None and 0 < time_us - before[0] <= CLUTCH_GAP_US:
            self._clutch_per_s = (closed - before[1]) / (time_us - before[0]) * 1e6

    def _valid(self, receiver: Receiver, now_us: int) -> bool:
        if not receiver.all_valid(SLOW):
            return False
        if self._newest[SleevesMain].sensor_fault or self._newest[SleevesAux].sensor_fault:
            return False
        return max([_age_us(newest, now_us) for newest in self._newest.values()]) <= GUARD_FRESH_US

    def _agreeing(
        self,
        positions: tuple[float, ...],
        layshaft: Speed | None,
        main: Speed | None,
        now_us: int,
    ) -> int:
        """The valve of `GuardInputs.agreeing`, from the turns since both sleeves were in
        neutral."""
        turns = self._turns
        out = max(abs(positions[0]), abs(positions[1])) > GUARD_NEUTRAL_M
        slow = layshaft is None or main is None or layshaft.omega_rad_s < TURNING_RAD_S
        if out or slow:
            turns.clear()
            return 0
        turned = (self._shafts[EdgesLayshaftRise].turned, self._shafts[EdgesMainRise].turned)
        if turned[0] is None or turned[1] is None:
            turns.clear()
            return 0
        turns.append((turned[0], turned[1]))
        while len(turns) > 1 and now_us - turns[1][0].time_us >= 2 * AGREE_US:
            turns.popleft()
        if now_us - turns[0][0].time_us < 2 * AGREE_US:
            return 0
        middle = next(t for t in turns if now_us - t[0].time_us <= AGREE_US or t is turns[-1])
        for valve, gear in self._main.items():
            halves = ((turns[0], middle), (middle, turns[-1]))
            if all(abs(self._slip(gear.ratio, *half)) < AGREE_RAD_S for half in halves):
                return valve
        return 0

    def _slip(
        self, ratio: float, before: tuple[Turned, Turned], after: tuple[Turned, Turned]
    ) -> float:
        """Mean slip (rad/s) between two readings, from whole teeth and the times of their edges."""
        layshaft, main = (
            TURN / teeth * (late.teeth - early.teeth) * 1e6 / max(1, late.time_us - early.time_us)
            for teeth, early, late in zip(self._teeth, before, after, strict=True)
        )
        return ratio * layshaft - main


def _speed_m_s(samples_m: tuple[float, ...]) -> float:
    """Speed (m/s) from the newest samples, 1 ms apart, the newest first."""
    return (samples_m[0] - samples_m[OVER_SAMPLES]) / (OVER_SAMPLES * SAMPLE_S)


def _age_us(message: Any, now_us: int) -> int:
    return int((now_us - message.sample_time_us + HALF_WRAP) % (2 * HALF_WRAP)) - HALF_WRAP
