"""The board keeps each rule of docs/wire.md for valves and clutch, from frames to outputs."""

from __future__ import annotations

import pytest
from firmware_bench import PAIRS, VALVES, WRAP, CommandBench

from meshpoint.dbc.e2e import write_crc
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.messages import ClutchAction, ValveAction
from meshpoint.firmware.native_board import NativeBoard

CLUTCH_DATA_ID = 0x4D41
ON, OFF, ON_AT, OFF_AT = (
    ValveAction.ON_NOW, ValveAction.OFF_NOW, ValveAction.ON_AT, ValveAction.OFF_AT,
)  # fmt: skip


@pytest.mark.parametrize("valve", VALVES)
def test_a_valve_is_switched_at_once(bench: CommandBench, valve: str) -> None:
    bench.command(**{valve: ON})
    assert bench.driven == {valve}
    bench.command(**{valve: OFF})
    assert bench.driven == set()


@pytest.mark.parametrize("valve", VALVES)
def test_an_activation_waits_and_is_done_at_its_microsecond(
    bench: CommandBench, valve: str
) -> None:
    due_us = bench.now_us + 34_567
    bench.command(**{valve: (ON_AT, due_us)})
    status = bench.read()["ValveStatus"]
    assert getattr(status, f"{valve}_pending") and not getattr(status, f"{valve}_energised")
    bench.wait(34_566)
    assert bench.driven == set()
    bench.wait(1)
    assert bench.driven == {valve}
    status = bench.read()["ValveStatus"]
    assert getattr(status, f"{valve}_energised") and not getattr(status, f"{valve}_pending")


def test_an_activation_beyond_the_wrap_of_the_clock_is_done_in_time(board: NativeBoard) -> None:
    bench = CommandBench(board, sensor_us=WRAP - 3)
    bench.command(brake=(ON_AT, WRAP + 5_000))
    bench.wait(5_002)
    assert bench.driven == set()
    bench.wait(1)
    assert bench.driven == {"brake"}


def test_each_valve_has_one_slot_of_its_own(bench: CommandBench) -> None:
    now_us, own_us = bench.now_us, bench.memory.own_us
    bench.command(brake=(ON_AT, now_us + 30_000), main_first=(ON_AT, now_us + 20_000))
    bench.wait(40_000)
    assert [(at_us - own_us, driven) for at_us, driven in bench.switched()] == [
        (20_000, {"main_first"}), (30_000, {"main_first", "brake"}),
    ]  # fmt: skip


def test_a_new_activation_replaces_the_one_that_waits(bench: CommandBench) -> None:
    now_us = bench.now_us
    bench.command(brake=(ON_AT, now_us + 10_000))
    bench.command(brake=(ON_AT, now_us + 20_000))
    bench.wait(19_999)
    assert bench.driven == set()
    bench.wait(1)
    assert bench.driven == {"brake"}


@pytest.mark.parametrize("action", [ON, OFF])
def test_switching_at_once_forgets_an_activation_that_waits(
    bench: CommandBench, action: ValveAction
) -> None:
    bench.command(brake=(ON_AT if action is OFF else OFF_AT, bench.now_us + 10_000))
    bench.command(brake=action)
    bench.wait(20_000)
    assert bench.driven == ({"brake"} if action is ON else set())


def test_an_activation_that_waits_may_be_sent_again(bench: CommandBench) -> None:
    due_us = bench.now_us + 25_000
    for _ in range(3):
        bench.command(brake=(ON_AT, due_us))
        bench.wait(10_000)
    assert bench.driven == {"brake"}
    assert bench.read()["ValveStatus"].refused_count == 0


def test_one_that_waits_is_still_the_same_when_the_clock_has_jumped_back(
    bench: CommandBench,
) -> None:
    due_us = bench.now_us + 50_000
    bench.command(brake=(ON_AT, due_us))
    bench.memory.sensor_us -= 200_000
    bench.command(brake=(ON_AT, due_us))
    status = bench.read()["ValveStatus"]
    assert (status.brake_pending, status.refused_count) == (True, 0)


def test_one_that_has_passed_holds_and_is_never_armed_again(bench: CommandBench) -> None:
    due_us = bench.now_us + 5_000
    for _ in range(9):
        bench.command(brake=(ON_AT, due_us))
        bench.wait(10_000)
        assert bench.driven == {"brake"}
    bench.command(brake=OFF)
    bench.command(brake=(ON_AT, due_us))
    bench.wait(50_000)
    assert bench.driven == set()
    assert bench.read()["ValveStatus"].refused_count == 0


