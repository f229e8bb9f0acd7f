"""What the guard makes of what it hears, exactly at its limits: clutch, engine, age, and a gear
that is in mesh although the sensors show neutral."""

from __future__ import annotations

import math
from typing import Any

import pytest
from guard_cases import LIMITS, SHEET
from test_guard_ear import DATA_IDS, frame, j1939, write_crc

from meshpoint.controller.guard.limits import MainValve
from meshpoint.controller.guard.listening import (
    LAYSHAFT_EDGES,
    MAIN_EDGES,
    SENSORS,
    SLEEVES_AUX,
    SLEEVES_MAIN,
    VALVE_STATUS,
)
from meshpoint.controller.guard.own_speed import ShaftSpeed, TeethCounted
from meshpoint.controller.guard.view import GuardInputs, GuardView
from meshpoint.dbc.frame import Frame

CYCLE_US = 10_000
SLOW = (SENSORS, SLEEVES_MAIN, SLEEVES_AUX, VALVE_STATUS)
TURNING = 11.0
"""A layshaft fast enough to tell gears apart (rad/s)."""


def view() -> GuardView:
    return GuardView(SHEET, LIMITS)


def turning(can_id: int, counter: int, stamp: int, took_us: list[int]) -> Frame:
    """Edges of a wheel, the newest at the stamp, and how long each tooth took, newest first."""
    times = [stamp - sum(took_us[:k]) for k in range(len(took_us) + 1)]
    words = {7: 5 * counter} | {10 + 2 * k: time_us for k, time_us in enumerate(times)}
    data = bytearray(frame(can_id, counter, stamp, words).data)
    data[9] = len(times)
    write_crc(data, DATA_IDS[can_id], increment_counter=False)
    return Frame(can_id, bytes(data), is_fd=True)


def test_nothing_is_known_before_all_has_been_heard() -> None:
    seen = view().take([j1939(0x0CF00400, b3=0, b4=16), j1939(0x0C0103F9, b2=133)], 7, 0)
    none = (None, None, None, None)
    assert seen == GuardInputs(
        0, (0.0,) * 4, 1.0, 0.0, 0.0, none, 0, False, pytest.approx(512.0 * math.pi / 30.0), 8
    )
    guard_view = view()
    seen = guard_view.take([frame(each, 0, 5_000) for each in SLOW[:3]], 9_000, 0)
    assert (seen.now_us, seen.valid, seen.clutch_closed) == (5_000, False, 1.0)


def test_each_value_is_in_its_place() -> None:
    guard_view = view()
    for counter in range(3):
        stamp = 100_000 + CYCLE_US * counter
        frames = [
            frame(SENSORS, counter, stamp - 300, {7: 5_000, 9: 45_000, 13: 2_500 + 100 * counter}),
            frame(SLEEVES_MAIN, counter, stamp - 200, {8: 100, 14: 70, 28: 200, 34: 230}),
            frame(SLEEVES_AUX, counter, stamp - 100, {8: 300, 28: 400}),
            frame(VALVE_STATUS, counter, stamp),
        ]
        seen = guard_view.take(frames, 500_000 + CYCLE_US * counter, stamp + 77)
    assert seen.now_us == stamp
    assert seen.positions_m == pytest.approx((100e-6, 200e-6, 300e-6, 400e-6))
    assert (seen.brake_pa, seen.supply_pa) == pytest.approx((1e5, 9e5))
    assert seen.clutch_closed == pytest.approx(0.27)
    assert seen.clutch_per_s == pytest.approx(1.0)  # a hundredth in a cycle
    assert (seen.positions_us, seen.clutch_us) == (stamp - 200, stamp - 300)
    assert seen.speeds_m_s == pytest.approx((0.01, -0.01))
    assert seen.clock_error_us == 77
    assert seen.valid


def clutch_per_s(*samples: tuple[int, float]) -> float:
    """How fast the clutch closes, after frames with its position at these times."""
    guard_view = view()
    for counter, (stamp, closed) in enumerate(samples):
        at = {13: round(closed * 10_000)}
        frames = [frame(each, counter, stamp, at if each == SENSORS else {}) for each in SLOW]
        seen = guard_view.take(frames, 500_000 + CYCLE_US * counter, 0)
    return seen.clutch_per_s


