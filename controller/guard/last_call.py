"""Row 3 at the last moment at which a sleeve that has been fired can be withdrawn.

Before it, a firing is forbidden only if no contact can come right: it is judged again. From then on
nothing can be mended, so it has to come right whatever the shafts may do until contact.
"""

from __future__ import annotations

from meshpoint.controller.guard.case import Case, Span
from meshpoint.controller.guard.limits import REACT_US, SLIP_MARGIN_RAD_S


def slip_may_leave_its_window(case: Case, valve: int, span: Span) -> bool:
    """Whether, at the last call, the slip may be outside its window at contact: the main shaft
    goes on swinging as it has, the layshaft keeps its speed at most and goes on falling as it does
    at least. A swing or a speed that is not known may do anything."""
    if not is_last_call(case, valve, span):
        return False
    layshaft, main = case.seen.swings
    if layshaft is None or main is None:
        return True
    _, late_us = case.contact_us(valve, span)
    ratio, (low, high) = case.limits.main[valve].ratio, case.limits.slip_rad_s
    main_least, main_most = main.between(late_us)
    ahead_s = max(0.0, late_us - layshaft.newest.time_us) * 1e-6
    most = layshaft.newest.omega_rad_s
    least = most + min(0.0, layshaft.rate_rad_s2) * ahead_s
    return (
        ratio * most - main_least > high + SLIP_MARGIN_RAD_S
        or ratio * least - main_most < low - SLIP_MARGIN_RAD_S
    )


def is_last_call(case: Case, valve: int, span: Span) -> bool:
    """Whether the sleeve has not met its gear yet, but may have when a command of the next step can
    act."""
    early_us, _ = case.contact_us(valve, span)
    return case.seen.now_us < early_us <= case.seen.now_us + REACT_US
