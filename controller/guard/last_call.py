"""Row 3 once a sleeve has been fired: when its valve going off last stops it, and when it comes
near its gear.

Before, a firing is forbidden only if no contact can come right: it is judged again. In the last
step in which the sleeve still stops short of the teeth the slip has to come right whatever the main
shaft may do if the layshaft keeps its speed; in the last one before contact, whatever both may do.
"""

from __future__ import annotations

from meshpoint.controller.guard.case import JudgedCommand, Span
from meshpoint.controller.guard.limits import REACT_US, SLIP_MARGIN_RAD_S
from meshpoint.controller.guard.sleeve_motion import longest_pulse_us
from meshpoint.controller.guard.swing import Swing


def slip_may_leave_its_window(case: JudgedCommand, valve: int, span: Span) -> bool:
    """Whether the slip at contact is outside its window as far as is known now. A swing or a
    speed that is not known may do anything. Layshaft and main shaft, or, of a splitter's sleeve,
    input shaft and layshaft."""
    stops, last = is_last_stop(case, valve, span), is_last_call(case, valve, span)
    if not stops and not last:
        return False
    meeting = case.limits.dogs[valve].meeting
    layshaft, main = case.swing(meeting.falls), case.swing(meeting.holds)
    if layshaft is None or main is None:
        return True
    early_us, late_us = case.contact_us(valve, span)
    # The main shaft goes on swinging as it has.
    swings = main.between(early_us, late_us)
    most = least = layshaft.newest.omega_rad_s
    if valve in case.limits.splitter:
        # In gear it swings more slowly, and further than within a period; and open plates take the
        # input shaft along.
        then = _goes_on(main, late_us)
        swings = (min(swings[0], then), max(swings[1], then))
        most = max(most, _goes_on(layshaft, late_us))
    main_least, main_most = (meeting.over * each for each in swings)
    if not last:
        # The newest speed is some hundredths of a second old: the layshaft has fallen on until now.
        passed_s = max(0.0, case.seen.now_us - layshaft.newest.time_us) * 1e-6
        most = least = most + min(0.0, layshaft.rate_rad_s2) * passed_s
    else:
        # Once no brake acts any more, the layshaft falls as it does or not at all.
        ahead_s = max(0.0, late_us - layshaft.newest.time_us) * 1e-6
        least += min(0.0, layshaft.rate_rad_s2) * ahead_s
    ratio, (low, high) = meeting.by, case.limits.slip_rad_s
    return (
        ratio * most - main_least > high + SLIP_MARGIN_RAD_S
        or ratio * least - main_most < low - SLIP_MARGIN_RAD_S
    )


def _goes_on(shaft: Swing, until_us: float) -> float:
    """The speed (rad/s) of a shaft that goes on changing as it does."""
    ahead_s = max(0.0, until_us - shaft.newest.time_us) * 1e-6
    return shaft.newest.omega_rad_s + shaft.rate_rad_s2 * ahead_s


def is_last_stop(case: JudgedCommand, valve: int, span: Span) -> bool:
    """Whether a command that switches the valve off still stops the sleeve short of the teeth, but
    may come too late for that in the next step."""
    stopped_us = span.start_us + longest_pulse_us(case.limits, case.set_off_m(valve, span))
    return case.seen.now_us < stopped_us <= case.seen.now_us + REACT_US


def is_last_call(case: JudgedCommand, valve: int, span: Span) -> bool:
    """Whether the sleeve has not met its gear yet, but may have when a command of the next step can
    act."""
    early_us, _ = case.contact_us(valve, span)
    return case.seen.now_us < early_us <= case.seen.now_us + REACT_US
