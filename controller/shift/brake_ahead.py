"""The brake's air, before the old gear's sleeve rests in neutral: as soon as its teeth are seen to
be out and stay so.

Sooner, the guard could not prove that no teeth are loaded: once its valve is off, a sleeve that is
still between the teeth may stop there.
"""

from __future__ import annotations

from typing import Final

from meshpoint.controller.measure.gearbox_view import VIEW_NEUTRAL_M
from meshpoint.controller.settings.settings import MS_IN_US
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.synchronise import plan_release
from meshpoint.controller.shift.to_neutral import CLEAR_M, RESTS_US
from meshpoint.gearbox.gears import MAIN_SLEEVES
from meshpoint.units import SECOND_US

LEAVES_M_S: Final = 0.1
"""A sleeve faster than this is surely on its way."""


def brake_ahead(context: ShiftContext, snapshot: StepSnapshot) -> None:
    """Brakes while the old gear's sleeve is out of its teeth and not in neutral yet, and plans the
    release; only for a gear that is too fast, and where no other sleeve has to change before."""
    shift, command = context.running, context.board.command(ValveName.BRAKE)
    acts = command.on or context.board.driven(ValveName.BRAKE, snapshot.earliest_us)
    is_out = _is_out(context, snapshot)
    if acts and not is_out:
        context.brake_off(snapshot.now_us)
        shift.pulses, shift.release_us = shift.pulses - 1, None
    elif acts:
        predictor = context.predictor(shift.target.main, snapshot)
        if predictor is not None:
            # No sleeve can be fired yet: so much slip is left that drag may go on till it can be.
            plan_release(context, predictor, snapshot, context.strategist.acting(False))
    elif is_out and shift.release_us is None and _is_wanted(context, snapshot):
        shift.pulses += 1
        context.switch_brake(True, snapshot.earliest_us, snapshot)


def _is_wanted(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether the new gear is so fast that drag alone would take longer than `limits.coast_ms`, and
    the guard has blocked nothing in this shift. Nor for a sleeve that has left neutral by itself:
    it is brought back first."""
    shift, view, sheet = context.running, snapshot.view, context.sheet
    target = shift.target
    if shift.blocks or shift.returns:
        return False
    slip, layshaft = snapshot.speeds.slip_rad_s(target.main), snapshot.speeds.layshaft
    if (view.split, view.range_) != (target.split, target.range_):
        return False
    if slip is None or layshaft is None or shift.pulses >= context.settings.limits.pulses:
        return False
    drag_rad_s2 = snapshot.layshaft.drag_nm(layshaft) / sheet.inertia_kgm2(target.split)
    coast_s = context.settings.limits.coast_ms * MS_IN_US / SECOND_US
    fall = sheet.main_mesh(target.main).ratio * drag_rad_s2 * coast_s
    return slip - context.settings.window.fire_slip_rad_s > fall


def _is_out(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether the main sleeves are seen clear of all teeth, stay so by their commands, and do not
    move towards them, nor are being braked, which may bring one back. Neutral is not waited for:
    one that falls short takes far longer to it."""
    if context.running.is_braked and not context.main_valves_rest(snapshot.now_us):
        return False
    clear_m = context.sheet.sleeve.to_contact_m - CLEAR_M
    for sleeve in MAIN_SLEEVES:
        track = snapshot.view.tracks[sleeve]
        newest_m = abs(track.position_m)
        comes_back = track.outward_m_s > LEAVES_M_S and newest_m > VIEW_NEUTRAL_M
        if newest_m > clear_m or comes_back:
            return False
    at_us = snapshot.now_us + RESTS_US
    return all(abs(context.sleeves.place(one, at_us).m) <= clear_m for one in MAIN_SLEEVES)
