"""The valve drivers obey the rules of the wire contract."""

from __future__ import annotations

from typing import NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.dbc.messages import ValveAction
from meshpoint.rig_sim.shared.valve_drivers import Order, Valve, ValveBank

NINE = len(Valve)
WRAP = 1 << 32
ON_AT, OFF_AT = ValveAction.ON_AT, ValveAction.OFF_AT
ON, OFF = ValveAction.ON_NOW, ValveAction.OFF_NOW


def brake(action: ValveAction, time_us: int = 0) -> tuple[Order, ...]:
    return (Order(action, time_us % WRAP), *[Order(OFF)] * (NINE - 1))


class At(NamedTuple):
    """A change and when it was."""

    valve: Valve
    on: bool
    time_us: int


def next_us(bank: ValveBank) -> int | None:
    """When something is due, where the sensor clock is the drivers' own time."""
    dues_us = [due for due in (bank.activation_us, bank.expiry_us) if due is not None]
    return min(dues_us, default=None)


def run_to(bank: ValveBank, now_us: int) -> list[At]:
    changes = []
    while (due_us := next_us(bank)) is not None and due_us <= now_us:
        made = bank.activate(due_us) + bank.expire(due_us)
        changes += [At(*change, due_us) for change in made]
    return changes


def test_an_activation_happens_at_its_microsecond() -> None:
    bank = ValveBank()
    assert bank.command(brake(ON_AT, 34_567), 0, 0) == []
    assert bank.pending[Valve.BRAKE]
    assert run_to(bank, 50_000) == [At(Valve.BRAKE, True, 34_567)]
    assert bank.energised[Valve.BRAKE] and not bank.pending[Valve.BRAKE]


def orders(**given: tuple[ValveAction, int]) -> tuple[Order, ...]:
    """Of the valves named; all others off."""
    return tuple(Order(*given.get(valve.name.lower(), (OFF, 0))) for valve in Valve)


SLEEVES = [
    ("split_low", "split_high"),
    ("main_first", "main_second"),
    ("main_crawl", "main_third"),
    ("range_low", "range_high"),
]


@pytest.mark.parametrize(("pushes", "other"), [*SLEEVES, *((b, a) for a, b in SLEEVES)])
def test_a_release_of_the_other_valve_of_its_sleeve_ends_a_pulse(pushes: str, other: str) -> None:
    bank, valve = ValveBank(), Valve[pushes.upper()]
    pulse = orders(**{pushes: (ON_AT, 9_000), other: (OFF_AT, 23_000), "brake": (ON, 0)})
    bank.command(pulse, 0, 0)
    assert run_to(bank, 12_000) == [At(valve, True, 9_000)]
    bank.command(pulse, 12_000, 12_000)  # sent again: it goes on as it was
    assert run_to(bank, 90_000) == [At(valve, False, 23_000)]


def test_a_release_leaves_a_valve_that_goes_on_with_it_or_later() -> None:
    for on_us in (23_000, 23_001):
        bank = ValveBank()
        bank.command(orders(main_first=(ON, 0)), 0, 0)
        turned = orders(main_first=(OFF_AT, 23_000), main_second=(ON_AT, on_us))
        bank.command(turned, 1_000, 1_000)
        run_to(bank, 30_000)
        assert bank.energised[Valve.MAIN_SECOND] and not bank.energised[Valve.MAIN_FIRST]


def test_both_times_of_a_pulse_come_true_at_once_as_the_clock_steps() -> None:
    bank = ValveBank()
    bank.command(orders(main_second=(ON_AT, 9_000), main_first=(OFF_AT, 23_000)), 0, 0)
    assert bank.activate(2_000_000) == []
    assert not any(bank.energised) and not any(bank.pending)


def test_the_newest_frame_replaces_or_cancels() -> None:
    bank = ValveBank()
    bank.command(brake(ON_AT, 30_000), 0, 0)
    bank.command(brake(ON_AT, 40_000), 10_000, 10_000)
    assert run_to(bank, 35_000) == []
    bank.command(brake(OFF), 36_000, 36_000)
    assert run_to(bank, 60_000) == []


