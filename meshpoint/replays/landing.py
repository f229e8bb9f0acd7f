"""Where the tooth would have landed under another controller's commands: worked out by a model.

From the step at which a valve is first driven differently, the log's frames answer to other
commands than the other controller's. So its shift sequence goes on with estimates worked out from
the log: the recorded trajectory, plus what the differing brake commands do to the layshaft by the
learned brake. This is done many times, with what is uncertain drawn again: brake gain, pressure law
and delays, drag, the angle of both shafts, the reference, the sleeve's delay. The spread of the
landings is the interval.

Up to the recorded contact everything but the difference is measured; after it the learned model
goes on. The rig's truth in a log is never read.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, cast

import numpy as np

from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.estimate.brake_model import PARAMETERS, BrakeModel, uncorrelated
from meshpoint.controller.estimate.observer import LayshaftTracker
from meshpoint.controller.measure.inputs import ShaftSpeeds
from meshpoint.controller.models.layshaft import LayshaftState, MotionModel
from meshpoint.controller.models.layshaft_kernels import GAIN
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.dbc.messages import ControllerState, FaultCode, ShiftDecision
from meshpoint.gearbox import MainGear
from meshpoint.gearbox.kinematics import slip_rad_s, wrap_to_pitch
from meshpoint.kernels.records import Vector
from meshpoint.replays.copies import copied
from meshpoint.replays.recorded_trajectory import (
    BrakeDifference,
    RecordedTrajectory,
    Seen,
    last_release_us,
)
from meshpoint.report.counterfactual import Counterfactual, undecidable
from meshpoint.results.states import state_words
from meshpoint.units import DEG, RPM

NORMALS: Final = 7 + PARAMETERS
"""What is uncertain: brake gain, sleeve delay, angles, reference, drag after the release, how much
of it is viscous, where the pads touch; then the brake's law and delays."""
TOUCH_SD_PA: Final = 1e4
"""Of the pressure at which the pads touch, beside what is claimed: it is learned from the end of
the brake's torque alone, and comes out too low as long as few shifts have shown it."""
DELAY: Final = 1
"""The sleeve delay's place among them."""
DRAG_SD_SHARE: Final = 0.03
"""Of what slows the layshaft without brake, beside what is known of it while it was braked:
friction depends on speed and oil otherwise than the data sheet has it."""
VISCOUS_SHARE: Final = 0.5
VISCOUS_SD: Final = 0.3
"""How much of the drag beyond the data sheet's falls with the speed: the estimator has it steady.
Nothing is known of it but that it lies between 0 and 1."""
DRAWS: Final = 32
"""This many times it is worked out; the interval's width is then known to about an eighth."""
TICK_US: Final = 10_000
TRACE_US: Final = 5_000
LONGEST_US: Final = 700_000
"""From the parting; a model is trusted no further."""
REFERENCE_SD_RAD: Final = math.radians(0.1)
"""Of a reference learned in mesh, as `controller.estimate.reference_recovery` has it."""
GAIN_SD: Final = 0.01
"""Of the brake's gain between two moments of a shift, beside what the filter claims: discs warm."""
MOST_SD_SHARE: Final = 0.125
"""A landing less certain than this, in pitches, is not reported: its interval would be half a
pitch."""
STUDENT_95: Final = 2.04
"""Of `DRAWS` - 1 degrees of freedom."""
MODELLED: Final = frozenset({ControllerState.SYNCHRONISING, ControllerState.COASTING})
"""States that need no more than brake and layshaft to go on."""


class _Layshaft:
    """What a shift sequence asks of the layshaft's estimator, worked out instead of estimated."""

    free = True

    def __init__(self, model: MotionModel, inertia_kgm2: float) -> None:
        self.model, self._inertia_kgm2 = model, inertia_kgm2
        self.state: LayshaftState | None = None

    def drag_nm(self, omega_rad_s: float) -> float:
        """The data sheet's friction at a speed (Nm)."""
        return self._inertia_kgm2 * self.model.friction_per_s * abs(omega_rad_s)

    def latest(self) -> LayshaftState:
        """Where a prediction starts."""
        if self.state is None:
            raise RuntimeError("no state has been worked out")
        return self.state


class PartedController:
    """The other controller at the last step that it took on its own trajectory."""

    def __init__(self, core: ControllerCore, step: int) -> None:
        self.sheet, self.settings = core.header.sheet, core.header.settings
        self.sequence = copied(core.sequence)
        snapshot = core.snapshot
        if snapshot is None:
            raise RuntimeError("parted before the first step")
        self.view = copied(snapshot.view)
        tracker = snapshot.layshaft
        self.model = tracker.model if tracker.free else None
        self.step = step
        """The next step is this one of the recorded trajectory."""
        record = core.running_shift
        self.gear = record.target.main if record else MainGear.NEUTRAL
        self.request_us = record.request_us if record else 0
        self.knows = self.sequence.references.known(self.gear)

    @property
    def refusal(self) -> str:
        """Why nothing can be worked out from here; empty if it can."""
        state = self.sequence.state
        if state is ControllerState.ENGAGING:
            return ""
        if state not in MODELLED or self.model is None:
            return (
                f"the trajectories part while {state_words(state)}: clutch, engine, old "
                "gear and a sleeve before the teeth have no model here"
            )
        return ""