@pytest.mark.parametrize(
    ("apart_us", "per_s"), [(25_000, 4.0), (25_001, 0.0), (0, 0.0), (1, 1e5), (-10_000, 0.0)]
)
def test_the_clutch_speed_is_taken_from_samples_near_each_other(
    apart_us: int, per_s: float
) -> None:
    assert clutch_per_s((50_000, 0.5)) == 0.0
    assert clutch_per_s((50_000, 0.5), (50_000 + apart_us, 0.6)) == pytest.approx(per_s)


def test_a_clutch_that_was_not_heard_for_long_has_no_speed() -> None:
    assert clutch_per_s((5_000, 0.5), (15_000, 0.6), (40_001, 0.7)) == 0.0


def test_the_clock_goes_by_the_frame_that_came_least_late() -> None:
    """Of frames 5 ms late it does not become slower, and in a step without frames it goes on; what
    the next one is less late, coming 3 ms earlier than the first, is reported."""
    guard_view, found = view(), []
    for step, late_us in enumerate((0, 5_000, None, -3_000, 0)):
        sent_us = 100_000 + CYCLE_US * step - (late_us or 0)
        frames = [] if late_us is None else [frame(each, step, sent_us) for each in SLOW]
        seen = guard_view.take(frames, 500_000 + CYCLE_US * step, 0)
        found.append((seen.now_us, seen.clock_gained_us))
        assert seen.has_heard is bool(frames)
    assert found == [(100_000, 0), (110_000, 0), (120_000, 0), (133_000, 8_000), (143_000, 0)]


def test_frames_that_catch_up_from_far_behind_tell_so_before_the_clock_gains() -> None:
    """Each is 10 ms less late than the one before; the clock knows that frames can come sooner."""
    guard_view, counter, found = view(), 0, []
    for step, late_us in enumerate((0, *(None,) * 6, 60_000, 50_000, None, 40_000, 40_000)):
        sent_us = 100_000 + CYCLE_US * step - (late_us or 0)
        frames = [] if late_us is None else [frame(each, counter, sent_us) for each in SLOW]
        counter += bool(frames)
        found.append(guard_view.take(frames, 500_000 + CYCLE_US * step, 0).clock_gained_us)
    assert found == [0] * 8 + [10_000, 0, 10_000, 0]


def test_of_messages_that_catch_up_the_one_that_gains_most_tells() -> None:
    """One is 3 ms less late than the last of its kind, the others are as late as before."""
    guard_view, late = view(), (60_000,) * len(SLOW)
    heard = ((0, (0,) * len(SLOW)), (7, late), (8, (57_000, *late[1:])))
    for counter, (step, lates) in enumerate(heard):
        frames = [
            frame(each, counter, 300_000 + CYCLE_US * step - late_us)
            for each, late_us in zip(SLOW, lates, strict=True)
        ]
        seen = guard_view.take(frames, 500_000 + CYCLE_US * step, 0)
    assert seen.clock_gained_us == 3_000


