"""What a step shows on the bus and in its log: status and report frames, and a line for a decision.

The frames make every step visible; the lines give decisions with their reasons (brake, release,
wait, fire) and how a shift ended. Nothing here decides.
"""

from __future__ import annotations

import math
from typing import Final

from meshpoint.controller.estimate.observer import LayshaftTracker, Observer
from meshpoint.controller.models.layshaft import LayshaftState
from meshpoint.controller.models.swing import ShaftState
from meshpoint.controller.plan.strategist import Plan
from meshpoint.controller.settings.header import RunHeader
from meshpoint.controller.shift.sequence import ShiftSequence
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.table import ShiftRecord
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver, Transmitter
from meshpoint.dbc.messages import (
    ETC1,
    ETC2,
    ControllerEstimates,
    ControllerState,
    ControllerStatus,
    J1939Measured,
    Message,
    PhaseReference,
    ShiftDecision,
    ShiftOutcome,
    ShiftPrediction,
)
from meshpoint.dbc.sensor_time import wrap
from meshpoint.gearbox import GearboxSheet, MainGear
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.gearbox.kinematics import slip_rad_s, wrap_to_pitch
from meshpoint.units import DEG, MS_US, RPM

TURNS: Final = 256 * 2.0 * math.pi
"""Angles on the wire are modulo 256 turns."""
ANGLE_TOP: Final = TURNS * (1.0 - 2.0**-33)
ANGLE_SD_TOP: Final = 32.0 * DEG
SPEED_SD_TOP: Final = 300.0 * RPM
SPEED_TOP: Final = 200_000.0 * RPM
PHASE_TOP: Final = 20_000.0 * DEG
PLACE_TOP: Final = 0.02
COUNT_TOP: Final = 255
PRESSURE_TOP: Final = 13.0e5

LINES: Final = {
    ShiftDecision.BRAKE: "brake: contact planned in {contact:.0f} ms, at {slip:.1f} rpm",
    ShiftDecision.RELEASE: "release: contact in {contact:.0f} ms, at {slip:.1f} rpm",
    ShiftDecision.WAIT_FOR_SLIP: "wait: {slip:.1f} rpm at the earliest contact, too much yet",
    ShiftDecision.WAIT_FOR_GAP: "wait for the gap of least cost, too far ahead yet",
    ShiftDecision.FIRE: "fire in {fire:.1f} ms for contact in {contact:.1f} ms: {where}",
    ShiftDecision.COMMITTED: "fired, contact in {contact:.1f} ms: {where}",
}

ETC2_CYCLE_US: Final = 100_000
LATENESS_TOP_US: Final = 65_535
COUNTER_MASK: Final = 0xFFFF
WORD: Final = 0xFFFF_FFFF


def angle(theta_rad: float) -> float:
    """An angle modulo 256 turns, as the signal has it."""
    return min(theta_rad % TURNS, ANGLE_TOP)


def clip(value: float, top: float, bottom: float = 0.0) -> float:
    """The value limited to its signal's range; NaN becomes the maximum, the least favourable."""
    if bottom <= value <= top:
        return value
    return bottom if value < bottom else top