@dataclass(frozen=True)
class _Landing:
    fire_us: float
    contact_us: float
    phase_rad: float
    """Wrapped."""
    slip_rad_s: float


class _Draw:
    """One way in which it may have been; all zeros: the likeliest."""

    def __init__(
        self,
        parting: PartedController,
        trajectory: RecordedTrajectory,
        known: BrakeModel,
        normal: Vector,
    ) -> None:
        self._parting, self._trajectory, self._normal = parting, trajectory, normal
        self.sequence = copied(
            parting.sequence, parting.sheet, parting.settings, parting.sequence.references
        )
        newest = trajectory.newest
        spread = 0.0 if newest.covariance is None else float(newest.covariance[GAIN, GAIN])
        gain = newest.gain + math.hypot(math.sqrt(max(spread, 0.0)), GAIN_SD) * normal[0]
        as_built = known.varied(normal[NORMALS - PARAMETERS :])
        touch, lag = known.touch_pa, known.sensor_lag_s
        touch_pa = touch.value + math.hypot(touch.sd, TOUCH_SD_PA) * normal[6]
        as_built.touch_and_lag = uncorrelated((abs(touch_pa), touch.sd), (lag.value, lag.sd))
        viscous = max(0.0, VISCOUS_SHARE + VISCOUS_SD * normal[5])
        self._drag_rad_s2 = viscous * trajectory.eased_rad_s2
        self._drag_rad_s2 += DRAG_SD_SHARE * trajectory.coasting_rad_s2 * normal[4]
        start_us = float(trajectory.steps[max(0, parting.step - 1)].now_us)
        self.difference = BrakeDifference(trajectory, start_us, gain, known, as_built)
        self._ratio = parting.sheet.main_mesh(parting.gear).ratio

    def land(self) -> _Landing | str:
        """Until the sleeve is fired, and from there to contact; or why it never is."""
        sequence, parting = self.sequence, self._parting
        plan = sequence.running.plan if sequence.state is ControllerState.ENGAGING else None
        if parting.model is not None and plan is None:
            inertia_kgm2 = parting.sheet.inertia_kgm2(sequence.running.target.split)
            layshaft = _Layshaft(parting.model, inertia_kgm2)
            for seen in _steps(self._trajectory, parting.step):
                sequence.step(self._snapshot(seen, layshaft))
                decided = sequence.decision
                if decided is not None and decided.decision is ShiftDecision.COMMITTED:
                    plan = decided
                    break
                if sequence.finished is not None:
                    fault = sequence.finished.fault.name.lower()
                    return f"it would have given up before it fired ({fault})"
                if sequence.state not in MODELLED:
                    return "it would have asked the engine for speed, which has no model here"
        if plan is None:
            return f"it would not have fired within {LONGEST_US // 1000} ms of the parting"
        return self._landing(plan.fire_us)

    def _snapshot(self, seen: Seen, layshaft: _Layshaft) -> StepSnapshot:
        """What it would have known at a step."""
        trajectory, now_us = self._trajectory, seen.now_us
        edge_us = float(now_us - 5_000) if seen.layshaft is None else seen.layshaft.time_us
        state = layshaft.state = self._state(edge_us)
        main = trajectory.main(now_us, known_us=now_us)
        speeds = ShaftSpeeds(self._parting.sheet, None, state.omega_rad_s, main.omega_rad_s, None)
        commands = map(self.sequence.board.command, ValveName)
        return StepSnapshot(
            now_us,
            now_us + seen.lead_us,
            self._parting.view,
            cast(LayshaftTracker, layshaft),
            lambda _: main,
            speeds,
            FaultCode.NONE,
            tuple(command.on or command.before for command in commands),
            seen.supply_pa,
        )

    def _state(self, time_us: float) -> LayshaftState:
        """The layshaft with the other brake commands."""
        brake = self.sequence.brake
        state = self.difference.at(time_us, brake)
        release_us = last_release_us(brake, time_us)
        angle_s2, speed_s = self._trajectory.unseen_release(release_us, time_us)
        return state._replace(
            theta_rad=state.theta_rad + self._drag_rad_s2 * angle_s2,
            omega_rad_s=state.omega_rad_s + self._drag_rad_s2 * speed_s,
        )

    def _landing(self, fire_us: int) -> _Landing:
        sequence, trajectory, gear = self.sequence, self._trajectory, self._parting.gear
        stroke = sequence.sleeves.from_rest(gear)
        delay_us = stroke.contact_us + stroke.sd_us * self._normal[DELAY]
        contact_us = fire_us + delay_us
        state, main = self._state(contact_us), trajectory.main(contact_us)
        theta_main = main.theta_at(contact_us)
        angles = math.hypot(
            self._ratio * trajectory.layshaft_sd_rad(contact_us), trajectory.main_sd_rad(contact_us)
        )
        off = angles * self._normal[2]
        off += REFERENCE_SD_RAD * self._normal[3]
        phase = sequence.references.phase_rad(gear, state.theta_rad, theta_main) + off
        slip = slip_rad_s(self._ratio, state.omega_rad_s, main.omega_at(contact_us))
        pitch = self._parting.sheet.dog.pitch_rad
        return _Landing(fire_us, contact_us, wrap_to_pitch(phase, pitch), slip)

    def trace(self, landing: _Landing) -> tuple[tuple[float, float, float], ...]:
        """The trajectory until then, for drawing."""
        parting, trajectory = self._parting, self._trajectory
        first_us = trajectory.steps[min(parting.step, len(trajectory.steps) - 1)].now_us
        count = max(2, round((landing.contact_us - first_us) / TRACE_US))
        points = []
        for time_us in np.linspace(min(first_us, landing.contact_us), landing.contact_us, count):
            state, main = self._state(time_us), trajectory.main(time_us)
            slip = slip_rad_s(self._ratio, state.omega_rad_s, main.omega_at(time_us))
            phase = self.sequence.references.phase_rad(
                parting.gear, state.theta_rad, main.theta_at(time_us)
            )
            points.append(((float(time_us) - parting.request_us) / 1000, slip / RPM, phase))
        end = points[-1][2] - landing.phase_rad
        return tuple((at_ms, slip, (phase - end) / DEG) for at_ms, slip, phase in points)


