"""Valves by the commands on the bus: what their drivers take, when, and what is kept of it."""

from __future__ import annotations

import pytest

from meshpoint.dbc.messages import ValveAction, ValveCommand
from meshpoint.gearbox import MainGear
from meshpoint.testbench.identify.valve_switches import (
    BRAKE,
    VALVE_OF_GEAR,
    Switch,
    ValveSwitches,
)

NOW_US = 5_000_000


def brake_at(time_us: int, action: ValveAction = ValveAction.ON_AT) -> ValveCommand:
    return ValveCommand(brake_action=action, brake_time_us=time_us)


@pytest.mark.parametrize(
    ("ahead_us", "is_taken"),
    [(100_000, True), (100_001, False), (0, True), (-1, True), (-2_000, True), (-2_001, False)],
)
def test_an_activation_is_taken_from_2_ms_late_to_100_ms_ahead(
    ahead_us: int, is_taken: bool
) -> None:
    """At its own time, exactly, even where it came too late for that."""
    valves = ValveSwitches()
    valves.take(brake_at(NOW_US + ahead_us), NOW_US)
    expected = [Switch(NOW_US + ahead_us, True, True)] if is_taken else []
    assert valves.of(BRAKE, NOW_US + 1_000_000) == expected


def test_an_activation_takes_place_at_its_time_and_not_a_microsecond_before() -> None:
    valves = ValveSwitches()
    valves.take(brake_at(NOW_US + 30_000), NOW_US)
    assert valves.of(BRAKE, NOW_US + 29_999) == []
    assert valves.of(BRAKE, NOW_US + 30_000) == [Switch(NOW_US + 30_000, True, True)]


def test_an_activation_for_this_very_moment_waits_for_the_next_look() -> None:
    """Another command in the same step still takes its place: it has not switched yet."""
    valves = ValveSwitches()
    valves.take(brake_at(NOW_US), NOW_US)
    assert valves._slots[BRAKE].switches == []
    assert valves.of(BRAKE, NOW_US) == [Switch(NOW_US, True, True)]


def test_what_is_off_already_is_not_switched_off() -> None:
    """And a driver does at most once what it was told once, however often it is looked at."""
    valves = ValveSwitches()
    valves.take(brake_at(NOW_US + 10_000, ValveAction.OFF_AT), NOW_US)
    assert valves.of(BRAKE, NOW_US + 20_000) == []
    valves.take(ValveCommand(brake_action=ValveAction.ON_NOW), NOW_US + 30_000)
    assert valves.of(BRAKE, NOW_US + 90_000) == [Switch(NOW_US + 30_000, True, False)]


def test_a_command_that_is_repeated_is_one() -> None:
    """The second of the same, after its time, finds it done."""
    valves = ValveSwitches()
    for later_us in (0, 10_000, 31_000):
        valves.take(brake_at(NOW_US + 30_000), NOW_US + later_us)
    assert valves.of(BRAKE, NOW_US + 60_000) == [Switch(NOW_US + 30_000, True, True)]
    assert valves.commands == 3


def test_an_activation_takes_the_place_of_the_one_that_waits_even_where_it_is_refused() -> None:
    valves = ValveSwitches()
    valves.take(brake_at(NOW_US + 30_000), NOW_US)
    valves.take(brake_at(NOW_US + 200_000), NOW_US + 10_000)
    assert valves.of(BRAKE, NOW_US + 300_000) == []


def test_off_at_once_ends_what_waits_and_what_is_on() -> None:
    valves = ValveSwitches()
    valves.take(brake_at(NOW_US + 30_000), NOW_US)
    valves.take(ValveCommand(brake_action=ValveAction.OFF_NOW), NOW_US + 10_000)
    assert valves.of(BRAKE, NOW_US + 90_000) == []
    valves.take(ValveCommand(brake_action=ValveAction.ON_NOW), NOW_US + 91_000)
    valves.take(ValveCommand(brake_action=ValveAction.OFF_NOW), NOW_US + 92_000)
    assert valves.of(BRAKE, NOW_US + 99_000) == [
        Switch(NOW_US + 91_000, True, False),
        Switch(NOW_US + 92_000, False, False),
    ]


def test_a_late_command_to_switch_off_takes_place_at_its_own_time() -> None:
    valves = ValveSwitches()
    valves.take(ValveCommand(brake_action=ValveAction.ON_NOW), NOW_US)
    valves.take(brake_at(NOW_US + 9_000, ValveAction.OFF_AT), NOW_US + 10_000)
    assert valves.of(BRAKE, NOW_US + 10_000)[1:] == [Switch(NOW_US + 9_000, False, True)]


@pytest.mark.parametrize("gear", list(VALVE_OF_GEAR))
def test_each_main_gear_has_its_own_valve(gear: MainGear) -> None:
    valves, name = ValveSwitches(), f"main_{gear.name.lower()}"
    action = {f"{name}_action": ValveAction.ON_AT, f"{name}_time_us": NOW_US + 5_000}
    valves.take(ValveCommand(**action), NOW_US)  # type: ignore[arg-type]
    for each, valve in VALVE_OF_GEAR.items():
        expected = [Switch(NOW_US + 5_000, True, True)] if each is gear else []
        assert valves.of(valve, NOW_US + 5_000) == expected
    assert valves.of(BRAKE, NOW_US + 5_000) == []


def test_of_what_is_older_each_valve_keeps_its_newest_switch() -> None:
    valves = ValveSwitches()
    assert valves.commands == 0
    for k, action in enumerate([ValveAction.ON_NOW, ValveAction.OFF_NOW] * 2):
        valves.take(ValveCommand(brake_action=action), NOW_US + 1_000 * k)
    own = list(valves.of(BRAKE, NOW_US + 9_000))
    assert [switch.time_us - NOW_US for switch in own] == [0, 1_000, 2_000, 3_000]
    for before_us, left in ((0, own), (1_000, own[1:]), (1_001, own[2:]), (9_000, own[3:])):
        valves.forget(NOW_US + before_us)
        assert valves.of(BRAKE, NOW_US + 9_000) == left
    valves.forget(NOW_US + 10_000)
    assert valves.of("main_first", NOW_US + 10_000) == []
