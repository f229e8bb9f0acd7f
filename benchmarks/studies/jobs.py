"""Closed-loop runs as jobs: shifts in virtual time, and what studies read off their frames."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, NamedTuple

from meshpoint.bench.schedules import UPSHIFTS, Pairs
from meshpoint.bench.setup import Setup
from meshpoint.bench.simulate import simulate
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import GearboxSensors, Message, ShiftOutcome, ShiftResult
from meshpoint.dbc.node import Node
from meshpoint.dbc.sensor_time import unwrap
from meshpoint.gearbox import GearboxSheet
from meshpoint.kernels.records import Vector
from meshpoint.results.estimation import Sample
from meshpoint.results.monitor import Monitor
from meshpoint.results.road_speed import span_us
from meshpoint.results.rows import ShiftRow
from meshpoint.rig_sim.settings import DEFAULT_PROFILE, Preset, Profile
from meshpoint.rig_sim.truck.as_built import linear, nominal

AsBuilt = tuple[tuple[str, float], ...]
"""As-built values that are fixed, by name; the rest is drawn from the seed."""
ENGAGEMENT: Final = ("dog.", "sleeve.model")
OUTCOME_ID: Final = CODECS["ShiftOutcome"].spec.can_id
SENSORS_ID: Final = CODECS["GearboxSensors"].spec.can_id


class Delay(NamedTuple):
    """Valve to contact, ms: as the position sensor showed it, and by the rig's truth."""

    gear: int
    measured_ms: float
    true_ms: float
    on_tooth: bool


@dataclass
class ShiftErrors:
    """Sums of squared errors of one estimator over one shift, for 5.10."""

    samples: int = 0
    angle_rad: float = 0.0
    """Sum, not squared: the mean is the wheel's unobservable tooth offset."""
    angle_rad2: float = 0.0
    speed_rad2_s2: float = 0.0

    def add(self, sample: Sample) -> None:
        """One encoder instant."""
        self.put(sample.theta_error_rad, sample.omega_error_rad_s)

    def put(self, theta_error_rad: float, omega_error_rad_s: float) -> None:
        """One error of angle and speed."""
        self.samples += 1
        self.angle_rad += theta_error_rad
        self.angle_rad2 += theta_error_rad**2
        self.speed_rad2_s2 += omega_error_rad_s**2


Scores = dict[str, ShiftErrors]
"""One shift's sums by estimator."""


@dataclass
class ShiftTrace:
    """One shift while the model holds, from neutral to contact; sensor time in us."""

    samples: list[Sample] = field(default_factory=list)
    pressure_us: list[int] = field(default_factory=list)
    pressure_pa: list[float] = field(default_factory=list)
    """Absolute, as the sensor says; also before and after the model holds."""
    switches: Vector | None = None
    """When the brake's pressure reacts, and u from then on."""

    def of(self, estimator: str) -> list[Sample]:
        """The samples of one estimator."""
        return [sample for sample in self.samples if sample.estimator == estimator]


@dataclass
class LoopResult:
    """What came of a closed-loop run."""

    rows: list[ShiftRow]
    estimation: dict[str, dict[str, float | int | None]]
    """RMS by 5.10 over the whole run, by estimator."""
    delays: list[Delay]
    traces: list[ShiftTrace]
    scores: list[Scores]
    """One a shift."""

    @property
    def known(self) -> list[ShiftRow]:
        """The shifts that could aim."""
        return [row for row in self.rows if row.reference == "known"]


@dataclass(frozen=True)
class LoopJob:
    """A job: controller, rig and bench for some shifts; traces of the first `keep`."""

    sheet: GearboxSheet
    settings: ControllerSettings
    preset: Preset
    seed: int
    shifts: int
    pairs: Pairs = UPSHIFTS
    as_built: AsBuilt = ()
    keep: int = 0
    profile: Profile = DEFAULT_PROFILE

    def run(self) -> LoopResult:
        """Simulates it."""
        setup = Setup(
            sheet=self.sheet,
            settings=self.settings,
            preset=self.preset,
            seed=self.seed,
            shifts=self.shifts,
            pairs=self.pairs,
            as_built=dict(self.as_built),
            profile=self.profile,
        )
        collector = _Collector(self)
        monitor = Monitor(self.sheet, self.settings, on_sample=collector.sample)
        result = simulate(
            setup,
            lambda _time_us, frame: collector.take(frame),
            lambda _row: collector.end_shift(monitor.estimation.brake.arrays()),
            monitor=monitor,
        )
        delays = [
            Delay(row.to, measured, row.delay_ms, row.contact == "tooth")
            for row, measured in zip(result.rows, collector.delays, strict=True)
            if measured is not None and row.delay_ms is not None
        ]
        return LoopResult(
            result.rows, result.estimation, delays, collector.traces, collector.scores
        )


def linear_with_teeth() -> AsBuilt:
    """The thesis's linear gearbox with the truck's dog teeth at their defaults: faces that rub,
    flanks that strike; all else exactly as the data sheet says."""
    teeth = {k: v for k, v in nominal().items() if k.startswith(ENGAGEMENT)}
    return tuple(sorted((linear() | teeth).items()))


class _Collector:
    """Reads delays off the outcomes, and keeps what traces and scores need."""

    def __init__(self, job: LoopJob) -> None:
        self._receiver = Receiver(*Node)
        self._job = job
        self._trace = ShiftTrace()
        self._squares: Scores = {}
        self._latest_us = 0
        self.scores: list[Scores] = []
        self.delays: list[float | None] = []
        """One a shift; None where the sensor saw no contact, or not at the first attempt."""
        self.traces: list[ShiftTrace] = []

    @property
    def _keeps(self) -> bool:
        return len(self.traces) < self._job.keep

    def take(self, frame: Frame) -> None:
        """One frame in bus order."""
        if frame.can_id == OUTCOME_ID:
            self._outcome(self._receiver.receive(frame).message)
        elif frame.can_id == SENSORS_ID and self._keeps:
            self._sensors(self._receiver.receive(frame).message)

    def _outcome(self, outcome: Message | None) -> None:
        if not isinstance(outcome, ShiftOutcome) or outcome.result is ShiftResult.REFUSED:
            return
        measured = None
        if outcome.attempts == 1 and outcome.measured_contact_time_us:
            measured = span_us(outcome.measured_contact_time_us, outcome.fire_time_us) / 1000.0
        self.delays.append(measured)

    def _sensors(self, sensors: Message | None) -> None:
        if not isinstance(sensors, GearboxSensors):
            return
        stamp = sensors.sample_time_us
        self._latest_us = unwrap(stamp, self._latest_us) if self._latest_us else stamp
        self._trace.pressure_us.append(self._latest_us)
        self._trace.pressure_pa.append(sensors.brake_pressure_pa)

    def sample(self, sample: Sample) -> None:
        """An estimator was scored."""
        self._squares.setdefault(sample.estimator, ShiftErrors()).add(sample)
        if self._keeps:
            self._trace.samples.append(sample)

    def end_shift(self, switches: Vector) -> None:
        """A shift's row is there: what was gathered is this shift's."""
        self.scores.append(self._squares)
        self._squares = {}
        if self._keeps:
            # an encoder frame holds its samples newest first
            self._trace.samples.sort(key=lambda sample: sample.time_us)
            self._trace.switches = switches
            self.traces.append(self._trace)
            self._trace = ShiftTrace()
