"""The guard blocks what would break the gearbox, whatever the sequence believes."""

from __future__ import annotations

from itertools import product

import pytest

from controller.guard import Guard, Seen, decode
from controller.settings import ControllerSettings
from controller.valves import NAMES, Valve
from dbc.link import Transmitter
from dbc.messages import ValveAction, ValveCommand
from dbc.node import Node

MAX_ON_US = 3_000_000
DRIVING = (ValveAction.ON_NOW, ValveAction.ON_AT)
IDLE = (ValveAction.OFF_NOW, ValveAction.OFF_AT)
NEUTRAL = Seen(1_000_000, 0.0, 0.0, 0.0, True)
"""Clutch open, main box in neutral, positions valid: all an upshift needs is allowed."""
PAIRS = [
    (Valve.SPLIT_LOW, Valve.SPLIT_HIGH),
    (Valve.MAIN_FIRST, Valve.MAIN_SECOND),
    (Valve.MAIN_CRAWL, Valve.MAIN_THIRD),
    (Valve.RANGE_LOW, Valve.RANGE_HIGH),
]
FIRST_SECOND = (Valve.MAIN_FIRST, Valve.MAIN_SECOND)
CRAWL_THIRD = (Valve.MAIN_CRAWL, Valve.MAIN_THIRD)


def payload(*driven: Valve, how: ValveAction = ValveAction.ON_AT, time_us: int = 5) -> bytes:
    """A finished command frame that drives these valves."""
    fields = {f"{NAMES[valve]}_action": how for valve in driven}
    fields |= {f"{NAMES[valve]}_time_us": time_us for valve in Valve}
    return Transmitter(Node.TRANSMISSION_CONTROL).encode(ValveCommand(**fields)).data


def blocked_row(seen: Seen, *driven: Valve, how: ValveAction = ValveAction.ON_AT) -> int | None:
    guard = Guard(MAX_ON_US)
    passes = guard.passes(payload(*driven, how=how), seen)
    assert passes is (guard.blocked_row is None)
    assert guard.blocks == (not passes)
    return guard.blocked_row


@pytest.mark.parametrize("valve", Valve)
@pytest.mark.parametrize("how", DRIVING)
def test_one_valve_alone_in_neutral_may_be_driven(valve: Valve, how: ValveAction) -> None:
    assert blocked_row(NEUTRAL, valve, how=how) is None


@pytest.mark.parametrize("seen", [NEUTRAL, Seen(0, 0.012, -0.012, 1.0, False)])
@pytest.mark.parametrize("how", IDLE)
def test_switching_off_is_always_allowed(seen: Seen, how: ValveAction) -> None:
    assert blocked_row(seen, *Valve, how=how) is None


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("how", DRIVING)
def test_row_1_both_valves_of_a_sleeve(pair: tuple[Valve, Valve], how: ValveAction) -> None:
    assert blocked_row(NEUTRAL, *pair, how=how) == 1


@pytest.mark.parametrize("both", list(product(FIRST_SECOND, CRAWL_THIRD)))
def test_row_2_two_sleeves_of_the_main_box(both: tuple[Valve, Valve]) -> None:
    assert blocked_row(NEUTRAL, *both) == 2


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("own", FIRST_SECOND + CRAWL_THIRD)
def test_row_2_a_sleeve_while_the_other_is_not_proven_neutral(own: Valve, side: float) -> None:
    """1.5 mm is proof; the sleeve's own position does not count: so it is pulled out."""
    first_second = own in FIRST_SECOND
    for other_mm, row in ((1.4, None), (1.6, 2), (12.0, 2)):
        other_m = side * other_mm * 1e-3
        seen = NEUTRAL._replace(**{"crawl_third_m" if first_second else "first_second_m": other_m})
        assert blocked_row(seen, own) == row
        own_out = NEUTRAL._replace(
            **{"first_second_m" if first_second else "crawl_third_m": other_m}
        )
        assert blocked_row(own_out, own) is None


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("sleeve", ["first_second_m", "crawl_third_m"])
def test_row_5_the_brake_with_a_gear_in_mesh(sleeve: str, side: float) -> None:
    assert blocked_row(NEUTRAL._replace(**{sleeve: side * 1.4e-3}), Valve.BRAKE) is None
    assert blocked_row(NEUTRAL._replace(**{sleeve: side * 1.6e-3}), Valve.BRAKE) == 5


