"""From the controller's state to the messages that show it; nothing here decides."""

from __future__ import annotations

import math
from typing import Final

from meshpoint.controller.estimate.layshaft_tracker import LayshaftTracker
from meshpoint.controller.models.layshaft import LayshaftState
from meshpoint.controller.models.swing import ShaftState
from meshpoint.controller.plan.strategist import Plan
from meshpoint.controller.shift.table import ShiftRecord
from meshpoint.dbc.messages import (
    ETC1,
    ETC2,
    ControllerEstimates,
    J1939Measured,
    PhaseReference,
    ShiftOutcome,
    ShiftPrediction,
)
from meshpoint.dbc.sensor_time import wrap
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.gearbox.kinematics import wrap_to_pitch
from meshpoint.units import DEG, RPM

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
        result=shift.result,
        attempts=shift.attempts,
        fault=shift.fault,
        request_time_us=wrap(shift.request_us),
        fire_time_us=wrap(plan.fire_us if plan else 0),
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
