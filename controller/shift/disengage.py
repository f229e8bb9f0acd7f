"""The old gear comes out: clutch open, then the sleeve to neutral (thesis 2.2)."""

from __future__ import annotations

from typing import Final

from meshpoint.controller.shift.desk import CLUTCH_OPEN_SHARE, MS, OPPOSITE, ShiftDesk
from meshpoint.controller.shift.moment import Moment
from meshpoint.controller.shift.table import Trigger
from meshpoint.dbc.messages import ClutchAction, FaultCode
from meshpoint.gearbox import MainGear

PAUSE_US: Final = 60 * MS
"""Between two tries to pull a gear out the valve is off: torque may turn meanwhile."""


def open_clutch(desk: ShiftDesk, moment: Moment) -> Trigger | None:
    """Until the sensor says that it is open."""
    desk.clutch = ClutchAction.OPEN
    if (moment.view.clutch_closed or 0.0) <= CLUTCH_OPEN_SHARE:
        return Trigger.CLUTCH_OPEN
    if desk.late(moment, desk.settings.limits.clutch_ms):
        return desk.give_up(moment, FaultCode.CLUTCH_STUCK)
    return None


def disengage(desk: ShiftDesk, moment: Moment) -> Trigger | None:
    """Pulls the gear out, a bounded number of times. A change of the splitter alone needs none."""
    shift, gear = desk.running, moment.view.main_gear
    if gear is shift.target.main and moment.view.range_ is shift.target.range_:
        return Trigger.MAIN_BOX_STAYS
    if gear is MainGear.NEUTRAL:
        for valve in OPPOSITE.values():
            desk.board.off(valve)
        return Trigger.MAIN_BOX_NEUTRAL
    limits = desk.settings.limits
    # Each try has its share of the time; in the last PAUSE_US of it the valve is off.
    share_us = limits.disengage_ms * MS + PAUSE_US
    tried, within_us = divmod(moment.now_us - desk.since_us, share_us)
    if tried >= limits.attempts:
        return desk.give_up(moment, FaultCode.DISENGAGE_FAILED)
    pull_out(desk, moment, gear, within_us < limits.disengage_ms * MS)
    return None


def pull_out(desk: ShiftDesk, moment: Moment, gear: MainGear | None, drive: bool) -> None:
    """The valve opposite the gear on, or off."""
    if gear is None or gear is MainGear.NEUTRAL:
        return  # on its way
    valve = OPPOSITE[gear]
    if not drive:
        desk.board.off(valve)
    elif not desk.board.command(valve).on:
        desk.board.schedule(valve, True, moment.earliest_us, moment.now_us)
        desk.references.released()
