"""Slip and phase of the target gear at times to come, predicted from the estimates of one step.

The layshaft is predicted by zero-order hold over the brake commands, the main shaft with the swing
of its driveline, or with constant acceleration where that is not estimated. Many times at once are
worked out by kernels, compiled by numba; with NUMBA_DISABLE_JIT=1 the same code runs as plain
Python.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.estimate.reference import LEARNED_SD_RAD, PhaseReferences
from meshpoint.controller.models.backlash import LashTrajectory
from meshpoint.controller.models.layshaft import (
    BrakeInput,
    LayshaftState,
    MotionModel,
    Ticks,
    outlook,
    predict,
    predict_spread,
)
from meshpoint.controller.models.layshaft_kernels import MODEL, STATE, STATES, copy_on, travel
from meshpoint.controller.models.swing import OUTLOOK_US, ShaftState, between_ticks, ticks_over
from meshpoint.gearbox import MainGear
from meshpoint.gearbox.kinematics import slip_rad_s
from meshpoint.kernels.jit import compiled, inlined, record_on
from meshpoint.kernels.records import WORD_BYTES, Vector, filled, layout_of
from meshpoint.units import US

MOST_TICKS = 16
"""What will be known of the layshaft is worked out at this many ticks of `OUTLOOK_US`."""
MOST_STEPS = 40
LEAST_ROOT_SHARE = 1e-3
CLOSE_RAD_S = 1e-4
"""Tolerance of the root search: some microseconds at the brake's full torque."""
GROWTH: Final = (0.0, 0.5, 1.0, 1.5)
"""How the phase's variance grows with the time ahead is worked out at these shares of the time
from one measurement to the next, beyond the least."""


class Meeting:
    """The gear's two shafts, and the times at which their trajectory is asked for."""

    layshaft_us: float
    """Time of the layshaft's state."""
    first_us: float
    step_us: float
    i_gear: float
    reference_rad: float
    """Phase reference."""


MEETING: Final = layout_of(Meeting)


@compiled
def trajectory(x: Vector, switches: Vector, model: Vector, meeting: Vector, found: Vector) -> None:
    """Phase (unwrapped) and slip at equal steps of time; written to the rows of found (2, n), in
    which the main shaft's angle and speed at these times are given.

    x: the layshaft's `State`; switches and model as for `travel`; meeting: a `Meeting`."""
    mesh = record_on(meeting, MEETING)
    meet(x.copy(), switches, model, mesh, mesh.first_us, found)


@compiled
def trajectories(
    x: Vector, commands: Vector, model: Vector, meeting: Vector, releases: Vector, found: Vector
) -> None:
    """As `trajectory`, after each of m releases of the brake, instead of the switches: found (m, 2,
    n).

    commands (3, k): times of the brake valve's switches, its states from then on, and when pressure
    begins to react; releases (3, m): times of the releases, when pressure begins to react to them,
    and the first time that is asked for after each."""
    mesh, ahead = record_on(meeting, MEETING), np.empty(STATES)
    switches = np.empty((2, commands.shape[1] + 1))
    for r in range(releases.shape[1]):
        release(commands, releases[0, r], releases[1, r], switches)
        copy_on(x, ahead)
        meet(ahead, switches, model, mesh, releases[2, r], found[r])


@inlined
def release(commands: Vector, release_us: float, reacts_us: float, switches: Vector) -> None:
    """The switches of `BrakeInput.with_release`; room that is left is filled with switches that
    never come."""
    kept = commands.shape[1]
    while kept > 0 and (commands[1, kept - 1] == 0.0 or commands[0, kept - 1] >= release_us):
        kept -= 1
    for k in range(switches.shape[1]):
        switches[0, k], switches[1, k] = math.inf, 0.0
        if k < kept:
            switches[0, k], switches[1, k] = commands[2, k], commands[1, k]
    switches[0, kept] = reacts_us


