"""How a shift ends whose gear is in mesh: what its way in says of the phase."""

from __future__ import annotations

from typing import Final

from meshpoint.controller.measure.gearbox_view import ENGAGED_SHORT_M
from meshpoint.controller.settings.settings import MS_IN_US
from meshpoint.controller.shift.context import FALL_US, ShiftContext
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.table import Trigger
from meshpoint.dbc.messages import FaultCode, ShiftResult
from meshpoint.gearbox.gears import SLEEVE_OF_MAIN
from meshpoint.units import SECOND_US

STRAIGHT_SHARE: Final = 1.3
"""A sleeve that enters a gap at first contact takes no longer than this by the sheet's speed."""

SEEN_US: Final = 28 * MS_IN_US
"""Longest delay from a gear being in mesh to the measured position showing it."""


def in_mesh(context: ShiftContext, snapshot: StepSnapshot) -> Trigger:
    """The gear asked for is in mesh: its phase is learned, and the shift ends."""
    gear = context.running.target.main
    side = SLEEVE_OF_MAIN[gear]
    seen_us = snapshot.view.engaged_us(side.sleeve, side.direction)
    straight = _went_straight(context, seen_us)
    struck_us = context.free_us if straight else snapshot.now_us - SEEN_US
    context.references.locked(gear, _flank_slip_rad_s(context, struck_us))
    context.end(snapshot, ShiftResult.ENGAGED, FaultCode.NONE, seen_us)
    return Trigger.ENGAGED


def _went_straight(context: ShiftContext, seen_us: int | None) -> bool:
    """Whether a sleeve that was measured in mesh at a time has not rested on a tooth before."""
    contact_us, sleeve = context.running.measured_contact_us, context.sheet.sleeve
    if contact_us is None or seen_us is None:
        return False
    way_m = sleeve.stroke_m - ENGAGED_SHORT_M - sleeve.to_contact_m
    return seen_us - contact_us < STRAIGHT_SHARE * way_m / sleeve.speed_m_s * SECOND_US


def _flank_slip_rad_s(context: ShiftContext, struck_us: int) -> float:
    """The slip (rad/s) that carried the tooth to its flank; 0 if its sign is not certain.

    Slip falls while the layshaft is free. A positive slip too small to cross the whole gap before
    it reverses may have left the tooth on either flank."""
    predictor = context.free_predictor
    if predictor is None:
        return 0.0
    slip = predictor.slip_rad_s(struck_us)
    later = predictor.slip_rad_s(struck_us + FALL_US)
    if slip <= 0.0:
        return later
    fall_rad_s2 = (slip - later) / (FALL_US * 1e-6)
    crosses = slip * slip > 2.0 * context.sheet.dog.backlash_rad * fall_rad_s2
    return slip if crosses else 0.0