def estimates(
    time_us: int,
    tracker: LayshaftTracker,
    layshaft: LayshaftState | None,
    main: ShaftState | None,
    atmosphere_pa: float,
    slip_rad_s: float,
    phase_rad: float | None,
    phase_sd_rad: float,
) -> ControllerEstimates:
    """The present estimates, with flags for those that are valid."""
    ls = layshaft or LayshaftState(0.0, 0.0, 0.0, 0.0, ANGLE_SD_TOP, SPEED_SD_TOP, PRESSURE_TOP)
    ms = main or ShaftState(0.0, 0.0, 0.0, ANGLE_SD_TOP, SPEED_SD_TOP)
    return ControllerEstimates(
        estimate_time_us=wrap(time_us),
        layshaft_angle_rad=angle(ls.theta_rad),
        layshaft_angle_sd_rad=clip(ls.theta_sd_rad, ANGLE_SD_TOP),
        layshaft_speed_rad_s=clip(ls.omega_rad_s, SPEED_TOP, -SPEED_TOP),
        layshaft_speed_sd_rad_s=clip(ls.omega_sd_rad_s, SPEED_SD_TOP),
        main_angle_rad=angle(ms.theta_rad),
        main_angle_sd_rad=clip(ms.theta_sd_rad, ANGLE_SD_TOP),
        main_speed_rad_s=clip(ms.omega_rad_s, SPEED_TOP, -SPEED_TOP),
        main_speed_sd_rad_s=clip(ms.omega_sd_rad_s, SPEED_SD_TOP),
        brake_pressure_pa=clip(ls.pressure_pa + atmosphere_pa, PRESSURE_TOP),
        brake_pressure_sd_pa=clip(ls.pressure_sd_pa, PRESSURE_TOP),
        slip_rad_s=clip(slip_rad_s, SPEED_TOP, -SPEED_TOP),
        phase_rad=phase_rad or 0.0,
        phase_sd_rad=clip(phase_sd_rad, ANGLE_SD_TOP),
        phase_known=phase_rad is not None,
        layshaft_valid=layshaft is not None,
        main_valid=main is not None,
        model_valid=tracker.free,
    )


def prediction(now_us: int, plan: Plan, shift: ShiftRecord) -> ShiftPrediction:
    """The prediction frame's content for this step's decision."""
    return ShiftPrediction(
        decision_time_us=wrap(now_us),
        decision=plan.decision,
        release_time_us=wrap(shift.release_us or 0),
        fire_time_us=wrap(plan.fire_us),
        contact_time_us=wrap(plan.contact_us),
        phase_rad=clip(plan.phase_rad, PHASE_TOP, -PHASE_TOP),
        phase_sd_rad=clip(plan.phase_sd_rad, ANGLE_SD_TOP),
        slip_rad_s=clip(plan.slip_rad_s, SPEED_TOP, -SPEED_TOP),
    )


def outcome(shift: ShiftRecord, pitch_rad: float) -> ShiftOutcome:
    """A finished shift: prediction against outcome."""
    plan = shift.plan
    known = shift.reference_known
    return ShiftOutcome(
        from_gear=shift.from_number,
        to_gear=shift.to_number,
        strategy=shift.strategy,
        reference=PhaseReference.KNOWN if known else PhaseReference.UNKNOWN,
        engagement=shift.engagement,
        result=shift.result,
        attempts=shift.firings,
        fault=shift.fault,
        request_time_us=wrap(shift.request_us),
        fire_time_us=wrap(shift.fired_us),
        predicted_contact_time_us=wrap(plan.contact_us if plan else 0),
        measured_contact_time_us=wrap(shift.measured_contact_us or 0),
        end_time_us=wrap(shift.end_us or 0),
        predicted_phase_rad=wrap_to_pitch(plan.phase_rad, pitch_rad) if plan else 0.0,
        predicted_phase_sd_rad=clip(plan.phase_sd_rad, ANGLE_SD_TOP) if plan else 0.0,
        predicted_slip_rad_s=clip(plan.slip_rad_s, SPEED_TOP, -SPEED_TOP) if plan else 0.0,
        estimated_phase_rad=wrap_to_pitch(shift.estimated_phase_rad, pitch_rad),
        reference_source=shift.reference_source,
        aborts=min(shift.aborts, COUNT_TOP),
        halt_position_m=clip(shift.halt_m, PLACE_TOP, -PLACE_TOP),
    )


