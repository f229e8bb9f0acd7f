"""Speed wheels against each other, by counts of teeth alone: who is found to read wrong, when, and
when it is believed again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import pytest
from guard_cases import LIMITS, SHEET

from meshpoint.controller.guard.limits import GUARD_END_M
from meshpoint.controller.guard.own_speed import TeethCounted
from meshpoint.controller.guard.shafts_in_mesh import (
    AGAIN_US,
    SLACK_SHARE,
    SLACK_TEETH,
    WHOLE_TEETH,
    ShaftsInMesh,
)
from meshpoint.gearbox import MainGear, Range, Split
from meshpoint.units import RPM

INPUT, LAYSHAFT, MAIN, PROPELLER = range(4)
SHAFTS = (INPUT, LAYSHAFT, MAIN, PROPELLER)
STEP_US = 10_000
IN_M = SHEET.sleeve.stroke_m
SECOND_HIGH_LOW = (IN_M, 0.0, IN_M, -IN_M)
"""Second gear, high split, low range."""
NEUTRAL = (0.0, 0.0, IN_M, -IN_M)
WHEELS = (
    SHEET.wheels.input_.teeth,
    SHEET.wheels.layshaft.teeth,
    SHEET.wheels.main.teeth,
    SHEET.wheels.propeller.teeth,
)
RATIOS = (
    SHEET.split_mesh(Split.HIGH).ratio,
    SHEET.main_mesh(MainGear.SECOND).ratio,
    SHEET.range_mesh(Range.LOW).ratio,
)


def in_mesh(layshaft_rpm: float = 1400.0) -> list[float]:
    """Speeds of the four shafts (rad/s) with all three pairs in mesh."""
    layshaft = layshaft_rpm * RPM
    main = layshaft * RATIOS[1]
    return [layshaft / RATIOS[0], layshaft, main, main * RATIOS[2]]


@dataclass
class Gearbox:
    """Four shafts with wheels that may read wrong, read every 10 ms."""

    speeds: list[float] = field(default_factory=in_mesh)
    positions_m: tuple[float, ...] | None = SECOND_HIGH_LOW
    factors: list[float] = field(default_factory=lambda: [1.0] * 4)
    unheard: Sequence[int] = ()

    def __post_init__(self) -> None:
        self.watch = ShaftsInMesh(SHEET, LIMITS)
        self.now_us = 0
        self.teeth = [0.3, 0.6, 0.1, 0.9]

    def step(self) -> tuple[int, ...]:
        """Another read; the wheels in doubt."""
        self.now_us += STEP_US
        counts: list[TeethCounted | None] = []
        for shaft in SHAFTS:
            per_us = self.speeds[shaft] * self.factors[shaft] * WHEELS[shaft] / 6.283185307e6
            self.teeth[shaft] += per_us * STEP_US
            whole = int(self.teeth[shaft])
            edge_us = self.now_us - round((self.teeth[shaft] - whole) / per_us)
            counts.append(None if shaft in self.unheard else TeethCounted(edge_us, whole))
        self.watch.take(self.positions_m, tuple(counts))
        return self.watch.in_doubt

    def run(self, for_ms: int) -> tuple[int, ...]:
        for _ in range(for_ms // 10):
            self.step()
        return self.watch.in_doubt

    def until_found(self, limit_ms: int = 5_000) -> int:
        """Milliseconds until a wheel is in doubt."""
        begun_us = self.now_us
        while not self.step():
            assert self.now_us - begun_us < limit_ms * 1000, "no wheel is found to read wrong"
        return (self.now_us - begun_us) // 1000


@pytest.mark.parametrize("layshaft_rpm", [300.0, 1400.0, 2400.0])
@pytest.mark.parametrize("positions_m", [SECOND_HIGH_LOW, NEUTRAL])
def test_wheels_that_count_by_the_ratio_are_never_in_doubt(
    layshaft_rpm: float, positions_m: tuple[float, ...]
) -> None:
    box = Gearbox(in_mesh(layshaft_rpm), positions_m)
    assert all(box.step() == () for _ in range(1_000))


@pytest.mark.parametrize("factor", [2.0, 0.5, 0.8, 1.2])
@pytest.mark.parametrize("wheel", SHAFTS)
def test_in_gear_the_wheel_that_reads_wrong_is_named_and_no_other(
    wheel: int, factor: float
) -> None:
    box = Gearbox()
    box.run(1_000)
    box.factors[wheel] = factor
    assert box.until_found() <= 1_500
    assert box.watch.in_doubt == (wheel,)
    assert box.run(3_000) == (wheel,)


@pytest.mark.parametrize("wheel", SHAFTS)
def test_the_name_is_right_at_whatever_moment_the_wheel_goes_wrong(wheel: int) -> None:
    """Counts of before it that were nearly enough to agree are no proof."""
    for sound_ms in range(1_000, 1_800, 20):
        box = Gearbox()
        box.run(sound_ms)
        box.factors[wheel] = 0.8
        box.until_found()
        assert box.watch.in_doubt == (wheel,)


@pytest.mark.parametrize("unheard", [(), (PROPELLER,)])
def test_a_contradiction_that_is_settled_names_nobody_later(unheard: Sequence[int]) -> None:
    """The layshaft's wheel was wrong in gear and is right again in neutral; then the propeller
    shaft's goes wrong, and by this the main shaft's is denied once, not twice."""
    box = Gearbox(unheard=unheard)
    box.factors[LAYSHAFT] = 0.8
    box.until_found()
    box.positions_m, box.factors = NEUTRAL, [1.0] * 4
    assert box.run(3_000) == ()
    box.unheard = ()
    box.run(3_000)
    box.factors[PROPELLER] = 0.8
    box.until_found()
    assert box.watch.in_doubt == (MAIN, PROPELLER)


def test_from_one_gear_to_another_the_counts_begin_anew() -> None:
    """With no step between them in which none was seen in."""
    box = Gearbox()
    box.run(1_050)
    third = SHEET.main_mesh(MainGear.THIRD).ratio
    box.positions_m = (0.0, IN_M, IN_M, -IN_M)
    box.speeds[LAYSHAFT] = box.speeds[MAIN] / third
    box.speeds[INPUT] = box.speeds[LAYSHAFT] / RATIOS[0]
    assert all(box.step() == () for _ in range(300))


@pytest.mark.parametrize("wheel", SHAFTS)
def test_a_wheel_that_is_wrong_from_the_start_is_named_too(wheel: int) -> None:
    box = Gearbox()
    box.factors[wheel] = 0.8
    box.until_found()
    assert box.watch.in_doubt == (wheel,)


@pytest.mark.parametrize(
    ("wheel", "both"),
    [(INPUT, (0, 1)), (LAYSHAFT, (0, 1)), (MAIN, (2, 3)), (PROPELLER, (2, 3))],
)
def test_in_neutral_a_wheel_is_denied_by_one_other_and_both_are_in_doubt(
    wheel: int, both: tuple[int, ...]
) -> None:
    box = Gearbox(positions_m=NEUTRAL)
    box.run(1_000)
    box.factors[wheel] = 0.8
    box.until_found()
    assert box.watch.in_doubt == both


@pytest.mark.parametrize("wheel", SHAFTS)
def test_what_was_found_in_gear_is_remembered_in_neutral(wheel: int) -> None:
    box = Gearbox()
    box.factors[wheel] = 0.5
    box.until_found()
    box.positions_m = (0.0, 0.0, 0.0, 0.0)
    assert box.run(60_000) == (wheel,)


@pytest.mark.parametrize("positions_m", [SECOND_HIGH_LOW, NEUTRAL])
@pytest.mark.parametrize("wheel", SHAFTS)
def test_a_wheel_that_reads_right_again_is_believed_after_a_second_not_sooner(
    wheel: int, positions_m: tuple[float, ...]
) -> None:
    box = Gearbox()
    box.factors[wheel] = 0.8
    box.until_found()
    box.run(500)
    box.positions_m = positions_m
    box.factors[wheel] = 1.0
    assert box.run(AGAIN_US // 1000 - 150) == (wheel,)
    box.run(2_500)
    assert box.watch.in_doubt == ()
    assert box.run(5_000) == ()


@pytest.mark.parametrize("for_ms", [60, 300, 1_000])
@pytest.mark.parametrize("factor", [2.0, 0.5, 0.8])
@pytest.mark.parametrize("wheel", SHAFTS)
def test_a_wheel_that_was_wrong_for_a_moment_brings_no_other_into_doubt(
    wheel: int, factor: float, for_ms: int
) -> None:
    """Its neighbours agree with it again one after the other: the one that is last, behind a slow
    wheel, has not gone wrong meanwhile."""
    box = Gearbox()
    box.run(1_000)
    box.factors[wheel] = factor
    box.run(for_ms)
    box.factors[wheel] = 1.0
    found = {box.step() for _ in range(500)}
    assert all(not doubt or wheel in doubt for doubt in found), found
    assert box.watch.in_doubt == ()


@pytest.mark.parametrize("wheel", SHAFTS)
def test_what_was_wrong_in_neutral_is_not_put_on_a_neighbour_in_gear(wheel: int) -> None:
    """Of the pair that was in doubt one agrees as the gear comes in; so it may have been wrong all
    the same, as long as the other says nothing new against it."""
    box = Gearbox(positions_m=NEUTRAL)
    box.run(1_000)
    box.factors[wheel] = 0.8
    box.until_found()
    both = box.watch.in_doubt
    box.factors[wheel], box.positions_m = 1.0, SECOND_HIGH_LOW
    assert {box.step() for _ in range(500)} == {both, ()}


@pytest.mark.parametrize("wheel", SHAFTS)
def test_one_that_stays_wrong_from_neutral_on_is_named_in_gear(wheel: int) -> None:
    box = Gearbox(positions_m=NEUTRAL)
    box.run(1_000)
    box.factors[wheel] = 0.8
    box.until_found()
    box.positions_m = SECOND_HIGH_LOW
    assert box.run(2_000) == (wheel,)


@pytest.mark.parametrize("wheel", [INPUT, LAYSHAFT])
def test_a_wheel_that_goes_wrong_again_within_the_second_stays_in_doubt(wheel: int) -> None:
    box = Gearbox()
    box.factors[wheel] = 0.8
    box.until_found()
    for _ in range(10):
        box.factors[wheel] = 1.0
        assert box.run(700) == (wheel,)
        box.factors[wheel] = 0.8
        assert box.run(300) == (wheel,)


def test_a_gear_that_is_shown_but_not_in_accuses_no_wheel() -> None:
    """The position sensor lies: layshaft and main shaft contradict each other, but each agrees with
    its other neighbour."""
    box = Gearbox(positions_m=NEUTRAL)
    box.speeds[MAIN] *= 0.8
    box.speeds[PROPELLER] *= 0.8
    box.run(1_000)
    assert not box.watch.denies_gear
    box.positions_m = SECOND_HIGH_LOW
    assert all(box.step() == () for _ in range(500))
    assert box.watch.denies_gear
    box.positions_m = NEUTRAL
    assert all(box.step() == () for _ in range(500))
    assert not box.watch.denies_gear


@pytest.mark.parametrize("wheel", SHAFTS)
def test_a_wheel_that_reads_wrong_denies_no_gear(wheel: int) -> None:
    """At whatever moment it goes wrong and for how long, nor is one denied that is in."""
    for sound_ms, wrong_ms in ((1_000, 3_000), (1_130, 400), (1_370, 150)):
        box = Gearbox()
        for factor, for_ms in ((1.0, sound_ms), (0.8, wrong_ms), (1.0, 3_000)):
            box.factors[wheel] = factor
            for _ in range(for_ms // 10):
                box.step()
                assert not box.watch.denies_gear


def test_where_no_other_wheel_is_heard_both_of_a_gear_are_in_doubt() -> None:
    box = Gearbox(unheard=(INPUT, PROPELLER))
    box.factors[MAIN] = 0.8
    box.until_found()
    assert box.watch.in_doubt == (LAYSHAFT, MAIN)


def test_two_wheels_that_read_wrong_are_both_in_doubt() -> None:
    box = Gearbox()
    box.factors[INPUT] = box.factors[PROPELLER] = 0.5
    box.run(3_000)
    assert box.watch.in_doubt == (INPUT, PROPELLER)


@pytest.mark.parametrize(
    ("first", "then"), [(INPUT, PROPELLER), (PROPELLER, INPUT), (INPUT, MAIN), (MAIN, INPUT)]
)
def test_a_second_wheel_that_goes_wrong_comes_into_doubt_as_well(first: int, then: int) -> None:
    box = Gearbox()
    box.factors[first] = 0.8
    box.until_found()
    box.run(1_000)
    box.factors[then] = 2.0
    assert set(box.run(2_000)) >= {first, then}


def test_positions_that_are_not_believed_put_nothing_in_mesh() -> None:
    box = Gearbox(positions_m=None)
    box.factors[LAYSHAFT] = 2.0
    assert all(box.step() == () for _ in range(300))


@pytest.mark.parametrize("sleeve", [0, 2, 3])
def test_a_sleeve_that_is_not_quite_in_puts_nothing_in_mesh(sleeve: int) -> None:
    pair_of = {0: 1, 2: 0, 3: 2}
    for short_m, is_found in ((GUARD_END_M + 1e-6, False), (GUARD_END_M - 1e-6, True)):
        positions = [0.0] * 4
        side = -1.0 if sleeve == 3 else 1.0
        positions[sleeve] = side * (IN_M - short_m)
        box = Gearbox(positions_m=tuple(positions))
        box.factors[pair_of[sleeve]] = 2.0
        box.run(1_000)
        assert bool(box.watch.in_doubt) is is_found


@pytest.mark.parametrize(("more_us", "is_found"), [(-1, False), (1, True)])
def test_counts_may_differ_by_two_teeth_and_two_per_cent(more_us: int, is_found: bool) -> None:
    """Main shaft and propeller shaft in high range, of which the propeller's wheel is the slower:
    it takes longer for its hundred teeth than the main shaft's speed allows."""
    watch = ShaftsInMesh(SHEET, LIMITS)
    positions = (0.0, 0.0, 0.0, IN_M)
    teeth_main, teeth_propeller = 107, 100
    period_us = 1_000_000
    expected = (teeth_propeller + SLACK_TEETH) / (1.0 - SLACK_SHARE)
    took_us = expected / (teeth_main * WHEELS[PROPELLER] / WHEELS[MAIN]) * period_us
    watch.take(positions, (None, None, TeethCounted(5, 7), TeethCounted(3, 9)))
    late = TeethCounted(3 + round(took_us) + 5 * more_us, 9 + teeth_propeller)
    watch.take(positions, (None, None, TeethCounted(5 + period_us, 7 + teeth_main), late))
    assert watch.in_doubt == ((MAIN, PROPELLER) if is_found else ())