def test_resending_what_has_passed_holds_it_and_never_arms_it_again() -> None:
    bank = ValveBank()
    bank.command(brake(ON_AT, 5_000), 0, 0)
    run_to(bank, 10_000)
    for now_us in range(10_000, 90_000, 10_000):
        assert bank.command(brake(ON_AT, 5_000), now_us, now_us) == []
        assert bank.energised[Valve.BRAKE]
    bank.command(brake(OFF), 90_000, 90_000)
    assert bank.command(brake(ON_AT, 5_000), 90_500, 90_500) == []
    assert not bank.energised[Valve.BRAKE]
    assert bank.refused == 0


@pytest.mark.parametrize(
    ("ahead_us", "taken"),
    [(-2_001, False), (-2_000, True), (0, True), (100_000, True), (100_001, False)],
)
def test_activations_too_late_or_too_far_ahead_are_refused(ahead_us: int, taken: bool) -> None:
    bank = ValveBank()
    now_us = 5 * WRAP - 10  # the 32-bit clock wraps in between
    for again in range(3):
        bank.command(brake(ON_AT, now_us + ahead_us), now_us + again, now_us + again)
    assert bank.refused == (0 if taken else 1)
    run_to(bank, now_us + 100_000)
    assert bank.energised[Valve.BRAKE] is taken


def test_a_refused_activation_leaves_the_valve_as_it_is() -> None:
    bank = ValveBank()
    bank.command(brake(ON), 0, 0)
    bank.command(brake(OFF_AT, 500_000), 10_000, 10_000)
    run_to(bank, 100_000)
    assert bank.energised[Valve.BRAKE]


def test_all_is_off_100_ms_after_the_last_frame() -> None:
    bank = ValveBank()
    bank.command(brake(ON), 0, 0)
    bank.command((Order(ON), Order(ON_AT, 109_999), *[Order(OFF)] * (NINE - 2)), 10_000, 10_000)
    assert run_to(bank, 109_998) == []
    assert run_to(bank, 109_999) == [At(Valve.SPLIT_LOW, True, 109_999)]
    assert {(c.valve, c.on, c.time_us) for c in run_to(bank, 200_000)} == {
        (Valve.BRAKE, False, 110_000),
        (Valve.SPLIT_LOW, False, 110_000),
    }
    assert bank.expired == 1
    assert next_us(bank) is None
    bank.command((Order(OFF), Order(ON_AT, 109_999), *[Order(OFF)] * (NINE - 2)), 111_000, 111_000)
    assert not any(bank.energised)