def etc1(
    in_gear: bool, shifting: bool, output_rad_s: float | None, input_rad_s: float | None
) -> ETC1:
    """J1939 ETC1; what is not known goes out as not available."""
    return ETC1(
        driveline_engaged=J1939Measured.YES if in_gear else J1939Measured.NO,
        converter_lockup=J1939Measured.NOT_AVAILABLE,
        shift_in_process=J1939Measured.YES if shifting else J1939Measured.NO,
        output_shaft_speed_rad_s=_j1939_speed(output_rad_s),
        clutch_slip_fraction=None,
        input_shaft_speed_rad_s=_j1939_speed(input_rad_s),
        controlling_address=None,
    )


def _j1939_speed(omega_rad_s: float | None) -> float | None:
    if omega_rad_s is None or not 0.0 <= omega_rad_s < 8031.0 * RPM:
        return None
    return omega_rad_s


def etc2(sheet: GearboxSheet, current: int, selected: int) -> ETC2:
    """J1939 ETC2; between gears the current gear is not available."""
    gear = DRIVE_GEARS.get(current)
    return ETC2(
        selected_gear=selected,
        actual_ratio=sheet.overall_ratio(gear) if gear else None,
        current_gear=current if current >= 0 else None,
        requested_range=None,
        current_range=None,
    )


def decision_line(plan: Plan, now_us: int) -> str | None:
    """The log line of a plan: its decision and its prediction; None for a plan without a decision.

    `where`: phase beside the gap's middle with its standard deviation, and slip."""
    line = LINES.get(plan.decision)
    if line is None:
        return None
    slip = plan.slip_rad_s / RPM
    where = (
        f"phase {plan.phase_rad / DEG:+.2f} +- {plan.phase_sd_rad / DEG:.2f} deg, {slip:.1f} rpm"
    )
    if plan.misses:
        where += ", outside the gap: no better contact within reach"
    if plan.phase_sd_rad == 0.0:
        where = f"phase unknown or not asked for, {slip:.1f} rpm"
    return line.format(
        slip=slip,
        where=where,
        fire=(plan.fire_us - now_us) / MS_US,
        contact=(plan.contact_us - now_us) / MS_US,
    )


def outcome_line(shift: ShiftRecord) -> str:
    """The log line of a shift that is over."""
    aborted = f", {shift.aborts} aborted" if shift.aborts else ""
    return (
        f"shift {shift.from_number} -> {shift.to_number}: {shift.result.name.lower()}"
        f", {shift.firings} fired{aborted}, fault {shift.fault.name.lower()}"
    )