@pytest.mark.parametrize("valve", FIRST_SECOND + CRAWL_THIRD)
def test_row_5_the_brake_while_a_gear_is_being_engaged(valve: Valve) -> None:
    assert blocked_row(NEUTRAL, Valve.BRAKE, valve) == 5


def test_row_5_the_brake_against_the_engine() -> None:
    assert blocked_row(NEUTRAL._replace(clutch_closed=0.04), Valve.BRAKE) is None
    assert blocked_row(NEUTRAL._replace(clutch_closed=0.06), Valve.BRAKE) == 5
    assert blocked_row(NEUTRAL._replace(clutch_closed=1.0), Valve.MAIN_SECOND) is None


@pytest.mark.parametrize("valve", Valve)
def test_row_12_nothing_moves_before_positions_are_known(valve: Valve) -> None:
    assert blocked_row(NEUTRAL._replace(positions_valid=False), valve) == 12


@pytest.mark.parametrize("valve", Valve)
def test_row_7_a_valve_on_for_too_long(valve: Valve) -> None:
    """Resent every 10 ms; off for one frame in between begins anew."""
    guard = Guard(MAX_ON_US)
    on, off = payload(valve), payload()
    for now_us in range(10_000, 10_000 + MAX_ON_US + 1, 10_000):
        assert guard.passes(on, NEUTRAL._replace(now_us=now_us))
    assert not guard.passes(on, NEUTRAL._replace(now_us=20_000 + MAX_ON_US))
    assert guard.blocked_row == 7
    other = Guard(MAX_ON_US)
    assert other.passes(on, NEUTRAL._replace(now_us=10_000))
    assert other.passes(off, NEUTRAL._replace(now_us=MAX_ON_US))
    assert other.passes(on, NEUTRAL._replace(now_us=MAX_ON_US + 10_000))
    assert other.passes(on, NEUTRAL._replace(now_us=MAX_ON_US + 500_000))


@pytest.mark.parametrize("mistake", [PAIRS[1], (Valve.MAIN_FIRST, Valve.MAIN_THIRD)])
def test_a_command_that_should_never_be_made_latches(mistake: tuple[Valve, Valve]) -> None:
    """Rows 1 and 2 mean that the sequence is wrong: nothing is driven until it takes all back."""
    guard = Guard(MAX_ON_US)
    assert not guard.passes(payload(*mistake), NEUTRAL)
    for _ in range(3):
        assert not guard.passes(payload(Valve.MAIN_SECOND), NEUTRAL)
    assert guard.blocks == 4
    assert guard.passes(payload(), NEUTRAL)
    assert guard.passes(payload(Valve.MAIN_SECOND), NEUTRAL)


def test_a_row_that_depends_on_the_moment_does_not_latch() -> None:
    guard = Guard(MAX_ON_US)
    assert not guard.passes(payload(Valve.BRAKE), NEUTRAL._replace(clutch_closed=0.5))
    assert guard.passes(payload(Valve.BRAKE), NEUTRAL)


@pytest.mark.parametrize("length", [0, 5, 47, 49, 64])
def test_a_frame_of_another_length_is_no_valve_command(length: int) -> None:
    with pytest.raises(ValueError, match="48"):
        decode(bytes(length))


def test_the_longest_time_on_comes_from_the_settings() -> None:
    assert ControllerSettings().limits.valve_on_ms * 1000 == MAX_ON_US
