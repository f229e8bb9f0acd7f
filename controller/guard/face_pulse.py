"""Row 5 where a tooth stands on a tooth: a pulse of the brake may turn the gear on, past a sleeve
that is pressed on the faces of its teeth and has entered nothing.

Within the width of a face a gap comes by, and the sleeve goes in. What the brake can make of the
slip until then is bounded by its pressure at the pulse's end and the layshaft's inertia
(`limits.face_pulse_us`); drag is left out: a tooth that stands withstands it.
"""

from __future__ import annotations

from meshpoint.controller.guard.case import (
    FOREVER_US,
    MAIN_VALVES,
    JudgedCommand,
    Span,
)
from meshpoint.controller.guard.limits import (
    BRAKE_PRESSED_PA,
    CLEAR_M,
    LEAVING_M_S,
    SLIP_MARGIN_RAD_S,
)

LAYSHAFT, MAIN = 1, 2


def sleeve_on_a_tooth(case: JudgedCommand, brake: Span) -> int | None:
    """The main sleeve past which the brake moves a tooth on, and nothing more: the only one that is
    driven, at the faces of its gear's teeth, by a pulse that is short enough. One whose end is not
    commanded yet is judged as if the next command did so. None where there is none."""
    driven = [valve for valve in MAIN_VALVES if case.spans[valve] is not None]
    if len(driven) != 1:
        return None
    (valve,), limits, now_us = driven, case.limits, case.seen.now_us
    is_ended = brake.end_us < FOREVER_US
    next_us = max(now_us, brake.start_us) + limits.switch_again_us
    lasts_us = (brake.end_us if is_ended else next_us) - brake.start_us
    is_at_the_faces = abs(case.way_m(valve) - limits.contact_m) <= CLEAR_M
    may_last = lasts_us <= limits.face_pulse_us[valve]
    acts = now_us > brake.start_us + limits.brake_delay_us[0]
    may_begin = now_us > brake.start_us or _air_is_out(case)
    if is_at_the_faces and may_last and may_begin and (acts or _stands(case, valve)):
        return limits.main[valve].sleeve
    return None


def _stands(case: JudgedCommand, valve: int) -> bool:
    """Whether the sleeve stands, its gear turns with it, and the brake is empty."""
    layshaft, main, gear = case.speed(LAYSHAFT), case.speed(MAIN), case.limits.main[valve]
    if layshaft is None or main is None:
        return False
    return (
        abs(gear.ratio * layshaft - main) <= SLIP_MARGIN_RAD_S
        and abs(case.seen.means_m_s[gear.sleeve]) < LEAVING_M_S
        and case.seen.brake_pa - case.limits.atmosphere_pa <= BRAKE_PRESSED_PA
    )


def _air_is_out(case: JudgedCommand) -> bool:
    """Whether the brake has been off for so long that its pressure shows what is left of it."""
    shows_us = case.limits.brake_delay_us[1] + case.limits.brake_lag_us
    return case.seen.now_us - case.state.brake_off_us > shows_us