class Reporter:
    """Keeps what the status frame needs of the step before."""

    def __init__(self, header: RunHeader, observer: Observer, sequence: ShiftSequence) -> None:
        self._header = header
        self._run_hash = header.run_hash
        self._observer = observer
        self._sequence = sequence
        self._steps = 0
        self._etc2_every = max(1, ETC2_CYCLE_US // header.settings.timing.tick_us)
        """Steps from one that says it to the next."""
        self._gear = -1
        self._previous = (0, 0, 0)

    def change_header(self, header: RunHeader) -> None:
        """Another run header from the next status frame on."""
        self._header = header
        self._run_hash = header.run_hash

    def frames(self, transmitter: Transmitter, snapshot: StepSnapshot) -> list[Frame]:
        """Estimates, J1939 messages, and this step's prediction and outcome where there are any."""
        sequence, sheet = self._sequence, self._header.sheet
        self._gear = current = self._gear_number()
        frames = transmitter.unread(ControllerEstimates, ETC1)
        messages = [] if frames is not None else self._shafts()
        if self._steps % self._etc2_every == 0:
            target = sequence.target
            messages.append(etc2(sheet, current, target.number if target else max(current, 0)))
        shift = sequence.shift or sequence.finished
        if sequence.decision is not None and shift is not None:
            messages.append(prediction(snapshot.now_us, sequence.decision, shift))
        if sequence.finished is not None:
            messages.append(outcome(sequence.finished, sheet.dog.pitch_rad))
        return [*(frames or ()), *(transmitter.encode(message) for message in messages)]

    def _shafts(self) -> list[Message]:
        # At the time of the newest read: extrapolated further, the estimates of two shafts in mesh
        # would drift apart.
        seen_us = self._observer.clock.latest_us
        layshaft, main = self._observer.layshaft_at(seen_us), self._observer.main_at(seen_us)
        return [self._estimates(seen_us, layshaft, main), self._etc1(main, layshaft)]

    def _gear_number(self) -> int:
        view = self._observer.view
        return view.gear_number if view.complete else -1

    def _gear_in_focus(self) -> MainGear | None:
        """The gear that slip and phase are reported for: the target, else the one in mesh."""
        target = self._sequence.target
        if target is not None:
            return target.main
        current = DRIVE_GEARS.get(self._gear)
        return current.main if current else None

    def _estimates(
        self, time_us: int, layshaft: LayshaftState | None, main: ShaftState | None
    ) -> ControllerEstimates:
        gear = self._gear_in_focus()
        slip, phase, phase_sd = 0.0, None, 0.0
        if layshaft is not None and main is not None and gear is not None:
            ratio = self._header.sheet.main_mesh(gear).ratio
            slip = slip_rad_s(ratio, layshaft.omega_rad_s, main.omega_rad_s)
            references = self._observer.references
            if references.known(gear):
                raw = references.phase_rad(gear, layshaft.theta_rad, main.theta_rad)
                phase = wrap_to_pitch(raw, self._header.sheet.dog.pitch_rad)
                phase_sd = math.hypot(
                    ratio * layshaft.theta_sd_rad, main.theta_sd_rad, references.sd_rad(gear)
                )
        return estimates(
            time_us,
            self._observer.layshaft,
            layshaft,
            main,
            self._header.sheet.air.atmosphere_pa,
            slip,
            phase,
            phase_sd,
        )

    def _etc1(self, main: ShaftState | None, layshaft: LayshaftState | None) -> ETC1:
        state = self._sequence.state
        shifting = state not in (
            ControllerState.STARTING,
            ControllerState.IN_GEAR,
            ControllerState.NEUTRAL,
        )
        view, sheet = self._observer.view, self._header.sheet
        gear = DRIVE_GEARS.get(self._gear)
        output = input_ = None
        if main is not None and gear is not None:
            output = main.omega_rad_s * sheet.range_mesh(gear.range_).ratio
        if layshaft is not None and view.complete and view.split is not None:
            input_ = layshaft.omega_rad_s / sheet.split_mesh(view.split).ratio
        return etc1(state is ControllerState.IN_GEAR, shifting, output, input_)

    def status(
        self,
        now_us: int,
        lateness_us: int,
        count: int,
        crc: int,
        receiver: Receiver,
        guard_blocks: int,
    ) -> ControllerStatus:
        """The frame that lets a log repeat this step; after `frames` of the same step."""
        sequence = self._sequence
        target = sequence.target
        previous = self._previous
        status = ControllerStatus(
            step_number=self._steps,
            step_time_us=now_us,
            previous_step_time_us=previous[0],
            consumed_count=count,
            previous_consumed_count=previous[1],
            consumed_crc=crc,
            previous_consumed_crc=previous[2],
            run_hash_low=self._run_hash & WORD,
            run_hash_high=self._run_hash >> 32,
            state=sequence.state,
            current_gear=self._gear,
            target_gear=target.number if target else max(self._gear, 0),
            strategy=self._header.settings.strategy,
            estimator=self._header.settings.estimator,
            reference_known=self._observer.references.mask,
            active_fault=sequence.fault,
            e2e_errors=receiver.e2e_errors & COUNTER_MASK,
            format_errors=receiver.format_errors & COUNTER_MASK,
            foreign_frames=receiver.foreign_frames & COUNTER_MASK,
            guard_blocks=guard_blocks & COUNTER_MASK,
            invalid_channels=receiver.invalid_channels,
            step_lateness_us=min(lateness_us, LATENESS_TOP_US),
            cold_start=self._header.calibration is None,
        )
        self._previous = (now_us, count, crc)
        self._steps += 1
        return status