@pytest.mark.parametrize("sensor_us", [1_000_000, WRAP - 10])
@pytest.mark.parametrize(
    ("ahead_us", "is_taken"),
    [(10 - WRAP // 2, False), (-2_001, False), (-2_000, True), (0, True), (1, True), (99_999, True),
     (100_000, True), (100_001, False), (WRAP // 2 - 1, False)],
)  # fmt: skip
def test_one_too_late_or_too_far_ahead_is_refused_once(
    board: NativeBoard, sensor_us: int, ahead_us: int, is_taken: bool
) -> None:
    bench = CommandBench(board, sensor_us)
    due_us = bench.now_us + ahead_us
    for _ in range(3):
        bench.command(brake=(ON_AT, due_us))
        bench.wait(1)
    assert bench.read()["ValveStatus"].refused_count == (not is_taken)
    for _ in range(11):
        bench.command(brake=(ON_AT, due_us))
        bench.wait(10_000)
    assert bench.driven == ({"brake"} if is_taken else set())


def test_a_refusal_empties_the_slot_and_leaves_the_valve(bench: CommandBench) -> None:
    now_us = bench.now_us
    bench.command(brake=ON, main_first=(ON_AT, now_us + 50_000))
    bench.command(brake=(OFF_AT, now_us + 150_001), main_first=(ON_AT, now_us + 150_001))
    bench.wait(90_000)
    assert bench.driven == {"brake"}
    status = bench.read()["ValveStatus"]
    assert (status.refused_count, status.main_first_pending) == (2, False)


def test_a_release_is_taken_up_to_2_ms_late(bench: CommandBench) -> None:
    bench.command(main_second=ON)
    bench.command(main_second=(OFF_AT, bench.now_us - 2_000))
    assert bench.driven == set()


def test_everything_is_off_100_ms_after_the_last_valid_frame(bench: CommandBench) -> None:
    now_us = bench.now_us
    bench.command(
        brake=ON, main_first=(ON_AT, now_us + 99_999), main_crawl=(ON_AT, now_us + 100_000)
    )
    bench.wait(99_999)
    assert bench.driven == {"brake", "main_first"}
    bench.wait(1)
    assert bench.driven == set()
    status = bench.read()["ValveStatus"]
    assert (status.expired_count, status.main_crawl_pending) == (1, False)
    bench.wait(1_000_000)
    assert bench.driven == set()
    assert bench.read()["ValveStatus"].expired_count == 1


def test_a_command_renews_the_100_ms(bench: CommandBench) -> None:
    for _ in range(5):
        bench.command(brake=ON)
        bench.wait(45_000)
    assert bench.driven == {"brake"}


@pytest.mark.parametrize("step_us", [-WRAP // 2, -1_000_000, -99_999, 99_999, 1_000_000])
def test_a_step_of_the_sensor_clock_keeps_no_valve_on(bench: CommandBench, step_us: int) -> None:
    bench.command(brake=ON)
    bench.memory.sensor_us = (bench.now_us + step_us) % WRAP
    bench.wait(99_999)
    assert bench.driven == {"brake"}
    bench.wait(1)
    assert bench.driven == set()


def test_the_boards_own_timer_may_wrap(bench: CommandBench) -> None:
    bench.memory.own_us = WRAP - 50_000
    bench.memory.watchdog_us = WRAP - 49_000
    bench.memory.poll_us = WRAP - 50_000
    bench.be_heard()
    bench.command(brake=ON)
    bench.wait(99_999)
    assert bench.driven == {"brake"}
    bench.wait(1)
    assert bench.driven == set()
    assert bench.memory.resets == 0


def damaged(frame: Frame) -> Frame:
    return frame._replace(data=frame.data[:-1] + bytes([frame.data[-1] ^ 1]))


@pytest.mark.parametrize(
    "spoil",
    [
        damaged,
        lambda frame: frame._replace(data=frame.data[:-1]),
        lambda frame: frame._replace(data=frame.data + bytes(4)),
        lambda frame: frame._replace(is_fd=False),
        lambda frame: frame._replace(is_extended=False),
        lambda frame: frame._replace(can_id=frame.can_id + 1),
    ],
    ids=["CRC", "short", "long", "classic", "11 bits", "another identifier"],
)
def test_a_frame_that_is_not_valid_does_nothing_and_renews_nothing(
    bench: CommandBench, spoil: object
) -> None:
    bench.command(brake=ON)
    bench.wait(40_000)
    bench.board.receive(spoil(bench.valve_frame(main_first=ON)))  # type: ignore[operator]
    assert bench.driven == {"brake"}
    bench.wait(60_000)
    assert bench.driven == set()


def test_a_repeated_counter_renews_nothing(bench: CommandBench) -> None:
    frame = bench.valve_frame(brake=ON)
    bench.board.receive(frame)
    bench.wait(40_000)
    bench.board.receive(frame)
    bench.wait(60_000)
    assert bench.driven == set()


def test_one_lost_frame_is_none_and_two_are_a_wrong_counter(bench: CommandBench) -> None:
    bench.valve_frame()
    bench.command(brake=ON)
    assert bench.driven == {"brake"}
    bench.valve_frame()
    bench.valve_frame()
    bench.command(main_first=ON)
    assert bench.driven == {"brake"}


def test_a_board_obeys_nobody_before_three_good_frames(board: NativeBoard) -> None:
    bench = CommandBench(board)
    bench.wait(60_000)  # silence, of which it takes note
    bench.command(brake=ON)
    bench.command(brake=ON)
    assert bench.driven == set()
    bench.command(brake=ON)
    assert bench.driven == {"brake"}


@pytest.mark.parametrize(("low", "high"), PAIRS)
def test_the_two_valves_of_a_sleeve_are_never_on_together(
    bench: CommandBench, low: str, high: str
) -> None:
    for there, back in ((low, high), (high, low)):
        bench.command(**{there: ON})
        bench.command(**{there: ON, back: ON, "brake": ON})
        assert bench.driven == {"brake"}
        bench.command(**{there: ON})
        now_us = bench.now_us
        bench.command(**{there: (OFF_AT, now_us + 10), back: (ON_AT, now_us + 10)})
        bench.wait(10)
        assert bench.driven == {back}
    assert [driven for _, driven in bench.switched()][-2:] == [set(), {low}]
    assert bench.memory.coils_together == 0


@pytest.mark.parametrize(("low", "high"), PAIRS)
def test_a_release_of_the_other_valve_of_its_sleeve_ends_a_pulse(
    bench: CommandBench, low: str, high: str
) -> None:
    for pushes, other in ((low, high), (high, low)):
        now_us, own_us = bench.now_us, bench.memory.own_us
        bench.command(**{pushes: (ON_AT, now_us + 9_000), other: (OFF_AT, now_us + 23_000)})
        bench.wait(40_000)
        assert [(at_us - own_us, driven) for at_us, driven in bench.switched()][-2:] == [
            (9_000, {pushes}), (23_000, set()),
        ]  # fmt: skip


def test_the_output_stage_by_itself_drives_nine_valves_and_of_a_sleeve_one(
    bench: CommandBench,
) -> None:
    for wanted, driven in ((0xFFFF, 0x001), (0x1FE, 0), (0x0AB, 0x0AB), (0xFE00, 0)):
        bench.board.code.outputs_drive(wanted)
        assert bench.memory.driven == driven


def test_valves_of_two_sleeves_may_be_on_together(bench: CommandBench) -> None:
    both = {"brake": ON, "split_high": ON, "main_first": ON, "main_third": ON, "range_low": ON}
    bench.command(**both)
    assert bench.driven == set(both)


def test_all_is_off_while_the_bus_is_off_and_until_three_good_frames(bench: CommandBench) -> None:
    bench.command(brake=ON, main_first=(ON_AT, bench.now_us + 50_000))
    bench.memory.is_bus_off = True
    bench.wait(1_000)
    assert bench.driven == set()
    bench.memory.is_bus_off = False
    bench.wait(60_000)
    bench.command(brake=ON)
    assert bench.driven == set()
    bench.command(brake=ON)
    bench.command(brake=ON)
    assert bench.driven == {"brake"}


def test_a_fault_of_the_processor_switches_everything_off(bench: CommandBench) -> None:
    bench.command(brake=ON, main_first=(ON_AT, bench.now_us + 50_000))
    bench.board.code.board_on_fault()
    assert bench.driven == set()
    bench.wait(60_000)
    assert bench.driven == set()


@pytest.mark.parametrize("what", ["is_stuck", "is_deaf"])
def test_a_board_that_hangs_is_reset_by_its_watchdog(bench: CommandBench, what: str) -> None:
    bench.command(brake=ON)
    setattr(bench.memory, what, True)
    bench.memory.is_stuck = True
    bench.wait(2_000)
    assert (bench.driven, bench.memory.resets) == (set(), 1)
    bench.be_heard()
    bench.command(brake=ON)
    assert bench.driven == {"brake"}


def test_a_compare_that_is_missed_is_made_up_by_the_main_loop(bench: CommandBench) -> None:
    bench.command(brake=(ON_AT, bench.now_us + 20_000))
    bench.memory.is_deaf = True
    bench.wait(21_000)
    assert bench.driven == {"brake"}
    bench.wait(79_999)
    assert bench.driven == set()


def test_the_clutch_does_as_it_is_told_and_opens_100_ms_after_the_last_command(
    bench: CommandBench,
) -> None:
    for _ in range(3):
        assert not bench.memory.is_clutch_closed
        bench.board.receive(bench.clutch_frame(ClutchAction.CLOSE))
    assert bench.memory.is_clutch_closed
    for _ in range(4):
        bench.command()
        bench.wait(24_999)
    bench.wait(3)
    assert bench.memory.is_clutch_closed
    bench.wait(1)
    assert not bench.memory.is_clutch_closed


def test_the_clutch_opens_on_command(bench: CommandBench) -> None:
    for action in (*[ClutchAction.CLOSE] * 3, ClutchAction.OPEN):
        bench.board.receive(bench.clutch_frame(action))
    assert not bench.memory.is_clutch_closed


def test_a_clutch_action_that_is_none_is_an_error(bench: CommandBench) -> None:
    for _ in range(3):
        bench.board.receive(bench.clutch_frame(ClutchAction.CLOSE))
    frame = bench.clutch_frame(ClutchAction.CLOSE)
    bench.wait(40_000)
    data = bytearray(frame.data)
    data[3] = 2
    write_crc(data, CLUTCH_DATA_ID, increment_counter=False)
    bench.board.receive(frame._replace(data=bytes(data)))
    bench.wait(59_999)
    assert bench.memory.is_clutch_closed
    bench.wait(1)
    assert not bench.memory.is_clutch_closed
