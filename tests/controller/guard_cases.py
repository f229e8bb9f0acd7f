"""What the tests of the guard's rows are made of: a moment at which a valve may be driven, and what
is changed in it."""

from __future__ import annotations

from meshpoint.controller.guard.case import GuardState
from meshpoint.controller.guard.driveline import DrivelineGuard, DrivelineState
from meshpoint.controller.guard.limits import GuardLimits, guard_limits
from meshpoint.controller.guard.own_speed import ShaftSpeed as Speed
from meshpoint.controller.guard.rules import (
    PROOF_STEPS,
    Guard,
)
from meshpoint.controller.guard.swing import Swing
from meshpoint.controller.guard.view import GuardInputs
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import ValveAction, ValveCommand
from meshpoint.dbc.node import Node
from meshpoint.gearbox import MainGear, Split, load_sheet
from meshpoint.units import RPM

SHEET = load_sheet("truck12")
SETTINGS = ControllerSettings()
LIMITS = guard_limits(SHEET, SETTINGS)
NOW = (1 << 32) + 700_000
"""After one wrap of the clock."""
ASKED = 8
"""A gear that is not in: what the sleeves are moved for."""
DRIVING = (ValveAction.ON_NOW, ValveAction.ON_AT)
FOREVER = 1 << 62
PAIRS = [
    (ValveName.SPLIT_LOW, ValveName.SPLIT_HIGH),
    (ValveName.MAIN_FIRST, ValveName.MAIN_SECOND),
    (ValveName.MAIN_CRAWL, ValveName.MAIN_THIRD),
    (ValveName.RANGE_LOW, ValveName.RANGE_HIGH),
]
GEAR_OF = {
    ValveName.MAIN_FIRST: MainGear.FIRST,
    ValveName.MAIN_SECOND: MainGear.SECOND,
    ValveName.MAIN_CRAWL: MainGear.CRAWL,
    ValveName.MAIN_THIRD: MainGear.THIRD,
}
MAIN = tuple(GEAR_OF)
SLEEVE = {
    ValveName.MAIN_FIRST: 0,
    ValveName.MAIN_SECOND: 0,
    ValveName.MAIN_CRAWL: 1,
    ValveName.MAIN_THIRD: 1,
}
WAY = {
    ValveName.MAIN_FIRST: -1,
    ValveName.MAIN_SECOND: 1,
    ValveName.MAIN_CRAWL: -1,
    ValveName.MAIN_THIRD: 1,
}
OTHER_END = {a: b for pair in PAIRS for a, b in (pair, pair[::-1])}


def speeds(
    layshaft_rpm: float = 1000.0, gear: MainGear = MainGear.SECOND, slip_rpm: float = 20.0
) -> tuple[Speed, Speed, Speed, Speed]:
    """All four shafts, high split, low range, with this slip of a gear, as of 10 ms ago."""
    layshaft = layshaft_rpm * RPM
    main = SHEET.main_mesh(gear).ratio * layshaft - slip_rpm * RPM
    turning = (layshaft / SHEET.split_mesh(Split.HIGH).ratio, layshaft, main, main / 3.75)
    a, b, c, d = (Speed(NOW - 10_000, omega) for omega in turning)
    return a, b, c, d


def swing_within(
    newest: Speed, rate_rad_s2: float, least_rad_s: float, most_rad_s: float,
    falls_rad_s2: float = 0.0, rises_rad_s2: float = 0.0,
) -> Swing:  # fmt: skip
    """A shaft that has been as slow and as fast within a period, and has changed so fast."""
    speeds = tuple(newest._replace(omega_rad_s=each) for each in (least_rad_s, most_rad_s))
    return Swing(newest, rate_rad_s2, speeds, (falls_rad_s2, rises_rad_s2))


def calm(turning: tuple[Speed, Speed, Speed, Speed]) -> tuple[Swing, Swing]:
    """Layshaft and main shaft as they are if they have turned at these speeds for a period."""
    _, *both, _ = turning
    layshaft, main = (
        swing_within(speed, 0.0, speed.omega_rad_s, speed.omega_rad_s) for speed in both
    )
    return layshaft, main


NEUTRAL = GuardInputs(
    NOW, (0.0, 0.0, 0.012, -0.012), 0.0, 9.5e5, 1.013e5, speeds(), 0,
    valid=True, swings=calm(speeds()),
)  # fmt: skip
"""Clutch open, main box in neutral, high split, low range, second gear near, no shaft swings: a
shift's moment."""


def place(seen: GuardInputs, sleeve: int, position_m: float) -> GuardInputs:
    positions = list(seen.positions_m)
    positions[sleeve] = position_m
    a, b, c, d = positions
    return seen._replace(positions_m=(a, b, c, d))


def payload(
    *driven: ValveName, how: ValveAction = ValveAction.ON_AT, at_us: int = NOW + 20_000
) -> bytes:
    """A finished command frame that drives these valves; a time is low 32 bits."""
    fields: dict[str, object] = {f"{valve.name.lower()}_action": how for valve in driven}
    fields |= {f"{valve.name.lower()}_time_us": at_us & 0xFFFF_FFFF for valve in driven}
    command = ValveCommand(**fields)  # type: ignore[arg-type]
    return Transmitter(Node.TRANSMISSION_CONTROL).encode(command).data


def ready(limits: GuardLimits = LIMITS, seen: GuardInputs = NEUTRAL) -> Guard:
    """A guard past its self-test."""
    guard = Guard(limits, armed=True)
    for _ in range(PROOF_STEPS):
        assert guard.passes(payload(), seen._replace(valid=True, requested_gear=ASKED))
    return guard


def kept(guard: Guard) -> GuardState:
    """What a guard keeps from frame to frame: tests look into it here alone."""
    return guard._state


def kept_of_driveline(guard: DrivelineGuard) -> DrivelineState:
    """The same of the guard of clutch and engine."""
    return guard._state


def blocked_row(
    seen: GuardInputs,
    *driven: ValveName,
    how: ValveAction = ValveAction.ON_AT,
    at_us: int = NOW + 20_000,
) -> int | None:
    guard = ready()
    passes = guard.passes(payload(*driven, how=how, at_us=at_us), seen)
    assert passes is (guard.blocked_row is None)
    assert guard.blocks == (not passes)
    return guard.blocked_row


def near(valve: ValveName) -> GuardInputs:
    """The moment at which this valve may be driven."""
    if valve in MAIN:
        turning = speeds(gear=GEAR_OF[valve])
        return NEUTRAL._replace(speeds=turning, swings=calm(turning))
    return NEUTRAL


def braking(until_us: int) -> tuple[Guard, ValveCommand]:
    """A guard that has let the brake on 100 ms ago; a command with its release to come."""
    guard = ready()
    early = NEUTRAL._replace(
        now_us=NOW - 100_000, speeds=tuple(s._replace(time_us=NOW - 110_000) for s in speeds(1500))
    )
    assert guard.passes(payload(ValveName.BRAKE, how=ValveAction.ON_NOW), early)
    release = ValveCommand(
        brake_action=ValveAction.OFF_AT,
        brake_time_us=until_us & 0xFFFF_FFFF,
        main_second_action=ValveAction.ON_AT,
        main_second_time_us=(NOW + 30_000) & 0xFFFF_FFFF,
    )
    return guard, release


def encoded(command: ValveCommand) -> bytes:
    return Transmitter(Node.TRANSMISSION_CONTROL).encode(command).data