def _steps(trajectory: RecordedTrajectory, first: int) -> list[Seen]:
    """The recorded steps from one on, then one each tick."""
    steps = trajectory.steps[first:]
    if not steps:
        return []
    last = steps[-1]
    until_us = steps[0].now_us + LONGEST_US
    while steps[-1].now_us < until_us:
        steps.append(last._replace(now_us=steps[-1].now_us + TICK_US, layshaft=None))
    return [step for step in steps if step.now_us <= until_us]


def work_out(
    parting: PartedController,
    trajectory: RecordedTrajectory,
    known: BrakeModel,
    seed: int,
    draws: int = DRAWS,
) -> Counterfactual:
    """Where the tooth would have landed. known: the brake as learned by the end of the shift; seed:
    of the draws."""
    if parting.refusal:
        return undecidable(parting.refusal)
    if not parting.knows:
        return undecidable("the gear's phase reference was unknown")
    if not trajectory.is_usable:
        return undecidable("the recorded estimator does not know how wrong it is")
    rng = np.random.Generator(np.random.PCG64([0xCF, seed]))
    middle = _Draw(parting, trajectory, known, np.zeros(NORMALS))
    likeliest = middle.land()
    if isinstance(likeliest, str):
        return undecidable(likeliest)
    landings = []
    freedom = parting.sequence.sleeves.from_rest(parting.gear).freedom
    for _ in range(draws):
        normal = rng.standard_normal(NORMALS)
        # The delay's scatter is known from few shifts: Student's law.
        normal[DELAY] *= math.sqrt(freedom / rng.chisquare(freedom))
        found = _Draw(parting, trajectory, known, normal).land()
        if isinstance(found, str):
            return undecidable(f"in some of the ways in which it may have been, {found}")
        landings.append(found)
    reported = _reported(parting, trajectory, likeliest, landings)
    return replace(reported, trajectory=middle.trace(likeliest))


def _reported(
    parting: PartedController,
    trajectory: RecordedTrajectory,
    likeliest: _Landing,
    landings: list[_Landing],
) -> Counterfactual:
    pitch = parting.sheet.dog.pitch_rad
    turned = np.exp(1j * np.array([landing.phase_rad for landing in landings]) / pitch * math.tau)
    middle = float(np.angle(turned.mean())) / math.tau * pitch
    away = [wrap_to_pitch(landing.phase_rad - middle, pitch) for landing in landings]
    sd = math.sqrt(sum(one * one for one in away) / (len(away) - 1))
    beyond_us = likeliest.contact_us - trajectory.newest.time_us
    values = Counterfactual(
        fired_ms=(likeliest.fire_us - parting.request_us) / 1000,
        contact_ms=(likeliest.contact_us - parting.request_us) / 1000,
        slip_rpm=likeliest.slip_rad_s / RPM,
        beyond_record_ms=max(0.0, beyond_us / 1000 - TICK_US / 1000),
    )
    half_deg = STUDENT_95 * sd / DEG
    if sd > MOST_SD_SHARE * pitch:
        return replace(
            values,
            why=f"the landing would be known to within {half_deg:.1f} deg only, of a pitch of "
            f"{pitch / DEG:.2f} deg",
        )
    return replace(
        values,
        phase_deg=middle / DEG,
        phase_low_deg=middle / DEG - half_deg,
        phase_high_deg=middle / DEG + half_deg,
        contact_probability=_inside(middle, sd, parting.sheet.dog.backlash_rad / 2.0, pitch),
    )


def _inside(middle: float, sd: float, half_gap: float, pitch: float) -> float:
    """The share of a normal law within the gaps."""

    def below(x: float) -> float:
        return 0.5 * (1.0 + math.erf((x - middle) / (sd * math.sqrt(2.0))))

    return sum(below(k * pitch + half_gap) - below(k * pitch - half_gap) for k in (-1, 0, 1))
