"""From edge frames to teeth: every edge once, with its number and its exact time."""

from __future__ import annotations

from bisect import bisect_right
from itertools import accumulate, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wheel import READ_US, STAMPS, Wheel

from meshpoint.controller.measure.clock import SensorClockEstimate
from meshpoint.controller.measure.inputs import FIRST_WRONG
from meshpoint.controller.measure.wheel_edges import Polarity, WheelEdges
from meshpoint.dbc.sensor_time import wrap

TEETH = 45
DUTY = 0.4
SENSOR_AHEAD_US = 7_000_000
"""The two clocks have nothing to do with each other."""
# Near both wraps, so that most runs cross one.
STARTS_US = st.one_of(st.integers(0, 10**6), st.integers((1 << 32) - 300_000, (1 << 32) - 1))
FIRST_TEETH = st.one_of(st.integers(1, 100), st.integers(65_400, 65_535))


@st.composite
def wheels(
    draw: st.DrawFn, least_us: int = 600, most_us: int = 4000, least_edges: int = 60
) -> Wheel:
    """A wheel of 330 to 2,200 rpm at 45 teeth, its speed changing by up to 1 % a tooth and each
    tooth up to 2 % of a pitch out of place."""
    count = draw(st.integers(least_edges, 250))
    pitch_us, growth = draw(st.integers(least_us, most_us)), draw(st.floats(-0.01, 0.01))
    off = draw(st.lists(st.floats(-0.02, 0.02), min_size=7, max_size=7))
    start_us, first = draw(STARTS_US), draw(FIRST_TEETH)
    even = [min(max(pitch_us * (1.0 + growth) ** k, least_us), most_us) for k in range(count)]
    rise = [
        start_us + 100 + round(t + off[k % 7] * pitch_us)
        for k, t in enumerate(accumulate(even, initial=0.0))
    ]
    fall = [t + round(DUTY * (after - t)) for t, after in pairwise(rise)]
    return Wheel(first, rise, fall, draw(st.integers(0, 1)))


def reads(wheel: Wheel) -> list[int]:
    """Read times from the first edges to after the last one."""
    return list(range(wheel.rise_us[0] + 3_000, wheel.rise_us[-1] + READ_US, READ_US))


def keep_enough(wheel: Wheel, wanted: list[bool]) -> list[int]:
    """The reads whose frames arrive: those wanted, and enough never to lose 27 edges."""
    kept, last = [], None
    for read_us, want in zip(reads(wheel), wanted * 100, strict=False):
        end = bisect_right(wheel.rise_us, read_us + READ_US)
        following = end - bisect_right(wheel.rise_us, last or 0)
        if want or last is None or following >= STAMPS:
            kept.append(read_us)
            last = read_us
    return kept


def run(
    wheel: Wheel, rises: list[int], falls: list[int]
) -> tuple[WheelEdges, list[tuple[int, float]]]:
    """All edges a controller gets when the frames of these reads arrive, as (time, pitches).

    The controller's time begins within the first 2^32 us; the wheel's own may have wrapped."""
    edges, clock, got = WheelEdges(TEETH, DUTY), SensorClockEstimate(), []
    all_reads = sorted({*rises, *falls})
    wrapped_us = all_reads[0] - wrap(all_reads[0])
    for read_us in all_reads:
        risen = [wheel.rise(read_us)] if read_us in rises else []
        fallen = [wheel.fall(read_us)] if read_us in falls else []
        batch = edges.read(risen, fallen, clock, read_us - SENSOR_AHEAD_US + 2_000)
        got += zip(batch.time_us.astype(int).tolist(), batch.theta_rad.tolist(), strict=True)
        nominal = (batch.tooth + DUTY * batch.falling) * edges.pitch_rad
        assert np.allclose(batch.theta_rad, nominal, rtol=1e-12)
    return edges, [(t + wrapped_us, theta / edges.pitch_rad) for t, theta in got]


@settings(deadline=None, max_examples=25)
@given(wheel=wheels(), wanted=st.lists(st.booleans(), min_size=5, max_size=20))
def test_every_edge_comes_once_with_its_time_and_angle(wheel: Wheel, wanted: list[bool]) -> None:
    """Through lost frames, the 32-bit wrap of time and the 16-bit wrap of the number."""
    kept = keep_enough(wheel, wanted)
    edges, got = run(wheel, kept, kept)
    truth = wheel.angle_of(DUTY)
    times = [t for t, _ in got]
    expected = sorted(t for t in truth if times and times[0] <= t <= kept[-1])
    # The newest edge may wait: whether it is extra shows behind it.
    assert times in (expected, expected[:-1], expected[:-2])
    seen = [t for t in wheel.rise_us if t <= kept[-1]]
    if len(seen) > FIRST_WRONG + 6:
        assert times[0] <= max(wheel.rise_us[FIRST_WRONG], kept[0] - STAMPS * 4000)
    off = {round(angle - truth[t], 6) for t, angle in got}
    assert len({o % 65_536 for o in off}) <= 1
    assert edges.broken == 0


@settings(deadline=None, max_examples=40)
@given(
    wheel=wheels(),
    rise=st.lists(st.booleans(), min_size=5, max_size=20),
    fall=st.lists(st.booleans(), min_size=5, max_size=20),
)
def test_frames_of_one_polarity_lost_never_make_a_wrong_edge(
    wheel: Wheel, rise: list[bool], fall: list[bool]
) -> None:
    """An edge that comes too late to be of use may be missing; one that comes is right."""
    edges, got = run(wheel, keep_enough(wheel, rise), keep_enough(wheel, fall))
    truth = wheel.angle_of(DUTY)
    times = [t for t, _ in got]
    assert times == sorted(set(times))
    assert len({round(angle - truth[t], 6) for t, angle in got}) == 1
    assert edges.broken == 0


