"""A job of study `fusion`: edges of all four shafts, filtered with and without further sensors.

The filters are the product's kernels: `thesis_filter` for the layshaft, `cruise_filter` for the
main shaft. A further shaft's edge becomes an edge of its neighbour by the exact ratio; the angle
between the two wheels, which nothing says, is their mean difference just before the shift. Every
estimate uses the edges up to its own instant, without the wait for a read.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from controller.clock import SensorClock, unwrap
from controller.edges import EdgeBatch, WheelEdges
from controller.kernels import Vector, cruise_filter, propagate, thesis_filter
from controller.kinematics import wrap_to_pitch
from controller.predictor import layshaft_model
from controller.settings import ControllerSettings
from controller.shafts import CruiseTracker, ShaftState
from dbc.frame import Frame
from dbc.link import Receiver
from dbc.messages import (
    ControllerStatus,
    EdgesInputFall,
    EdgesInputRise,
    EdgesLayshaftFall,
    EdgesLayshaftRise,
    EdgesMainFall,
    EdgesMainRise,
    EdgesPropellerFall,
    EdgesPropellerRise,
    Message,
    ReferencePhase,
)
from dbc.node import Node
from gearbox import GearboxSheet, drive_gear
from gearbox.sheet import Wheel
from rig_sim.settings import Preset
from testbench.estimation import Sample
from testbench.monitor import Monitor, identifiers
from testbench.rows import ShiftRow
from testbench.simulate import Setup, simulate
from testbench.studies.jobs import AsBuilt, Squares

BEFORE_US: Final = 150_000
"""The stretch before a shift from which a filter starts and the wheels' difference is taken."""
WHEELS: Final[dict[str, tuple[type[Message], type[Message]]]] = {
    "input": (EdgesInputRise, EdgesInputFall),
    "layshaft": (EdgesLayshaftRise, EdgesLayshaftFall),
    "main": (EdgesMainRise, EdgesMainFall),
    "propeller": (EdgesPropellerRise, EdgesPropellerFall),
}
LAYSHAFT, WITH_INPUT = "layshaft alone", "layshaft and input"
MAIN, WITH_PROPELLER = "main alone", "main and propeller"
Fused = dict[str, Squares]


class Edges:
    """Edges of one wheel gathered so far, as angles of the shaft that is estimated."""

    def __init__(self, batches: list[EdgeBatch], scale: float) -> None:
        self.time_us = np.concatenate([batch.time_us for batch in batches] or [np.empty(0)])
        angles = np.concatenate([batch.theta_rad for batch in batches] or [np.empty(0)])
        self.theta_rad = scale * angles

    def between(self, from_us: float, to_us: float) -> tuple[Vector, Vector]:
        """Times and angles of a stretch, its start not included."""
        inside = (self.time_us > from_us) & (self.time_us <= to_us)
        return self.time_us[inside], self.theta_rad[inside]


@dataclass(frozen=True)
class FusionRun:
    """The job: shifts of one truck; errors by variant over all of them."""

    sheet: GearboxSheet
    seed: int
    shifts: int
    as_built: AsBuilt

    def run(self) -> Fused:
        """Simulates, then filters each shift with every variant."""
        setup = Setup(
            self.sheet, ControllerSettings(), Preset.TRUCK, self.seed, self.shifts,
            as_built=dict(self.as_built),
        )  # fmt: skip
        recorder = _Recorder(self.sheet)
        monitor = Monitor(self.sheet, setup.settings, on_sample=recorder.sample)
        simulate(
            setup,
            lambda _time_us, frame: recorder.take(frame),
            lambda row: recorder.end_shift(row, monitor.estimation.brake.arrays()),
            monitor=monitor,
        )
        return recorder.squares