def test_messages_that_come_in_turn_are_each_as_late_as_the_last_of_their_kind() -> None:
    """With a tick of 5 ms, half of them in every second step: their stamps are 4 ms apart."""
    guard_view, found = view(), []
    for step in range(12):
        sent_us = 100_000 + 5_000 * step - (4_000 if step % 2 else 0)
        kinds = SLOW[:2] if step % 2 else SLOW[2:]
        frames = [frame(each, step // 2, sent_us) for each in kinds]
        found.append(guard_view.take(frames, 500_000 + 5_000 * step, 0).clock_gained_us)
    assert found == [0] * 12


def test_a_step_that_hears_two_reads_is_as_late_as_the_newer() -> None:
    guard_view, counter, found = view(), 0, []
    for step, reads in enumerate(((0,), (), (1, 2), (3,))):
        frames = []
        for read in reads:
            frames += [frame(each, counter, 100_000 + CYCLE_US * read) for each in SLOW]
            counter += 1
        found.append(guard_view.take(frames, 500_000 + CYCLE_US * step, 0).clock_gained_us)
    assert found == [0, 0, 0, 0]


@pytest.mark.parametrize("begun_us", [100_000, (1 << 30) - 70_000, (1 << 32) - 100_000])
def test_after_a_hang_frames_come_message_by_message_and_the_clock_stays(begun_us: int) -> None:
    """None of them is younger than 90 ms: the least delay of before holds."""
    guard_view = view()
    for step in range(16):
        sent_us = (begun_us + CYCLE_US * step) % (1 << 32)
        if step < 5:
            frames = [frame(each, step, sent_us) for each in SLOW]
            guard_view.take(frames, 500_000 + CYCLE_US * step, 0)
    waited = [
        frame(each, step, (begun_us + CYCLE_US * step) % (1 << 32))
        for each in SLOW
        for step in range(5, 16)
    ]
    seen = guard_view.take(waited, 740_000, 0)
    assert (seen.now_us, seen.clock_is_new) == (begun_us + 240_000, False)


def test_where_the_sensors_start_anew_nothing_of_before_comes_back() -> None:
    """Their new clock passes the times of the old one; the first edges on it are of no use: one
    tooth is far longer than the next. Pressures are heard a step later, and tell of it again."""
    guard_view, found = view(), []
    for step in range(20):
        stamp = 100_000 + CYCLE_US * (step % 10)
        took_us = [2_000] * 20 if step < 10 else [2_000, 500]
        edges = [turning(each, step, stamp, took_us) for each in (LAYSHAFT_EDGES, MAIN_EDGES)]
        closed = {13: 5_000 - 100 * step}
        slow = [frame(each, step, stamp, closed if each == SENSORS else {}) for each in SLOW]
        seen = guard_view.take([*slow[step == 10 :], *edges], 500_000 + CYCLE_US * step, 0)
        found.append((seen.speeds[2] is not None, seen.clock_is_new, seen.clutch_per_s != 0.0))
        assert len(guard_view._turns) <= step % 10 + 1
    assert found == [
        (step in range(2, 10), step in (10, 11), step not in (0, 10, 11)) for step in range(20)
    ]


@pytest.mark.parametrize(("later_us", "is_known"), [(40_000, True), (40_001, False)])
def test_the_engine_is_believed_for_40_ms(later_us: int, is_known: bool) -> None:
    guard_view = view()
    engine = j1939(0x0CF00400, b3=0, b4=16, b2=165)
    guard_view.take([engine, *(frame(each, 0, 5_000) for each in SLOW)], 3_000, 0)
    seen = guard_view.take([], 3_000 + later_us, 0)
    assert (seen.engine_rad_s is not None) is is_known
    assert seen.engine_torque_share == (pytest.approx(0.4) if is_known else None)


def turns(
    guard_view: GuardView, now_us: int, positions: Any, layshaft: TeethCounted | None,
    main: TeethCounted | None, rad_s: tuple[float | None, float | None] = (TURNING, TURNING),
) -> int:  # fmt: skip
    """The valve whose gear turns with its sleeve, after both wheels have counted so far."""
    for can_id, counted in ((LAYSHAFT_EDGES, layshaft), (MAIN_EDGES, main)):
        guard_view._shafts[can_id].counted = counted
    a, b = (None if each is None else ShaftSpeed(now_us, each) for each in rad_s)
    return guard_view._agreeing(positions, a, b, now_us)


def of_teeth(layshaft: int, main: int, valves: dict[int, MainValve]) -> GuardView:
    """A view of wheels with so many teeth, and of these gears alone."""
    guard_view = view()
    guard_view._teeth, guard_view._main = (layshaft, main), valves
    return guard_view


def agreeing(
    slip_teeth: int = 0, teeth: int = 400, until_us: int = 2 * 100_000, begun_us: int = 5_000_000,
    positions: Any = (0.0, 0.0), rad_s: tuple[float | None, float | None] = (TURNING, TURNING),
    late: bool = False, slipped_us: int = 0, main_late_us: int = 0,
) -> int:  # fmt: skip
    """Layshaft and main shaft of one ratio turn, a tooth a cycle; over each tenth of a second the
    main shaft is this many teeth behind, or over the second tenth alone; before that, while it
    slipped, one more in each cycle. Its newest edge may be older than the layshaft's."""
    guard_view = of_teeth(teeth, teeth, {5: MainValve(1, -1, 3.0), 4: MainValve(0, 1, 1.0)})
    found = -1
    for now_us in range(begun_us, begun_us + until_us + 1, CYCLE_US):
        came_us = now_us - begun_us
        halves = came_us // 100_000 - (1 if late else 0)
        behind = slip_teeth * max(0, halves) + min(came_us, slipped_us) // CYCLE_US
        count = came_us // CYCLE_US
        main = TeethCounted(now_us - main_late_us, count - behind)
        found = turns(guard_view, now_us, positions, TeethCounted(now_us, count), main, rad_s)
    return found


def test_a_gear_is_taken_to_be_in_after_two_tenths_of_a_second_of_one_speed() -> None:
    assert agreeing() == 4
    assert agreeing(until_us=190_000) == 0
    assert agreeing(until_us=500_000) == 4


@pytest.mark.parametrize("main_late_us", [0, 12_000])
def test_what_was_more_than_two_tenths_ago_is_forgotten(main_late_us: int) -> None:
    """Tenths by the layshaft's newest edges, whenever the main shaft's came."""
    for until_us, valve in ((490_000, 0), (500_000, 4), (510_000, 4)):
        found = agreeing(
            teeth=100, slipped_us=300_000, until_us=until_us, main_late_us=main_late_us
        )
        assert found == valve
    assert agreeing(until_us=200_000, main_late_us=main_late_us) == 4
    assert agreeing(until_us=190_000, main_late_us=main_late_us) == 0


def test_less_than_nine_degrees_a_second_is_one_speed_in_each_half() -> None:
    """0.15 rad/s: a tooth of 419 in a tenth of a second is less, one of 418 is not."""
    assert 2 * math.pi / 419 * 10 < 0.15 < 2 * math.pi / 418 * 10
    assert agreeing(1, 419) == agreeing(-1, 419) == 4
    assert agreeing(1, 418) == agreeing(-1, 418) == 0
    assert agreeing(1, 418, late=True) == 0
    assert agreeing(1, 419, late=True) == 4
    # In nine hundredths a tooth of 425 would be more: the second half is by the layshaft's edges.
    assert 2 * math.pi / 425 / 0.1 < 0.15 < 2 * math.pi / 425 / 0.09
    assert agreeing(1, 425, late=True, main_late_us=9_000) == 4


@pytest.mark.parametrize("place", [0, 1])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_it_is_asked_where_no_sleeve_is_at_its_teeth(place: int, sign: float) -> None:
    for position_m, valve in ((LIMITS.apart_m, 4), (LIMITS.apart_m + 1e-9, 0)):
        positions = [0.0, 0.0]
        positions[place] = sign * position_m
        assert agreeing(positions=positions) == valve


def test_it_is_asked_while_both_shafts_are_seen_to_turn() -> None:
    assert agreeing(rad_s=(10.0, 1.0)) == 4
    assert agreeing(rad_s=(10.0 - 1e-9, 1.0)) == 0
    assert agreeing(rad_s=(None, TURNING)) == agreeing(rad_s=(TURNING, None)) == 0


def test_it_begins_anew_when_neutral_was_left_or_a_wheel_not_counted() -> None:
    for wheel, positions in ((LAYSHAFT_EDGES, (0.0, 0.0)), (MAIN_EDGES, (0.0, 0.0)),
                             (None, (0.0049, 0.0))):  # fmt: skip
        guard_view = view()
        for cycle in range(30):
            now_us, lost = CYCLE_US * cycle, cycle == 12
            layshaft, main = (
                None if lost and can_id == wheel else TeethCounted(now_us, cycle)
                for can_id in (LAYSHAFT_EDGES, MAIN_EDGES)
            )
            where = positions if lost else (0.0, 0.0)
            assert turns(guard_view, now_us, where, layshaft, main) in (0, 4)[: 2 - lost]
            kept = guard_view._turns
            first_us = kept[0][0].time_us if kept else None
            assert first_us == (0 if cycle < 12 else None if lost else 130_000)


def test_where_no_reading_is_of_the_last_tenth_the_newest_stands_for_it() -> None:
    """A tooth in 60 ms is another speed, in 250 ms it is not."""
    guard_view = of_teeth(400, 400, {4: MainValve(0, 1, 1.0)})
    readings = ((0, 0, 0), (60_000, 6, 5), (140_000, 25, 24))
    for time_us, *teeth in readings:
        counted = (TeethCounted(time_us, each) for each in teeth)
        found = turns(guard_view, max(time_us, 250_000), (0.0, 0.0), *counted)
    assert found == 4


def test_slip_is_worked_out_from_whole_teeth_and_their_times() -> None:
    slip = of_teeth(10, 20, {})._slip
    before = (TeethCounted(0, 5), TeethCounted(1_000, 50))
    after = (TeethCounted(500_000, 15), TeethCounted(251_000, 60))
    # One turn in half a second, half a turn in a quarter: 2 turns a second each.
    assert slip(1.0, before, after) == pytest.approx(0.0, abs=1e-12)
    assert slip(0.5, before, after) == pytest.approx(-2.0 * math.pi)
    least = (TeethCounted(1, 6), TeethCounted(1_001, 50))
    assert slip(1.0, before, least) == pytest.approx(0.2 * math.pi * 1e6)
    assert slip(1.0, before, before) == 0.0  # no time, no teeth