@pytest.mark.parametrize(("left_out", "is_found"), [((), True), ((43, 44), False)])
def test_teeth_that_a_wheel_has_left_out_by_the_sheet_may_be_missing_besides(
    left_out: tuple[int, ...], is_found: bool
) -> None:
    """Of forty teeth of the main shaft's wheel three and a half are not there."""
    main = replace(SHEET.wheels.main, missing=left_out)
    sheet = replace(SHEET, wheels=replace(SHEET.wheels, main=main))
    watch = ShaftsInMesh(sheet, LIMITS)
    took_us = round(1e6 * 40.0 / 43.5 * WHEELS[MAIN] / WHEELS[PROPELLER])
    for main_count, propeller_count in (
        (TeethCounted(0, 0), TeethCounted(0, 0)),
        (TeethCounted(1_000_000, 40), TeethCounted(took_us, 40)),
    ):
        watch.take((0.0, 0.0, 0.0, IN_M), (None, None, main_count, propeller_count))
    assert bool(watch.in_doubt) is is_found


def test_a_wheel_is_found_by_what_a_whole_window_shows_and_not_by_less() -> None:
    limit = SLACK_SHARE + SLACK_TEETH / WHOLE_TEETH
    for wrong, is_found in ((0.75 * limit, False), (1.5 * limit, True)):
        box = Gearbox()
        box.run(1_000)
        box.factors[LAYSHAFT] = 1.0 - wrong
        assert bool(box.run(5_000)) is is_found


@pytest.mark.parametrize("lost", SHAFTS)
def test_frames_that_are_lost_accuse_nobody_while_the_shafts_gain_speed(lost: int) -> None:
    """Every third read of a wheel is not heard; the vehicle is started in a low gear."""
    box = Gearbox(in_mesh(300.0))
    for step in range(400):
        box.unheard = (lost,) if step % 3 == 0 else ()
        box.speeds = [speed * 1.005 for speed in box.speeds]
        assert box.step() == ()


def test_sensors_that_start_anew_accuse_nobody() -> None:
    """Their counts begin at zero again."""
    box = Gearbox()
    box.run(1_000)
    box.watch.forget_counts()
    box.teeth = [0.5] * 4
    assert all(box.step() == () for _ in range(300))


def test_a_clock_that_was_set_back_accuses_nobody() -> None:
    box = Gearbox()
    box.run(2_000)
    box.now_us -= 1_000_000
    assert all(box.step() == () for _ in range(500))