class _Recorder:
    """Reads all four wheels step by step, and filters when a shift is over."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._sheet = sheet
        self._settings = ControllerSettings()
        self._receiver = Receiver(*Node)
        edges = tuple(kind for pair in WHEELS.values() for kind in pair)
        self._wanted = identifiers((*edges, ControllerStatus, ReferencePhase))
        self._clock = SensorClock()
        wheels: dict[str, Wheel] = {name: getattr(sheet.wheels, _field(name)) for name in WHEELS}
        self._readers = {n: WheelEdges(w.teeth, w.duty_share) for n, w in wheels.items()}
        self._pitch_rad = {name: wheel.pitch_rad for name, wheel in wheels.items()}
        self._batches: dict[str, list[EdgeBatch]] = {name: [] for name in WHEELS}
        self._frames: dict[type, list[Message]] = {}
        self._samples: list[Sample] = []
        self._main: list[tuple[int, float, float]] = []
        self.squares: Fused = {}

    def take(self, frame: Frame) -> None:
        """One frame in bus order; a status frame closes a step."""
        if frame.can_id not in self._wanted:
            return
        message = self._receiver.receive(frame).message
        if isinstance(message, ControllerStatus):
            self._step(message.step_time_us)
        elif isinstance(message, ReferencePhase):
            time_us = unwrap(message.sample_time_us, self._clock.latest_us)
            self._main.append((time_us, message.main_angle_rad, message.main_speed_rad_s))
        elif message is not None:
            self._frames.setdefault(type(message), []).append(message)

    def _step(self, now_us: int) -> None:
        for name, (rise, fall) in WHEELS.items():
            risen, fallen = self._frames.get(rise, []), self._frames.get(fall, [])
            batch = self._readers[name].read(risen, fallen, self._clock, now_us)  # type: ignore[arg-type]
            if batch.time_us.size:
                self._batches[name].append(batch)
        self._frames.clear()

    def sample(self, sample: Sample) -> None:
        """The encoder's truth of the layshaft comes with every scored instant."""
        if sample.estimator == self._settings.estimator_name:
            self._samples.append(sample)

    def end_shift(self, row: ShiftRow, switches: tuple[Vector, Vector]) -> None:
        """Filters what was gathered, and forgets it."""
        samples = sorted(self._samples, key=lambda sample: sample.time_us)
        if samples:
            gear = drive_gear(row.to)
            split = self._sheet.split_mesh(gear.split).ratio
            range_ = self._sheet.range_mesh(gear.range_).ratio
            layshaft, input_ = self._edges("layshaft", 1.0), self._edges("input", split)
            main, propeller = self._edges("main", 1.0), self._edges("propeller", 1.0 / range_)
            model = layshaft_model(self._sheet, gear.split)
            self._layshaft(LAYSHAFT, (layshaft,), samples, switches, model)
            self._layshaft(WITH_INPUT, (layshaft, input_), samples, switches, model)
            span = samples[0].time_us, samples[-1].time_us
            self._main_shaft(MAIN, (main,), span)
            self._main_shaft(WITH_PROPELLER, (main, propeller), span)
        for batches in self._batches.values():
            batches.clear()
        self._samples, self._main = [], []

    def _edges(self, name: str, scale: float) -> Edges:
        return Edges(self._batches[name], scale)

    def _start(
        self, own: Edges, further: tuple[Edges, ...], start_us: int, pitch_rad: float
    ) -> tuple[ShaftState | None, list[float]]:
        """Where the shaft is at the start, and each further wheel's angle less its own before."""
        tracker = CruiseTracker(self._settings.cruise_filter, pitch_rad)
        times, angles = own.between(start_us - BEFORE_US, start_us)
        numbers = np.zeros(times.size, dtype=np.int64)
        tracker.edges(EdgeBatch(times[:8], angles[:8], numbers[:8], numbers[:8]))
        tracker.edges(EdgeBatch(times[8:], angles[8:], numbers[8:], numbers[8:]))
        state = tracker.at(start_us)
        offsets = []
        for wheel in further:
            there_us, there = wheel.between(start_us - BEFORE_US, start_us)
            inside = (there_us >= times[0]) & (there_us <= times[-1]) if times.size else []
            offsets.append(
                float(np.mean(there[inside] - np.interp(there_us[inside], times, angles)))
            )
        return state, offsets

    def _layshaft(
        self,
        name: str,
        wheels: tuple[Edges, ...],
        samples: list[Sample],
        switches: tuple[Vector, Vector],
        model: Vector,
    ) -> None:
        start_us = samples[0].time_us
        state, offsets = self._start(wheels[0], wheels[1:], start_us, self._pitch_rad["layshaft"])
        if state is None:
            return
        tuning = self._settings.thesis_filter
        w = np.array([tuning.w_angle_rad_s, tuning.w_speed_rad_s2, tuning.w_pressure_pa_s])
        times, angles = _merged(wheels, (0.0, *offsets), start_us, samples[-1].time_us)
        x = np.array([state.theta_rad, state.omega_rad_s, 0.0])
        p = _variances(state, 2e4)
        at_us = float(start_us)
        squares = self.squares.setdefault(name, Squares())
        for before, sample in pairwise(samples):
            new = (times > before.time_us) & (times <= sample.time_us)
            at_us = thesis_filter(
                x, p, at_us, times[new], angles[new], *switches, model, w, tuning.r_angle_rad**2
            )
            then = x.copy()
            propagate(then, at_us, float(sample.time_us), *switches, model)
            _add(squares, then, sample.theta_rad, sample.omega_rad_s, self._pitch_rad["layshaft"])

    def _main_shaft(self, name: str, wheels: tuple[Edges, ...], span: tuple[int, int]) -> None:
        truth = [entry for entry in self._main if span[0] <= entry[0] <= span[1]]
        state, offsets = self._start(wheels[0], wheels[1:], span[0], self._pitch_rad["main"])
        if state is None or not truth:
            return
        tuning = self._settings.cruise_filter
        times, angles = _merged(wheels, (0.0, *offsets), span[0], span[1])
        x = np.array([state.theta_rad, state.omega_rad_s])
        p = np.diag([state.theta_sd_rad**2, state.omega_sd_rad_s**2])
        at_us, before_us = float(span[0]), span[0]
        squares = self.squares.setdefault(name, Squares())
        for time_us, theta, omega in truth:
            new = (times > before_us) & (times <= time_us)
            before_us = time_us
            at_us = cruise_filter(
                x, p, at_us, times[new], angles[new], tuning.acceleration_rad_s2,
                tuning.edge_time_us * 1e-6,
            )  # fmt: skip
            then = np.array([x[0] + x[1] * (time_us - at_us) * 1e-6, x[1]])
            _add(squares, then, theta, omega, self._pitch_rad["main"])


def _field(name: str) -> str:
    return "input_" if name == "input" else name


def _variances(state: ShaftState, pressure_sd_pa: float) -> Vector:
    return np.diag([state.theta_sd_rad**2, state.omega_sd_rad_s**2, pressure_sd_pa**2])


def _merged(
    wheels: tuple[Edges, ...], offsets: tuple[float, ...], from_us: int, to_us: int
) -> tuple[Vector, Vector]:
    """The edges of all wheels as one shaft's, in order of time."""
    parts = [wheel.between(from_us, to_us) for wheel in wheels]
    times = np.concatenate([part[0] for part in parts])
    angles = np.concatenate([part[1] - off for part, off in zip(parts, offsets, strict=True)])
    order = np.argsort(times, kind="stable")
    return times[order], angles[order]


def _add(squares: Squares, x: Vector, theta: float, omega: float, pitch_rad: float) -> None:
    error = wrap_to_pitch(float(x[0]) - theta, pitch_rad)
    squares.samples += 1
    squares.angle_rad += error
    squares.angle_rad2 += error * error
    squares.speed_rad2_s2 += (float(x[1]) - omega) ** 2