@inlined
def meet(
    ahead: Vector, switches: Vector, model: Vector, mesh: Meeting, first_us: float, found: Vector
) -> None:
    """The trajectory of a `Meeting` from a time on; the layshaft's state is moved."""
    state, at_us = record_on(ahead, STATE), mesh.layshaft_us
    phase, slip = found[0], found[1]
    for k in range(phase.shape[0]):
        time_us = first_us + k * mesh.step_us
        travel(ahead, at_us, time_us, switches, model)
        at_us = time_us
        phase[k] = mesh.i_gear * state.theta_rad - phase[k] - mesh.reference_rad
        slip[k] = mesh.i_gear * state.omega_rad_s - slip[k]


class Trajectory(NamedTuple):
    """Phase (unwrapped) and slip at equal steps of time."""

    first_us: float
    step_us: float
    phase_rad: Vector
    slip_rad_s: Vector


class LastMeasurement(NamedTuple):
    """When a sleeve can last be stopped: at the last measurement so long before its contact."""

    before_us: float
    every_us: int
    """From one measurement to the next."""


@dataclass(frozen=True)
class GearPredictor:
    """Predictions for one target gear from the estimates of this step."""

    gear: MainGear
    i_gear: float
    layshaft: LayshaftState
    main: ShaftState
    brake: BrakeInput
    model: MotionModel
    references: PhaseReferences
    delay_us: int
    """From a sleeve valve's activation to contact, expected."""
    delay_sd_s: float
    stop_us: int
    """A sleeve that has been fired can last be stopped so long before its contact."""
    contact_speed_m_s: float
    """Of the sleeve as it meets the gear's teeth."""

    def slip_rad_s(self, time_us: float, release_us: int | None = None) -> float:
        """Slip at a time with the brake as commanded, or released at `release_us`."""
        return self._slip(self.layshaft_at(time_us, release_us))

    def steady_slip_rad_s(self, time_us: float, release_us: int | None = None) -> float:
        """As `slip_rad_s`, of a main shaft that does not swing: what brake and drag still have to
        bring down."""
        omega = self.layshaft_at(time_us, release_us).omega_rad_s
        return slip_rad_s(self.i_gear, omega, self.main.steady_omega_at(time_us))

    def least_slip_rad_s(self, time_us: float, share: float) -> float:
        """The slip at a time that it is below with this probability, by what is known of where the
        main shaft lies in its driveline's backlash; where nothing is, `slip_rad_s`."""
        swing, state = self.main.swing, self.layshaft_at(time_us, None)
        if not isinstance(swing, LashTrajectory):
            return self._slip(state)
        fastest = swing.fastest_ahead((time_us - self.main.time_us) * US, share)
        return slip_rad_s(self.i_gear, state.omega_rad_s, fastest)

    def swing_rad_s(self, time_us: float) -> float:
        """What the main shaft's swing adds to the slip at a time."""
        return self.main.steady_omega_at(time_us) - self.main.omega_at(time_us)

    def _slip(self, state: LayshaftState) -> float:
        return slip_rad_s(self.i_gear, state.omega_rad_s, self.main.omega_at(state.time_us))

    def phase_and_slip(self, time_us: float) -> tuple[float, float]:
        """Unwrapped phase and slip at a time. KeyError while the reference is unknown."""
        state = self.layshaft_at(time_us, None)
        theta_main = self.main.theta_at(time_us)
        phase = self.references.phase_rad(self.gear, state.theta_rad, theta_main)
        return phase, self._slip(state)

    def layshaft_at(self, time_us: float, release_us: float | None) -> LayshaftState:
        """The layshaft at a time with the brake as commanded, or released at `release_us`."""
        brake = self.brake
        switches = brake.arrays() if release_us is None else brake.with_release(release_us)
        return predict(self.layshaft, time_us, switches, self.model)

    def phase_sd_rad(self, time_us: float) -> float:
        """Standard deviation (rad) of the phase at a contact at that time: from the estimates of
        angle and speed, the phase reference, and the scatter of the sleeve's delay."""
        scatter = self.slip_rad_s(time_us) * self.delay_sd_s
        reference = math.sqrt(self.reference_variance)
        return math.hypot(self._estimate_sd_rad(time_us), reference, scatter)

    @property
    def reference_variance(self) -> float:
        """Variance (rad2) of the gear's phase reference, which adds to that of every prediction."""
        return LEARNED_SD_RAD**2 + self.references.sd_rad(self.gear) ** 2

    def _layshaft_sd_rad(self, time_us: float) -> float:
        state = self.layshaft
        if state.covariance is not None:
            return predict_spread(state, time_us, self.brake.arrays(), self.model).theta_sd_rad
        horizon_s = (time_us - state.time_us) * US
        return math.hypot(state.theta_sd_rad, state.omega_sd_rad_s * horizon_s)

    def estimate_variance(self, time_us: float) -> float:
        """Variance (rad2) of the phase at a time, without the part from the sleeve's delay."""
        return self._estimate_sd_rad(time_us) ** 2

    def _estimate_sd_rad(self, time_us: float) -> float:
        layshaft = self.i_gear * self._layshaft_sd_rad(time_us)
        return math.hypot(layshaft, self.main.theta_sd_at(time_us))

    def variances(
        self, first_us: float, step_us: float, count: int, release_us: float | None = None
    ) -> Vector:
        """Variances (rad2) of the phase at equal steps of time, without the part from the sleeve's
        delay: each as predicted by what will be known when its firing has to be decided. The brake
        is as commanded, or released at `release_us`."""
        seen = self._layshaft_variances(first_us, step_us, count, release_us)
        variances: Vector = self.main.variances(first_us, step_us, count) + self.i_gear**2 * seen
        return variances

    def known_variances(
        self, first_us: float, step_us: float, count: int, now_us: int, measurement: LastMeasurement
    ) -> Vector:
        """Variances (rad2) of the phase at equal steps of time, without the part from the sleeve's
        delay: each as predicted by what will be known at the last measurement before it.

        A contact that is a little too early for one more of them has the one before."""
        before_us, every_us = measurement
        waits_us = first_us - now_us + step_us * np.arange(count)
        more = np.maximum(0.0, np.floor((waits_us - before_us) / every_us))
        beyond = (waits_us - more * every_us - before_us) / every_us
        most = int(more[-1]) + 1
        settled = self.variances(now_us + before_us, float(every_us), most)[more.astype(np.int64)]
        grown = [self.estimate_variance(now_us + before_us + each * every_us) for each in GROWTH]
        if grown[0] == 0.0:
            return settled  # everything is known
        return np.asarray(settled * (np.interp(beyond, GROWTH, grown) / grown[0]))

    def _layshaft_variances(
        self, first_us: float, step_us: float, count: int, release_us: float | None
    ) -> Vector:
        state, brake = self.layshaft, self.brake
        if state.covariance is None or state.edge_rad2_s <= 0.0:
            return np.full(count, self._layshaft_sd_rad(first_us) ** 2)
        switches = brake.arrays() if release_us is None else brake.with_release(release_us)
        measurements = min(ticks_over(step_us, count), MOST_TICKS)
        ticks = Ticks(max(0.0, first_us - state.time_us), OUTLOOK_US, measurements)
        found = outlook(state, ticks, switches, self.model)
        return between_ticks(found, step_us, count)

    def trajectory(
        self, first_us: float, step_us: float, count: int, release_us: float | None = None
    ) -> Trajectory:
        """Phase and slip at `count` times from `first_us` on, the brake as commanded or released
        at `release_us`. KeyError while the reference is unknown."""
        brake = self.brake
        switches = brake.arrays() if release_us is None else brake.with_release(release_us)
        meeting = self._meeting(first_us, step_us)
        found = self.main.trajectories([first_us], step_us, count)[0]
        trajectory(self.layshaft.vector, switches, self.model.flat, meeting, found)
        return Trajectory(first_us, step_us, found[0], found[1])

    def trajectories(
        self, releases_us: Sequence[int], firsts_us: Sequence[float], step_us: float, count: int
    ) -> Vector:
        """Phase and slip as `trajectory` has them, of the brake released at each of `releases_us`,
        from a time of its own on: (m, 2, count), one release a row."""
        found = self.main.trajectories(firsts_us, step_us, count)
        off_us, meeting = self.brake.off_delay_us, self._meeting(firsts_us[0], step_us)
        reacts_us = [release_us + off_us for release_us in releases_us]
        releases = np.array((releases_us, reacts_us, firsts_us), dtype=np.float64)
        commands = self.brake.commanded()
        trajectories(self.layshaft.vector, commands, self.model.flat, meeting, releases, found)
        return found

    def _meeting(self, first_us: float, step_us: float) -> Vector:
        """KeyError while the reference is unknown."""
        return filled(
            MEETING,
            layshaft_us=self.layshaft.time_us,
            first_us=first_us,
            step_us=step_us,
            i_gear=self.i_gear,
            reference_rad=-self.references.phase_rad(self.gear, 0.0, 0.0),
        )

    def release_time_us(
        self, earliest_us: int, latest_us: int, slip_left_rad_s: float, settle_us: float
    ) -> int:
        """When to release the brake so that `slip_left_rad_s` remains `settle_us` later.

        The later the release, the lower the slip. Returns `earliest_us` if even that leaves less,
        `latest_us` if even that leaves more."""

        def over(release_us: int) -> float:
            return self.steady_slip_rad_s(release_us + settle_us, release_us) - slip_left_rad_s

        return _falling_root(over, earliest_us, latest_us)

    def slip_falls_to_us(self, slip_rad_s: float, earliest_us: int, latest_us: int) -> int:
        """When the slip has fallen to a value with the brake as commanded; `earliest_us` if it is
        lower already, `latest_us` if it is still higher then."""
        return _falling_root(
            lambda time_us: self.steady_slip_rad_s(time_us) - slip_rad_s, earliest_us, latest_us
        )


