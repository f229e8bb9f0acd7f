"""A recorded shift's trajectory as the repeated controller estimated it: layshaft, main shaft,
brake.

Valid from the step in which it was begun to the recorded sleeve's contact; from there on it is gone
on with by the learned model.
"""

from __future__ import annotations

import copy
import math
from bisect import bisect_left, bisect_right
from typing import Final, NamedTuple

from meshpoint.controller.estimate.brake_model import BrakeModel
from meshpoint.controller.models.layshaft import (
    BrakeInput,
    LayshaftState,
    MotionModel,
    predict,
    predict_spread,
)
from meshpoint.controller.models.swing import ShaftState
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.table import ShiftRecord
from meshpoint.kernels.records import Vector
from meshpoint.units import US

LEAST_FULL_PA: Final = 2e5
"""Above this pressure the brake's torque says more of its gain than of its touch."""
BEFORE_CONTACT_US: Final = 3_000
"""The measured time of contact may be late by this much: estimates nearer to it are left out."""


class Seen(NamedTuple):
    """What a step knew. Times in us of the sensor clock."""

    now_us: int
    lead_us: int
    """From there to the earliest activation that can still be met."""
    layshaft: LayshaftState | None
    """At its newest edge; None while the layshaft is not free."""
    main: ShaftState | None
    supply_pa: float


class RecordedTrajectory:
    """The steps of one shift, and from them the shafts at any time."""

    def __init__(self) -> None:
        self.steps: list[Seen] = []
        self.contact_us: float | None = None
        """When the recorded sleeve first met its gear, by its position; None if it never did."""
        self._model: MotionModel | None = None
        self._brake: BrakeInput | None = None
        self._states: list[LayshaftState] = []
        self._times: list[float] = []
        self._mains: list[ShaftState] = []

    def take(self, snapshot: StepSnapshot, record: ShiftRecord | None, brake: BrakeInput) -> None:
        """One more step: what was known in it, and the recorded shift and brake commands after
        it."""
        tracker = snapshot.layshaft
        state = tracker.latest() if tracker.free else None
        if state is not None and not state.is_finite:
            state = None
        if state is not None and self.contact_us is None:
            self._model = tracker.model
            self._brake = copy.deepcopy(brake)
        lead_us = snapshot.earliest_us - snapshot.now_us
        self.steps.append(Seen(snapshot.now_us, lead_us, state, snapshot.main, snapshot.supply_pa))
        if record is None or record.attempts == 0 or self.contact_us is not None:
            return
        if record.attempts == 1 and record.measured_contact_us is not None:
            self.contact_us = float(record.measured_contact_us)

    def close(self) -> None:
        """The shift has ended."""
        end_us = math.inf if self.contact_us is None else self.contact_us - BEFORE_CONTACT_US
        states = {
            step.layshaft.time_us: step.layshaft
            for step in self.steps
            if step.layshaft is not None and step.layshaft.time_us <= end_us
        }
        self._times = sorted(states)
        self._states = [states[time_us] for time_us in self._times]
        self._mains = [step.main for step in self.steps if step.main is not None]

    @property
    def is_usable(self) -> bool:
        """Whether the layshaft has been seen free, by an estimator that knows its own errors."""
        return bool(self._states and self._mains) and self._states[0].covariance is not None

    @property
    def model(self) -> MotionModel:
        """Of the free layshaft."""
        if self._model is None:
            raise RuntimeError("the layshaft has never been free")
        return self._model

    @property
    def brake(self) -> BrakeInput:
        """The recorded switches of the brake valve."""
        if self._brake is None:
            raise RuntimeError("the layshaft has never been free")
        return self._brake

    @property
    def newest(self) -> LayshaftState:
        """The last estimate before the recorded contact."""
        return self._states[-1]

    def before(self, time_us: float) -> LayshaftState:
        """The last estimate at or before a time; the first one where there is none."""
        return self._states[max(0, bisect_right(self._times, time_us) - 1)]

    @property
    def newest_us(self) -> float:
        """When that was."""
        return self._times[-1]

    @property
    def release_us(self) -> float | None:
        """When the recorded brake's pressure began to fall, for the last time before contact."""
        return last_release_us(self.brake, self.newest_us)

    @property
    def coasting_rad_s2(self) -> float:
        """What slows the layshaft without brake, in the end."""
        newest, friction_per_s = self.newest, float(self.model.part("friction_per_s")[0])
        return abs(friction_per_s * newest.omega_rad_s - newest.drag_rad_s2)

    @property
    def eased_rad_s2(self) -> float:
        """How much less drag there is in the end than when the brake was released, if all that the
        estimator has beyond the data sheet's friction falls with the speed."""
        newest = self.newest
        if self.release_us is None:
            return 0.0
        fast = self.before(self.release_us).omega_rad_s
        return max(0.0, -newest.drag_rad_s2) * max(0.0, 1.0 - newest.omega_rad_s / fast)

    def unseen_release(self, release_us: float | None, time_us: float) -> tuple[float, float]:
        """Angle (s2) and speed (s) that an acceleration of 1 rad/s2 since a release of the brake
        adds to this trajectory, if the recorded release has brought the same: up to the recorded
        contact that is in the trajectory already."""
        end_us = min(time_us, self.newest_us)
        own_us = math.inf if self.release_us is None else self.release_us
        kept_s = max(0.0, end_us - own_us) * US
        was_s2 = 0.5 * kept_s**2 + kept_s * (time_us - end_us) * US
        after_s = 0.0 if release_us is None else max(0.0, time_us - release_us) * US
        return 0.5 * after_s**2 - was_s2, after_s - kept_s

    def layshaft(self, time_us: float) -> LayshaftState:
        """The layshaft at a time, by the last estimate before it."""
        return predict(self.before(time_us), time_us, self.brake.arrays(), self.model)

    def layshaft_sd_rad(self, time_us: float) -> float:
        """Standard deviation of its angle there."""
        state, switches = self.before(time_us), self.brake.arrays()
        return predict_spread(state, time_us, switches, self.model).theta_sd_rad

    def main(self, time_us: float, known_us: float | None = None) -> ShaftState:
        """The main shaft's estimate for a time: of the first step after it, or of the last one.

        known_us: no step later than this is used."""
        times = [main.time_us for main in self._mains]
        index = min(bisect_left(times, time_us), len(times) - 1)
        if known_us is not None:
            index = min(index, max(0, bisect_right(times, known_us) - 1))
        return self._mains[index]

    def main_sd_rad(self, time_us: float) -> float:
        """Standard deviation of its angle there."""
        main = self.main(time_us)
        ahead_s = max(0.0, time_us - main.time_us) * 1e-6
        return math.hypot(main.theta_sd_rad, main.omega_sd_rad_s * ahead_s)