@settings(deadline=None, max_examples=25)
@given(wheel=wheels(), wanted=st.lists(st.booleans(), min_size=5, max_size=20))
def test_the_chain_of_one_polarity_has_no_hole(wheel: Wheel, wanted: list[bool]) -> None:
    """Numbers run on by one, and each has its time, whichever frames came."""
    polarity, got = Polarity(), []
    kept = keep_enough(wheel, wanted)
    for read_us in kept:
        polarity.take(wheel.rise(read_us), read_us)
        got += zip(*polarity.rows[:, : polarity.count].tolist(), strict=True)
        polarity.use(polarity.count)
    truth = [(wheel.first + i, t) for i, t in enumerate(wheel.rise_us) if t <= kept[-1]]
    if not got:
        assert len(truth) <= FIRST_WRONG
        return
    numbers = [number for number, _ in got]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert [t for _, t in got] == [t for _, t in truth][-len(got) :]
    assert (numbers[-1] - truth[-1][0]) % 65_536 == 0


@settings(deadline=None, max_examples=40)
@given(wheel=wheels(600, 900, 200), lost=st.integers(3, 6), at=st.integers(1, 4))
def test_more_edges_lost_than_a_frame_holds_is_a_break(wheel: Wheel, lost: int, at: int) -> None:
    """The hole is seen, not guessed over. One polarity alone can count on."""
    all_reads = reads(wheel)
    kept = all_reads[:at] + all_reads[at + lost :]
    hole = [t for t in wheel.rise_us if all_reads[at - 1] < t <= all_reads[at + lost]]
    fallen = [t for t in wheel.fall_us if all_reads[at - 1] < t <= all_reads[at + lost]]
    edges, got = run(wheel, kept, kept)
    counted = any(t <= all_reads[at - 1] for t, _ in got)
    assert edges.broken == (counted and len(hole) > STAMPS and len(fallen) > STAMPS)
    truth = wheel.angle_of(DUTY)
    assert {t for t, _ in got} <= set(truth)


@pytest.mark.parametrize("pause_us", [66_000, 3 * 65_536 + 1, 3 * 65_536, 2_000_000, 1 << 32])
def test_a_wheel_that_stood_still_has_lost_its_numbers(pause_us: int) -> None:
    """It may have turned back: what comes after the stop is not tied to what came before."""
    rise = [1000 + 2000 * k for k in range(40)]
    rise += [rise[-1] + pause_us + 2000 * k for k in range(80)]
    fall = [t + 800 for t in rise]
    wheel = Wheel(1, rise, fall)
    restart_us = rise[40]
    before = list(range(5_000, min(restart_us, rise[39] + 200_000), READ_US))
    after = list(range(restart_us - restart_us % READ_US + 15_000, rise[-1], READ_US))
    edges, got = run(wheel, before + after, before + after)
    truth = wheel.angle_of(DUTY)
    assert edges.broken > 0
    assert {t for t, _ in got} <= set(truth)
    late = [(t, angle) for t, angle in got if t >= restart_us]
    assert len(late) > 40
    assert len({round(angle - truth[t], 6) for t, angle in late}) == 1


def test_a_standing_wheel_says_nothing() -> None:
    wheel = Wheel(1, [10**9], [10**9 + 1])
    edges, got = run(wheel, [10_000, 20_000, 30_000], [10_000, 20_000, 30_000])
    assert got == []
    assert edges.broken == 0
    assert edges.newest is None


@settings(deadline=None, max_examples=25)
@given(
    wheel=wheels(),
    start=st.integers(0, 12),
)
def test_a_falling_edge_belongs_to_the_rising_edge_before_it(wheel: Wheel, start: int) -> None:
    """Wherever listening begins: in a tooth or in a gap, with numbers ahead or not."""
    some = reads(wheel)[start : start + 4]
    if len(some) < 2 or wheel.rise_us[FIRST_WRONG + 6] > some[-1]:
        return
    _, got = run(wheel, some, some)
    truth = wheel.angle_of(DUTY)
    assert {round((angle - truth[t]) % 65_536, 6) for t, angle in got} <= {0.0, 65_536.0}
    assert any(t in set(wheel.fall_us) for t, _ in got)


def test_a_restart_forgets_all_numbers() -> None:
    wheel = Wheel(500, [1000 + 2000 * k for k in range(40)], [1800 + 2000 * k for k in range(40)])
    edges, clock = WheelEdges(TEETH, DUTY), SensorClockEstimate()
    edges.read([wheel.rise(60_000)], [wheel.fall(60_000)], clock, 60_000)
    edges.restart()
    assert edges.broken == 1
    assert edges.newest is None
    earlier = Wheel(7, [t - 900 for t in wheel.rise_us], [t - 900 for t in wheel.fall_us])
    batch = edges.read([earlier.rise(59_500)], [earlier.fall(59_500)], clock, 61_000)
    truth = earlier.angle_of(DUTY)
    angles = batch.theta_rad / edges.pitch_rad
    assert batch.time_us.size == 2 * STAMPS
    assert np.allclose(angles, [truth[int(t)] for t in batch.time_us])
