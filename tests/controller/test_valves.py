"""What goes to the valves: at a moment where the hardware can, at once where it cannot."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.controller.settings.settings import ValveTiming
from meshpoint.controller.settings.valve_name import ValveName, driven_or_pending
from meshpoint.controller.shift.valve_board import OFF, ValveBoard
from meshpoint.dbc.messages import ValveAction, ValveCommand, ValveStatus

T0 = (1 << 32) + 5_000_000
"""A sensor time after one wrap."""


def scheduled() -> ValveBoard:
    return ValveBoard(ValveTiming.SCHEDULED)


def immediate() -> ValveBoard:
    return ValveBoard(ValveTiming.IMMEDIATE)


def test_a_new_board_drives_nothing() -> None:
    for board in (scheduled(), immediate()):
        assert board.message(T0) == ValveCommand()
        assert board.next_switch_us(T0) is None


def test_an_activation_goes_out_with_its_time_in_32_bits_and_is_resent_unchanged() -> None:
    board = scheduled()
    board.schedule(ValveName.MAIN_SECOND, True, T0 + 20_123, T0)
    expected = ValveCommand(
        main_second_action=ValveAction.ON_AT, main_second_time_us=5_000_000 + 20_123
    )
    for now_us in (T0, T0 + 10_000, T0 + 30_000, T0 + 900_000):
        assert board.message(now_us) == expected
    assert not board.driven(ValveName.MAIN_SECOND, T0 + 20_122)
    assert board.driven(ValveName.MAIN_SECOND, T0 + 20_123)
    assert board.next_switch_us(T0) is None


def test_the_newest_activation_replaces_the_one_to_come() -> None:
    board = scheduled()
    board.schedule(ValveName.BRAKE, True, T0 + 20_000, T0)
    board.schedule(ValveName.BRAKE, True, T0 + 25_000, T0 + 10_000)
    assert board.message(T0 + 10_000).brake_time_us == 5_025_000
    assert not board.driven(ValveName.BRAKE, T0 + 24_999)


def test_a_release_that_is_planned_leaves_the_valve_driven_until_then() -> None:
    for board, now_action in ((scheduled(), ValveAction.OFF_AT), (immediate(), ValveAction.ON_NOW)):
        board.schedule(ValveName.BRAKE, True, T0, T0)
        board.schedule(ValveName.BRAKE, False, T0 + 50_000, T0 + 10_000)
        assert board.message(T0 + 20_000).brake_action is now_action
        assert board.driven(ValveName.BRAKE, T0 + 49_999)
        assert not board.driven(ValveName.BRAKE, T0 + 50_000)


def test_of_a_pulse_the_end_goes_out_once_the_beginning_has_passed() -> None:
    """A valve has one slot: the end would replace a beginning that is still to come."""
    board = scheduled()
    board.pulse(ValveName.MAIN_FIRST, T0 + 12_000, T0 + 22_500, T0)
    sent = [board.message(T0 + ms * 1_000) for ms in (0, 11, 12, 20, 30, 1_100)]
    on = (ValveAction.ON_AT, 5_012_000)
    off = (ValveAction.OFF_AT, 5_022_500)
    said = [(message.main_first_action, message.main_first_time_us) for message in sent]
    assert said == [on, on, off, off, (ValveAction.OFF_NOW, 0), (ValveAction.OFF_NOW, 0)]
    driven = [
        board.driven(ValveName.MAIN_FIRST, T0 + us) for us in (11_999, 12_000, 22_499, 22_500)
    ]
    assert driven == [False, True, True, False]
    command = board.command(ValveName.MAIN_FIRST)
    assert [command.rests(T0 + us) for us in (0, 12_000, 22_500)] == [False, False, True]


def test_the_end_of_a_pulse_goes_out_with_its_beginning_in_the_slot_of_the_other_valve() -> None:
    """Two lost frames made a pull so long that the sleeve ran through to the opposite gear."""
    board = scheduled()
    board.pulse(ValveName.SPLIT_HIGH, T0 + 12_000, T0 + 22_500, T0)
    sent = [board.message(T0 + ms * 1_000) for ms in (0, 11, 12, 20)]
    said = [(message.split_low_action, message.split_low_time_us) for message in sent]
    end, off = (ValveAction.OFF_AT, 5_022_500), (ValveAction.OFF_NOW, 0)
    assert said == [end, end, off, off]
    board.off(ValveName.SPLIT_HIGH)
    assert board.message(T0 + 21_000) == ValveCommand()


def test_a_valve_that_goes_off_now_does_so_and_carries_the_others_end_from_then_on() -> None:
    """A sleeve in flight is stopped: its valve would have gone off as the pulse against it ends."""
    board = scheduled()
    board.schedule(ValveName.MAIN_FIRST, True, T0 - 20_000, T0 - 30_000)
    assert board.message(T0 - 10_000).main_first_action is ValveAction.ON_AT
    board.off(ValveName.MAIN_FIRST)
    board.pulse(ValveName.MAIN_SECOND, T0 + 6_000, T0 + 16_000, T0)
    assert board.message(T0).main_first_action is ValveAction.OFF_NOW
    board.pulse(ValveName.MAIN_SECOND, T0 + 6_500, T0 + 16_500, T0)
    assert board.message(T0 + 5_000).main_first_time_us == 5_016_500


def test_the_end_of_a_pulse_does_not_wait_for_the_next_tick() -> None:
    """A pulse that stops a sleeve is shorter than a tick: told on the next one, its end came up to
    a millisecond after its time, and was refused where that tick was late by 1 ms more."""
    board = scheduled()
    board.pulse(ValveName.MAIN_FIRST, T0 + 2_000, T0 + 11_000, T0)
    board.schedule(ValveName.BRAKE, True, T0 + 5_000, T0)
    assert board.next_switch_us(T0) == T0 + 2_000
    assert board.message(T0 + 2_000).main_first_action is ValveAction.OFF_AT
    assert board.next_switch_us(T0 + 2_000) is None


def test_hardware_that_cannot_schedule_is_told_both_ends_of_a_pulse_at_their_moments() -> None:
    board = immediate()
    board.pulse(ValveName.MAIN_FIRST, T0 + 12_000, T0 + 22_500, T0)
    switches = [board.next_switch_us(T0 + us) for us in (0, 12_000, 22_500)]
    assert switches == [T0 + 12_000, T0 + 22_500, None]
    said = [board.message(T0 + us).main_first_action for us in (0, 12_000, 22_499, 22_500)]
    on, off = ValveAction.ON_NOW, ValveAction.OFF_NOW
    assert said == [off, on, on, off]


def test_off_takes_a_command_back_at_once() -> None:
    for board in (scheduled(), immediate()):
        board.schedule(ValveName.BRAKE, True, T0, T0)
        board.schedule(ValveName.MAIN_THIRD, True, T0 + 20_000, T0)
        board.off(ValveName.MAIN_THIRD)
        assert board.message(T0 + 30_000).main_third_action is ValveAction.OFF_NOW
        assert board.driven(ValveName.BRAKE, T0 + 30_000)
        board.all_off()
        assert board.message(T0 + 30_000) == ValveCommand()
        assert board.next_switch_us(T0) is None


def test_a_release_long_past_carries_no_time_that_could_be_taken_for_the_future() -> None:
    """32 bits turn round every 72 minutes: an old time would come true again."""
    board = scheduled()
    board.schedule(ValveName.BRAKE, False, T0, T0)
    assert board.message(T0 + 1_000).brake_action is ValveAction.OFF_AT
    for later_us in (1_001, 2_000_000, 1 << 31, (1 << 32) - 50_000):
        assert board.message(T0 + later_us).brake_action is ValveAction.OFF_NOW


def test_hardware_that_cannot_schedule_is_reported_at_the_moment() -> None:
    board = immediate()
    board.schedule(ValveName.MAIN_FIRST, True, T0 + 20_000, T0)
    board.schedule(ValveName.BRAKE, True, T0 + 7_000, T0)
    assert board.next_switch_us(T0) == T0 + 7_000
    assert board.next_switch_us(T0 + 7_000) == T0 + 20_000
    assert board.next_switch_us(T0 + 20_000) is None
    before, at = board.message(T0 + 19_999), board.message(T0 + 20_000)
    assert before.main_first_action is ValveAction.OFF_NOW
    assert at.main_first_action is ValveAction.ON_NOW
    assert at.main_first_time_us == 0


def test_of_two_offs_each_loses_its_time_by_itself_when_it_has_passed_and_an_on_never() -> None:
    """A valve side that hears of one first by then would refuse it as too late, and leave the
    valve on."""
    board, late_us = scheduled(), 1_000
    board.schedule(ValveName.BRAKE, False, T0, T0)
    board.schedule(ValveName.MAIN_THIRD, False, T0 + 400_000, T0)
    board.schedule(ValveName.MAIN_FIRST, True, T0, T0)
    off_at, off_now = ValveAction.OFF_AT, ValveAction.OFF_NOW
    said = {0: (off_at, off_at), 1: (off_now, off_at), 400_000: (off_now, off_at),
            400_001: (off_now, off_now)}  # fmt: skip
    for after_us, offs in said.items():
        reported = board.message(T0 + late_us + after_us)
        assert (reported.brake_action, reported.main_third_action) == offs
        assert reported.main_first_action is ValveAction.ON_AT


def test_a_valve_that_was_never_on_is_off_without_a_time_from_the_clocks_begin_on() -> None:
    board = scheduled()
    for now_us in (0, 1, 500_000):
        assert board.message(now_us) == ValveCommand()
        assert not any(board.driven(valve, now_us) for valve in ValveName)


def test_a_command_is_what_was_scheduled_and_what_was_before_until_it_is_taken_off() -> None:
    board, third = scheduled(), ValveName.MAIN_THIRD
    board.schedule(third, True, T0 + 5, T0)
    assert board.command(third)[:3] == (T0 + 5, True, False)
    board.schedule(third, False, T0 + 90, T0 + 5)
    assert board.command(third)[:3] == (T0 + 90, False, True)
    board.off(third)
    assert board.command(third) == OFF
    board.schedule(third, True, T0 + 200, T0 + 7)
    assert board.command(third)[:3] == (T0 + 200, True, False), "off is off before, too"


def test_a_valve_is_driven_or_about_to_be_as_the_valve_side_tells_it() -> None:
    """By its coil or its pending activation; of a valve side not heard yet none is."""
    assert driven_or_pending(None) == driven_or_pending(ValveStatus()) == (False,) * len(ValveName)
    for kind in ("_energised", "_pending"):
        names = [name for name in ValveStatus._fields if name.endswith(kind)]
        for name, valve in zip(names, ValveName, strict=True):
            reported = driven_or_pending(ValveStatus()._replace(**{name: True}))
            assert reported == tuple(each is valve for each in ValveName)


COMMANDS = st.lists(
    st.tuples(
        st.sampled_from(list(ValveName)),
        st.booleans(),
        st.integers(0, 80_000),
        st.integers(1, 30_000),
    ),
    max_size=20,
)


@settings(deadline=None, max_examples=60)
@given(commands=COMMANDS)
def test_both_timings_drive_the_same_valves_at_the_same_times(
    commands: list[tuple[ValveName, bool, int, int]],
) -> None:
    """Against the plain meaning: what is commanded for a moment holds from then on, and what was
    still to come is forgotten."""
    boards, now_us = (scheduled(), immediate()), T0
    history: dict[ValveName, list[tuple[int, bool]]] = {valve: [] for valve in ValveName}
    for valve, on, ahead_us, pause_us in commands:
        for board in boards:
            board.schedule(valve, on, now_us + ahead_us, now_us)
        past = [switch for switch in history[valve] if switch[0] <= now_us]
        history[valve] = [*past, (now_us + ahead_us, on)]
        now_us += pause_us
        message = boards[1].message(now_us)
        for each, switches in history.items():
            driven = next((on for t, on in reversed(switches) if t <= now_us), False)
            assert boards[0].driven(each, now_us) is driven
            action = getattr(message, f"{each.name.lower()}_action")
            assert action is (ValveAction.ON_NOW if driven else ValveAction.OFF_NOW)
