"""End-to-end protection: the CRC against the standard, counters and states against rules."""

import copy
from collections import deque
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.dbc.e2e import (
    DEFAULT_LIMITS,
    ChannelState,
    E2ELimits,
    Silence,
    StateMachine,
    Status,
    check_counter,
    check_crc,
    write_crc,
)

CYCLE_US = 10_000
OK, REPEATED, WRONG = Status.OK, Status.REPEATED, Status.WRONG_SEQUENCE
ERROR, SILENT = Status.ERROR, Status.NO_NEW_DATA


def crc_ccitt_false(data: bytes) -> int:
    """CRC-16/CCITT-FALSE bit by bit: polynomial 0x1021, start 0xFFFF, nothing reflected."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def test_profile_5_gives_the_example_of_the_standard() -> None:
    data = bytearray(8)
    write_crc(data, 0x1234, increment_counter=False)
    assert data.hex(" ") == "1c ca 00 00 00 00 00 00"
    write_crc(data, 0x1234)
    assert data.hex(" ") == "cf 8d 01 00 00 00 00 00"


@given(st.binary(min_size=3, max_size=64), st.integers(0, 0xFFFF))
def test_the_header_is_as_the_dbc_describes_it(payload: bytes, data_id: int) -> None:
    data = bytearray(payload)
    write_crc(data, data_id, increment_counter=False)
    assert data[2:] == payload[2:]
    expected = crc_ccitt_false(payload[2:] + data_id.to_bytes(2, "little"))
    assert int.from_bytes(data[:2], "little") == expected
    assert check_crc(bytes(data), data_id)


@given(st.binary(min_size=3, max_size=64), st.sets(st.integers(0, 0xFFFF), min_size=2, max_size=2))
def test_a_frame_of_another_data_id_is_refused(payload: bytes, data_ids: set[int]) -> None:
    sent, expected = data_ids
    data = bytearray(payload)
    write_crc(data, sent, increment_counter=False)
    assert not check_crc(bytes(data), expected)


@pytest.mark.parametrize("first", [0, 1, 137, 255])
def test_a_counter_may_begin_anywhere(first: int) -> None:
    assert check_counter(None, first, 2) is OK


@pytest.mark.parametrize("last", [0, 100, 254, 255])
def test_one_lost_frame_is_tolerated_and_two_are_not(last: int) -> None:
    verdicts = [check_counter(last, (last + step) % 256, 2) for step in range(256)]
    assert verdicts == [REPEATED, OK, OK, *[WRONG] * 253]


def feed(statuses: list[Status], limits: E2ELimits = DEFAULT_LIMITS) -> StateMachine:
    machine = StateMachine(limits)
    for status in statuses:
        machine.update(status)
    return machine


@pytest.mark.parametrize(
    ("statuses", "state"),
    [
        ([], ChannelState.NO_DATA),
        ([ERROR, ERROR, ERROR, ERROR], ChannelState.NO_DATA),
        ([SILENT], ChannelState.NO_DATA),
        ([OK], ChannelState.INIT),
        ([OK, OK], ChannelState.INIT),
        ([OK, OK, OK], ChannelState.VALID),
        ([OK, WRONG, OK, WRONG, OK], ChannelState.VALID),
        ([OK, WRONG, WRONG, WRONG], ChannelState.INVALID),
        ([OK, OK, SILENT, OK], ChannelState.INIT),
        ([OK, OK, SILENT, OK, OK, OK], ChannelState.VALID),
    ],
)
def test_a_channel_becomes_valid_after_three_good_frames(
    statuses: list[Status], state: ChannelState
) -> None:
    assert feed(statuses).state is state


@pytest.mark.parametrize(
    ("limits", "statuses", "state"),
    [
        (E2ELimits(min_ok_to_enter=1), [OK], ChannelState.VALID),
        (E2ELimits(max_errors=0), [WRONG], ChannelState.INVALID),
        (E2ELimits(window=4, max_errors=4), [OK] * 3 + [WRONG] * 3, ChannelState.VALID),
        (E2ELimits(window=4, max_errors=4), [OK] * 3 + [WRONG] * 4, ChannelState.INVALID),
        (E2ELimits(window=4, max_errors=4, min_ok_to_stay=2), [OK, OK, OK, WRONG, WRONG], 2),
        (E2ELimits(window=4, max_errors=4, min_ok_to_stay=2), [OK, OK, OK, *[WRONG] * 3], 3),
    ],
)
def test_the_limits_of_the_standard_can_be_set(
    limits: E2ELimits, statuses: list[Status], state: ChannelState
) -> None:
    assert feed(statuses, limits).state == state


@pytest.mark.parametrize("error", [ERROR, REPEATED, WRONG])
def test_a_channel_is_lost_at_the_third_error_in_ten(error: Status) -> None:
    good = [OK] * 10
    assert feed([*good, error, error]).state is ChannelState.VALID
    assert feed([*good, error, error, error]).state is ChannelState.INVALID
    assert feed([*good, error, OK, OK, OK, error, OK, OK, OK, OK, error]).state is (
        ChannelState.INVALID
    )
    # Ten frames later the first error has left the window.
    assert feed([*good, error, OK, OK, OK, error, OK, OK, OK, OK, OK, error]).state is (
        ChannelState.VALID
    )


def test_silence_ends_validity_at_once_and_three_good_frames_restore_it() -> None:
    lost = [*[OK] * 20, SILENT]
    assert feed(lost).state is ChannelState.INVALID
    assert feed([*lost, WRONG, OK, OK]).state is ChannelState.INVALID
    assert feed([*lost, WRONG, OK, OK, OK]).state is ChannelState.VALID


def naive_state(statuses: list[Status]) -> ChannelState:
    """The rules once more, on a list of the last statuses, as the standard reports them."""
    state = ChannelState.NO_DATA
    window: deque[Status] = deque(maxlen=10)
    for status in statuses:
        if status is SILENT:
            window.clear()
            if state is ChannelState.VALID:
                state = ChannelState.INVALID
            continue
        if state is ChannelState.NO_DATA:
            if status is ERROR:
                continue
            state = ChannelState.INIT
        window.append(status)
        oks = window.count(OK)
        errors = len(window) - oks
        if state is ChannelState.VALID:
            state = ChannelState.VALID if oks >= 1 and errors <= 2 else ChannelState.INVALID
            if state is ChannelState.INVALID:
                window.clear()
        elif oks >= 3 and errors <= 2:
            state = ChannelState.VALID
        elif state is ChannelState.INIT and errors > 2:
            state = ChannelState.INVALID
            window.clear()
    return state


@settings(max_examples=150)
@given(st.lists(st.sampled_from([OK, OK, OK, OK, REPEATED, WRONG, ERROR, SILENT]), max_size=60))
def test_the_machine_follows_the_rules(statuses: list[Status]) -> None:
    assert feed(statuses).state is naive_state(statuses)


steps_us = st.lists(st.integers(1, CYCLE_US), min_size=1, max_size=60)


@given(steps_us, st.integers(0, 40))
def test_a_step_never_trusts_a_frame_five_cycles_old(gaps_us: list[int], last: int) -> None:
    """Frames arrive at any moment between two steps; after the step `last` none comes any more."""
    silence = Silence(CYCLE_US)
    times_us = [sum(gaps_us[:count]) for count in range(len(gaps_us) + 1)]
    arrived_us: tuple[int, int] | None = None  # the earliest and latest the last frame came
    silence.tick(0, 0)
    for number, (previous_us, now_us) in enumerate(pairwise(times_us)):
        if number <= last:
            silence.is_heard = True
            arrived_us = previous_us, now_us
        is_silent = silence.tick(now_us, previous_us)
        assert arrived_us is not None
        earliest_us, latest_us = arrived_us
        if now_us - earliest_us >= 5 * CYCLE_US:
            assert is_silent
        if now_us - latest_us < 4 * CYCLE_US:
            assert not is_silent


def test_a_stalled_step_that_finds_fresh_frames_is_no_silence() -> None:
    silence = Silence(CYCLE_US)
    silence.is_heard = True
    assert not silence.tick(0, 0)
    silence.is_heard = True
    assert not silence.tick(80_000, 0)
    assert not silence.tick(90_000, 80_000)
    assert silence.tick(120_000, 90_000)


def test_a_channel_that_was_never_heard_is_not_silent_but_without_data() -> None:
    assert not Silence(CYCLE_US).tick(10**9, 0)


def test_a_machine_says_what_its_newest_frame_was_and_is_steady_only_while_valid_and_full() -> None:
    machine = StateMachine()
    assert machine.status is Status.NOT_AVAILABLE
    assert not machine.is_steady
    for k in range(10):
        machine.update(OK)
        assert machine.status is OK
        assert machine.is_steady is (k == 9)
    machine.update(REPEATED)
    assert machine.status is REPEATED
    assert not machine.is_steady


def test_what_a_channel_remembers_is_copied_with_it() -> None:
    machine, silence = StateMachine(), Silence(CYCLE_US)
    for _ in range(5):
        machine.update(OK)
    silence.is_heard = True
    silence.tick(CYCLE_US, 0)
    other, quiet = copy.deepcopy(machine), copy.deepcopy(silence)
    assert (other.state, other.status) == (ChannelState.VALID, OK)
    assert quiet.was_heard
    for _ in range(3):
        other.update(ERROR)
    assert (other.state, machine.state) == (ChannelState.INVALID, ChannelState.VALID)
    assert quiet.tick(5 * CYCLE_US, 0)
    assert not silence.tick(4 * CYCLE_US, 0)


def test_the_limits_that_all_channels_are_judged_by() -> None:
    """Of ten frames two may be wrong, three good ones make a channel valid, one keeps it so; one
    frame may be lost between two; five cycles of silence end it."""
    assert E2ELimits(
        window=10, min_ok_to_enter=3, min_ok_to_stay=1, max_errors=2, max_delta_counter=2,
        max_silent_cycles=5,
    ) == DEFAULT_LIMITS  # fmt: skip