@pytest.mark.parametrize("step_us", [-1_000_000, -99_999, 99_999, 1_000_000, WRAP // 2])
def test_the_expiry_does_not_go_by_the_sensor_clock(step_us: int) -> None:
    """Commands stop; the sensor clock has jumped since the last one, or jumps before the next."""
    bank = ValveBank()
    clock_us = 2 * WRAP
    bank.command(brake(ON), clock_us, 0)
    bank.command(brake(ON), clock_us + 10_000 + step_us, 10_000)
    assert bank.expire(109_999) == []
    assert bank.energised[Valve.BRAKE]
    assert [change.on for change in bank.expire(110_000)] == [False]
    assert bank.expired == 1
    assert not any(bank.energised)


def test_of_valves_switched_together_those_going_off_come_first() -> None:
    bank = ValveBank()
    bank.command((Order(OFF), Order(OFF), Order(ON), *[Order(OFF)] * (NINE - 3)), 0, 0)
    changes = bank.command((Order(OFF), Order(ON), Order(OFF), *[Order(OFF)] * (NINE - 3)), 10, 10)
    assert [change.on for change in changes] == [False, True]


def test_a_bank_begins_with_everything_off_and_nothing_waiting() -> None:
    bank = ValveBank()
    assert bank.energised == bank.pending == (False,) * NINE
    assert bank.activation_us is bank.expiry_us is None
    assert Order(OFF) == (OFF, 0)


def test_what_waits_longest_and_what_comes_first_are_told_apart() -> None:
    bank = ValveBank()
    bank.command((Order(ON_AT, 30_000), Order(ON_AT, 20_000), *[Order(OFF)] * (NINE - 2)), 0, 0)
    assert bank.activation_us == 20_000
    assert bank.activate(20_000) == [(Valve.SPLIT_LOW, True)]
    assert bank.activation_us == 30_000


def test_a_command_has_an_order_for_each_valve() -> None:
    with pytest.raises(ValueError, match="argument"):
        ValveBank().command((Order(OFF),) * (NINE - 1), 0, 0)


def test_an_activation_a_microsecond_ahead_waits_for_it() -> None:
    bank = ValveBank()
    assert bank.command(brake(ON_AT, 1), 0, 0) == []
    assert bank.activation_us == 1


@pytest.mark.parametrize("again_us", [150_001, -2_001])
def test_a_refused_activation_empties_the_slot(again_us: int) -> None:
    bank = ValveBank()
    bank.command(brake(ON_AT, 50_000), 10_000, 10_000)
    bank.command(brake(ON_AT, again_us), 20_000, 20_000)
    assert bank.refused == 1
    assert not any(bank.pending)
    assert run_to(bank, 119_999) == []


def test_the_command_before_once_more_renews_the_expiry_alone() -> None:
    bank = ValveBank()
    assert bank.renew(0) is False
    assert bank.expiry_us is None
    bank.command(brake(ON), 0, 0)
    assert bank.renew(60_000) is True
    assert bank.energised[Valve.BRAKE]
    assert bank.expire(159_999) == []
    assert bank.expire(160_000) == [(Valve.BRAKE, False)]
    assert bank.renew(160_001) is False
    assert bank.expiry_us is None


class Sent(NamedTuple):
    now_us: int
    action: ValveAction
    ahead_us: int


@st.composite
def traffic(draw: st.DrawFn) -> list[Sent]:
    """Commands to one valve: activation times on a coarse grid, so that many are resent."""
    sent = []
    now_us = draw(st.sampled_from([0, WRAP - 50_000]))
    for _ in range(draw(st.integers(1, 12))):
        now_us += draw(st.sampled_from([0, 1, 5_000, 10_000, 10_000, 10_000, 99_999, 100_000]))
        action = draw(st.sampled_from(list(ValveAction)))
        target_us = (now_us // 10_000 + draw(st.integers(-1, 11))) * 10_000
        sent.append(Sent(now_us, action, target_us - now_us))
    return sent


def naive_output(sent: list[Sent], now_us: int) -> bool:
    """The valve at an instant, from the whole history, by going through it microsecond by
    microsecond of interest: no slot objects, no clock arithmetic."""
    output, slot, last_us = False, None, None
    passed: object = None
    refused: object = None
    instants = {s.now_us for s in sent} | {s.now_us + s.ahead_us for s in sent}
    instants |= {s.now_us + 100_000 for s in sent}
    for t in sorted(i for i in instants if i <= now_us):
        if slot is not None and slot[1] <= t:
            output, passed, slot = slot[0], slot, None
        if last_us is not None and t >= last_us + 100_000:
            output, slot, last_us = False, None, None
        for s in (s for s in sent if s.now_us == t):
            last_us = t
            if s.action in (ON, OFF):
                output, slot = s.action is ON, None
                continue
            wanted = (s.action is ON_AT, t + s.ahead_us)
            if wanted == slot:
                continue
            slot = None
            if wanted in (passed, refused):
                continue
            if not -2_000 <= s.ahead_us <= 100_000:
                refused = wanted
            elif s.ahead_us <= 0:
                output, passed = wanted[0], wanted
            else:
                slot = wanted
    return output


@settings(deadline=None)
@given(traffic())
def test_the_bank_agrees_with_a_naive_reading_of_the_rules(sent: list[Sent]) -> None:
    bank = ValveBank()
    for entry, following in zip(sent, [*sent[1:], None], strict=True):
        run_to(bank, entry.now_us)
        bank.command(brake(entry.action, entry.now_us + entry.ahead_us), entry.now_us, entry.now_us)
        if following is None or following.now_us > entry.now_us:
            assert bank.energised[Valve.BRAKE] == naive_output(sent, entry.now_us)
    for after_us in (3_000, 50_000, 99_999, 100_000, 150_000):
        run_to(bank, sent[-1].now_us + after_us)
        assert bank.energised[Valve.BRAKE] == naive_output(sent, sent[-1].now_us + after_us)