def _falling_root(over: Callable[[int], float], first: int, last: int) -> int:
    """The root of a falling function by the Illinois variant of false position, which halves the
    weight of an end kept twice (Dowell and Jarratt 1971); an end if the root is outside. Loading
    `scipy.optimize` for its `brentq` would cost a node 0.4 s and 30 MB."""
    above, below = over(first), over(last)
    if above <= 0.0:
        return first
    if below >= 0.0:
        return last
    kept = 0
    for _ in range(MOST_STEPS):
        share = min(max(above / (above - below), LEAST_ROOT_SHARE), 1.0 - LEAST_ROOT_SHARE)
        middle = round(first + share * (last - first))
        found = over(middle)
        if abs(found) < CLOSE_RAD_S or last - first <= 1:
            return middle
        if found > 0.0:
            first, above = middle, found
            below *= 0.5 if kept > 0 else 1.0
            kept = 1
        else:
            last, below = middle, found
            above *= 0.5 if kept < 0 else 1.0
            kept = -1
    return middle


def warm_up() -> None:
    """Compiles the kernels, or loads what was compiled before."""
    model = np.ones(MODEL.itemsize // WORD_BYTES)
    law = model.view(MODEL)["segments"]
    law[..., 0], law[0, :, 0, 0] = np.inf, -np.inf
    meeting = np.array([0.0, 1.0, 1.0, 1.0, 1.0])
    trajectory(np.ones(STATES), np.empty((2, 0)), model, meeting, np.ones((2, 1)))
    found = np.ones((1, 2, 1))
    trajectories(np.ones(STATES), np.empty((3, 0)), model, meeting, np.ones((3, 1)), found)