def last_release_us(brake: BrakeInput, until_us: float = math.inf) -> float | None:
    """When a brake's pressure begins to fall for the last time before then; None: it does not."""
    times, states = brake.arrays()
    if not times.size or states[-1] != 0.0 or times[-1] >= until_us:
        return None
    return float(times[-1])


class BrakeDifference:
    """The recorded trajectory by one brake, and with other brake switches than the recorded ones.

    Drag and torques that both have cancel; what remains is the brake's gain, law, touch and delays.
    known: the brake by which the recorded pressure was estimated; as_built: the one that is taken
    for true, with `gain` over that of the data sheet.
    """

    def __init__(
        self,
        trajectory: RecordedTrajectory,
        start_us: float,
        gain: float,
        known: BrakeModel,
        as_built: BrakeModel,
    ) -> None:
        self._trajectory = trajectory
        self._later_touch_pa = as_built.touch_pa.value - known.touch_pa.value
        self._model = trajectory.model.changed(segments=as_built.law())
        self._off_us, self._on_us = as_built.off_delay_us, as_built.on_delay_us
        self._recorded = self._delayed(trajectory.brake)
        full_pa = max(
            state.pressure_pa for state in (trajectory.before(start_us), trajectory.newest)
        )
        if full_pa > LEAST_FULL_PA:
            # The torque at full pressure has been measured: a later touch means a higher gain.
            gain *= full_pa / (full_pa - self._later_touch_pa)
        self._gain = gain
        self._start = self._touching(trajectory.before(start_us))

    def _delayed(self, switches: BrakeInput) -> Vector:
        own = switches.seen_through(0)
        own.set_delays(self._off_us, self._on_us)
        return own.arrays()

    def _touching(self, state: LayshaftState) -> LayshaftState:
        """A recorded estimate, its pressure above the touch of this brake."""
        above_pa = max(0.0, state.pressure_pa - self._later_touch_pa)
        return state._replace(gain=self._gain, pressure_pa=above_pa)

    def at(self, time_us: float, other: BrakeInput) -> LayshaftState:
        """The layshaft at a time with these switches."""
        if time_us <= self._start.time_us:
            return self._trajectory.layshaft(time_us)
        base = self._touching(self._trajectory.before(time_us))
        base = predict(base, time_us, self._recorded, self._model)
        was = predict(self._start, time_us, self._recorded, self._model)
        would = predict(self._start, time_us, self._delayed(other), self._model)
        return base._replace(
            theta_rad=base.theta_rad + would.theta_rad - was.theta_rad,
            omega_rad_s=base.omega_rad_s + would.omega_rad_s - was.omega_rad_s,
            pressure_pa=would.pressure_pa,
        )
