"""The brake's air, on its way before the old gear is out: it arrives as the teeth leave each other.

The law of a sleeve on its way out, corrected by its samples, says when its teeth are out. The
brake's valve is switched its own delay before that. Nothing is commanded before the sleeve has been
seen to move, and a sleeve that stops takes the command back.
"""

from __future__ import annotations

from typing import Final

from meshpoint.controller.settings import MS_IN_US
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.valve_name import ValveName
from meshpoint.gearbox.gears import MAIN_SLEEVES, Sleeve
from meshpoint.units import SECOND_US

MOVED_M: Final = 0.6e-3
"""A sleeve this far from where it stood is on its way: some times the sensors' noise."""
OVER_SAMPLES: Final = 3
"""Over this many samples of 1 ms it is seen whether the sleeve moves."""
CLEAR_M: Final = 1.0e-3
"""Air comes in when the teeth are this far from each other, as predicted."""


def brake_ahead(context: ShiftContext, snapshot: StepSnapshot) -> None:
    """Switches the brake on for when the old gear's teeth are out, while its sleeve is on its way;
    only for a gear that is too fast, and where no other sleeve has to change before."""
    command = context.board.command(ValveName.BRAKE)
    waits = command.time_us > snapshot.earliest_us
    if command.on and not waits:
        if not _leaves(context, snapshot):
            _take_back(context, snapshot)
        return
    out_us = _teeth_out_us(context, snapshot) if _is_wanted(context, snapshot) else None
    if out_us is None:
        if command.on:
            _take_back(context, snapshot)
        return
    # No air sooner than by the least delay that the sheet allows: the guard goes by it too.
    least_us = round(context.sheet.brake.least_valve_delay_s * SECOND_US)
    on_us = max(snapshot.earliest_us, round(out_us) - min(context.brake.on_delay_us, least_us))
    if on_us >= snapshot.earliest_us + context.tick_us:
        return  # the next step knows better
    if not command.on:
        context.running.pulses += 1
    context.switch_brake(True, on_us, snapshot)


def _take_back(context: ShiftContext, snapshot: StepSnapshot) -> None:
    context.board.off(ValveName.BRAKE)
    context.brake.schedule(snapshot.now_us, False, snapshot.now_us)
    context.running.pulses -= 1


def _is_wanted(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether the new gear is so fast that drag alone would take longer than `limits.coast_ms`, and
    the guard has blocked nothing in this shift: a block takes every valve off, so air that came too
    soon would press as the gear is pulled again, and would come too soon again. Nor
    for a sleeve that has left neutral by itself: it is brought back first."""
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


def _leaving(context: ShiftContext, snapshot: StepSnapshot) -> tuple[Sleeve, int] | None:
    """The main sleeve that is farthest from neutral, and its side; None where none has moved."""
    sleeve = max(MAIN_SLEEVES, key=lambda one: abs(snapshot.view.position_m(one)))
    position_m = snapshot.view.position_m(sleeve)
    if abs(position_m) > context.sheet.sleeve.stroke_m - MOVED_M:
        return None
    return sleeve, 1 if position_m > 0.0 else -1


def _leaves(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether the sleeve is out of its teeth, or on its way."""
    found = _leaving(context, snapshot)
    if found is None:
        return False
    sleeve, side = found
    samples_m = snapshot.view.tracks[sleeve].samples_m
    is_out = samples_m[0] * side < context.sheet.sleeve.to_contact_m - CLEAR_M
    return is_out or (samples_m[OVER_SAMPLES] - samples_m[0]) * side > 0.0


def _teeth_out_us(context: ShiftContext, snapshot: StepSnapshot) -> float | None:
    """When the old gear's teeth will be clear of each other; None while the sleeve stands, or where
    it will stop before."""
    found = _leaving(context, snapshot)
    if found is None or not _leaves(context, snapshot):
        return None
    sleeve, side = found
    clear_m, track = context.sheet.sleeve.to_contact_m - CLEAR_M, snapshot.view.tracks[sleeve]
    if track.position_m * side <= clear_m:
        return float(track.newest_us)
    return context.sleeves.passes_us(sleeve, side * clear_m, -side)
