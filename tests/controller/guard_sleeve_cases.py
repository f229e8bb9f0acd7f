"""What the guard's tests of a main sleeve share: what is seen of it, commands to its valves, and
how far it was brought.

The sleeve of first and second gear is fired at second, whose slip is 20 rpm; that of first gear is
far outside row 3's window, so that row 3 tells where its valve counts as engaging.
"""

from __future__ import annotations

from guard_cases import LIMITS, NEUTRAL, NOW, encoded, place, ready, speeds, swing_within

from meshpoint.controller.guard.case import MAIN_VALVES
from meshpoint.controller.guard.rules import Guard
from meshpoint.controller.guard.view import GuardInputs
from meshpoint.dbc.messages import ValveAction, ValveCommand

FIRST, SECOND, CRAWL, THIRD = MAIN_VALVES
OFF_NOW, ON_NOW, OFF_AT, ON_AT = ValveAction
NAMES = {0: "brake", 1: "split_low", 3: "main_first", 4: "main_second", 5: "main_crawl",
         6: "main_third", 8: "range_high"}  # fmt: skip
BRAKE, SPLIT_LOW, RANGE_HIGH = 0, 1, 8
Order = tuple[ValveAction, float]


def at(ms: float, way_mm: float = 0.0, speed_m_s: float = 0.0, late_ms: float = 10.0,
       slip_rpm: float = 20.0) -> GuardInputs:  # fmt: skip
    """So long after NOW: the sleeve sampled `late_ms` ago, toward second gear; the shafts calm."""
    now_us = NOW + round(1e3 * ms)
    a, b, c, d = (each._replace(time_us=now_us - 10_000) for each in speeds(slip_rpm=slip_rpm))
    calm = [swing_within(each, 0.0, 0.0, 1e3) for each in (b, c)]
    return place(NEUTRAL, 0, 1e-3 * way_mm)._replace(
        now_us=now_us, positions_us=now_us - round(1e3 * late_ms), speeds=(a, b, c, d),
        speeds_m_s=(speed_m_s, 0.0), means_m_s=(speed_m_s, 0.0), swings=(calm[0], calm[1]),
    )  # fmt: skip


def command(orders: dict[int, Order]) -> bytes:
    """Each valve's action and its time in ms after NOW; all others off."""
    fields: dict[str, object] = {}
    for valve, (action, at_ms) in orders.items():
        fields[f"{NAMES[valve]}_action"] = action
        fields[f"{NAMES[valve]}_time_us"] = (NOW + round(1e3 * at_ms)) & 0xFFFF_FFFF
    return encoded(ValveCommand(**fields))  # type: ignore[arg-type]


def row(guard: Guard, seen: GuardInputs, orders: dict[int, Order] | None = None) -> int | None:
    """The row that forbids a command; None where it passes."""
    guard.passes(command(orders or {}), seen)
    return guard.blocked_row


def fired(on_ms: float = 4.0) -> Guard:
    """Second gear fired from neutral, and judged at NOW and 10 ms later."""
    guard = ready()
    for ms in (0.0, 10.0):
        assert row(guard, at(ms), {SECOND: (ON_AT, on_ms)}) is None
    return guard


def aborted() -> Guard:
    """Fired, on for 16 ms; then first's valve for 12 ms; all off 34 ms after NOW."""
    guard = fired()
    assert row(guard, at(20), {FIRST: (ON_AT, 22)}) is None
    assert row(guard, at(30), {FIRST: (OFF_AT, 34)}) is None
    assert row(guard, at(40)) is None
    return guard


def standing(way_mm: float, since_ms: float = 100.0) -> Guard:
    """Aborted, and seen to stand so far toward second gear."""
    guard = aborted()
    assert row(guard, at(since_ms, way_mm)) is None
    return guard


def slip_for(valve: int) -> float:
    """Slip of second gear at which this valve's gear has 20 rpm."""
    second, other = (LIMITS.main[each].ratio for each in (SECOND, valve))
    return 20.0 - (other - second) * 1000.0
