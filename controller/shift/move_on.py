"""A tooth that stands on a tooth is moved on by a pulse of the layshaft's brake.

The pressed faces hold gear and sleeve together, and what slows the gear slows the main shaft along,
as far as the driveline's backlash lets it. The brake breaks that: the gear falls behind its sleeve,
and the next gap comes by. No torque moves it forward, so this is the one direction. A gear that
still turns past its sleeve needs no pulse: it finds a gap, or comes to stand.

How much friction holds is not known. So a pulse is no weaker than it may be: it fills the brake to
the pressure at which a gear that nothing holds would come over the whole face with the lowest slip
that a contact is planned for, by the brake's law as learned.
"""

from __future__ import annotations

from typing import Final

from meshpoint.controller.measure.gearbox_view import ENTERED_M
from meshpoint.controller.models.layshaft import LayshaftState, predict, switched
from meshpoint.controller.settings.settings import MS_IN_US
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.disengage import PRESSED_PA
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.valve_board import FOREVER_US
from meshpoint.gearbox.gears import SLEEVE_OF_MAIN
from meshpoint.units import RPM, SECOND_US

RESTED_US: Final = 15 * MS_IN_US
"""A sleeve that has not entered so long after contact is on a tooth: a gap shows sooner."""
STANDS_RAD_S: Final = 5.0 * RPM
"""A gear slower against its sleeve than this is taken to stand: an error of the speeds."""
PULSES: Final = 2
"""This often a tooth is moved on; then its sleeve goes back."""
LEAST_US: Final = 5 * MS_IN_US
LONGEST_US: Final = 22 * MS_IN_US
"""A longer pulse might still be on as the gear locks: its air comes in after some 12 ms. The guard
draws a line of its own for each gear, of which this stays short on our sheets."""
STALLS: Final = 2.0
"""The brake is not used where its full torque would bring the layshaft to the guard's floor within
this many of its time constants."""


def move_on(context: ShiftContext, snapshot: StepSnapshot, entered_m: float) -> None:
    """One step with a sleeve that has met its gear: begins a pulse, or ends it as the sleeve goes
    in, or the gear turns before the air comes."""
    shift, board, now_us = context.running, context.board, snapshot.now_us
    command = board.command(ValveName.BRAKE)
    if command.until_us < FOREVER_US and now_us >= command.time_us:
        # The filter's input has one switch that is still to come.
        context.brake.schedule(command.until_us, False, now_us)
    is_pulsed = not command.rests(now_us)
    acts = is_pulsed and now_us >= command.time_us + context.brake.on_delay_us
    if is_pulsed and (abs(entered_m) > ENTERED_M or not (acts or _stands(context, snapshot))):
        context.brake_off(now_us)
        return
    if is_pulsed or abs(entered_m) > ENTERED_M or not _helps(context, snapshot):
        return
    start_us = snapshot.earliest_us
    shift.moves += 1
    shift.moved_us = start_us + _pulse_us(context, snapshot)
    board.pulse(ValveName.BRAKE, start_us, shift.moved_us, now_us)
    context.brake.schedule(start_us, True, now_us)


def _stands(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether the gear turns with its sleeve."""
    slip = snapshot.speeds.slip_rad_s(context.running.target.main)
    return slip is not None and abs(slip) <= STANDS_RAD_S


def _helps(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether a tooth stands, and the brake may and can move it on."""
    shift, view, sheet = context.running, snapshot.view, context.sheet
    gear, contact_us = shift.target.main, shift.measured_contact_us
    layshaft = snapshot.speeds.layshaft
    if contact_us is None or layshaft is None:
        return False
    full_rad_s2 = sheet.brake.max_torque_nm / sheet.inertia_kgm2(shift.target.split)
    taken_rad_s = full_rad_s2 * STALLS * sheet.brake.time_constant_s
    return (
        snapshot.now_us - contact_us >= RESTED_US
        and shift.moves < PULSES * shift.attempts
        and _stands(context, snapshot)
        and view.rests(SLEEVE_OF_MAIN[gear].sleeve)
        and view.clutch_parted
        and _is_released(context, snapshot)
        and layshaft - taken_rad_s > context.settings.guard.brake_floor_rad_s
    )


def _is_released(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether the brake's air is out. Its pressure shows no sooner what a pulse has let in than the
    valve's delay and some filling later."""
    switches, brake = context.brake.switches, context.sheet.brake
    shows_us = (brake.greatest_valve_delay_s + brake.time_constant_s) * SECOND_US
    is_shown = not switches or snapshot.now_us - switches[-1].time_us > shows_us
    return is_shown and snapshot.view.brake_gauge_pa <= PRESSED_PA


def _pulse_us(context: ShiftContext, snapshot: StepSnapshot) -> int:
    """The shortest pulse that fills the brake to the pressure which it may have."""
    target, sheet, brake = context.running.target, context.sheet, context.brake
    face_rad = sheet.dog.pitch_rad - sheet.dog.backlash_rad
    slip_rad_s = context.settings.window.contact_low_rad_s
    ratio, inertia = sheet.main_mesh(target.main).ratio, sheet.inertia_kgm2(target.split)
    # v^2 = 2 a s.
    most_nm = slip_rad_s**2 / (2.0 * face_rad) * inertia / ratio
    start_us, model = snapshot.earliest_us, snapshot.layshaft.model
    begun = LayshaftState(start_us, 0.0, 0.0, max(0.0, snapshot.view.brake_gauge_pa))
    for pulse_us in range(LEAST_US, LONGEST_US, MS_IN_US):
        shut_us = start_us + pulse_us + brake.off_delay_us
        switches = switched((start_us + brake.on_delay_us, True), (shut_us, False))
        filled = predict(begun, shut_us, switches, model)
        if filled.pressure_pa * sheet.brake_nm_per_pa >= most_nm:
            return pulse_us
    return LONGEST_US
