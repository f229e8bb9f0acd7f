"""The touch of the clutch's plates from the engine's speed, and the engine that raises a gear's
speed: each limit, by hand."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from test_synchronise_exactly import BRAKE, LIMITS, MS, NOW_US, SHEET, TARGET, Gear, Step

from meshpoint.controller.sensing.clutch_track import ClutchTrack
from meshpoint.controller.shift import speed_up
from meshpoint.controller.shift.kiss_point import KissPoint
from meshpoint.controller.shift.speed_up import part_clutch, raise_speed, too_slow
from meshpoint.controller.shift.table import Trigger
from meshpoint.controller.shift.valve_board import OFF
from meshpoint.dbc.messages import ClutchAction, FaultCode
from meshpoint.gearbox import MainGear

CLUTCH = SHEET.clutch
TICK_US = 10 * MS


def fed(kiss: KissPoint, closed: list[float], accelerations: list[float], **odd: Any) -> KissPoint:
    """Samples of a closing clutch 10 ms apart; between them the engine's acceleration is even."""
    track, speed = ClutchTrack(), 100.0
    track.take(NOW_US - TICK_US, closed[0] - 0.05)
    for k, share in enumerate(closed):
        at_us = NOW_US + k * TICK_US
        track.take(at_us, share)
        kiss.look(track, odd.get(f"speed{k}", speed))
        for _ in range(odd.get(f"again{k}", 0)):
            kiss.look(track, speed + 50.0)
        if k < len(accelerations):
            speed += 1e-2 * accelerations[k]
    return kiss


def rising(touch_share: float, first: float = 0.26, rise: float = -6_000.0) -> list[float]:
    """Accelerations of four intervals of a clutch that closes by 0.05 in each, its plates touching
    in the second: from there it changes by `rise` a second of time, exactly."""
    touch_s = (touch_share - first) / 5.0
    found = []
    for k in range(4):
        begin, end = max(0.0, 0.01 * k - touch_s), max(0.0, 0.01 * (k + 1) - touch_s)
        found.append(20.0 + rise * (end**2 - begin**2) / 2.0 / 0.01)
    return found


FIRST = 0.26
POSITIONS = [FIRST + 0.05 * k for k in range(5)]


def test_before_any_closing_the_sheet_tells_where_plates_touch() -> None:
    kiss = KissPoint(SHEET)
    assert kiss.share == CLUTCH.kiss_share
    assert kiss.sd == pytest.approx(CLUTCH.kiss_tolerance / 2.0)
    assert kiss.parted_share == pytest.approx(CLUTCH.kiss_share - CLUTCH.kiss_tolerance / 2.0)
    kiss.sd = 1.0
    assert kiss.parted_share == CLUTCH.surely_open_share


def learned(kiss: KissPoint) -> float | None:
    """The touch that was taken, from the share that it has moved by."""
    known, sd = CLUTCH.kiss_share, CLUTCH.kiss_tolerance / 2.0
    if kiss.share == known and kiss.sd == sd:
        return None
    weight = sd**2 / (sd**2 + 0.02**2)
    assert kiss.sd == pytest.approx(max(math.sqrt(1.0 - weight) * sd, 0.02 / math.sqrt(10.0)))
    return known + (kiss.share - known) / weight


def crossing(accelerations: list[float]) -> float:
    """Where the line through the third and fourth interval's middles meets the first's value."""
    own, _, third, fourth = accelerations
    middles = 2.5 - (third - own) / (fourth - third)
    return FIRST + 0.05 * middles


@pytest.mark.parametrize("rise", [-6_000.0, 6_000.0])
@pytest.mark.parametrize("touch", [0.315, 0.33, 0.35])
def test_plates_touch_where_the_growing_acceleration_leaves_its_own(
    touch: float, rise: float
) -> None:
    """A line through two intervals of even growth is exact."""
    kiss = fed(KissPoint(SHEET), POSITIONS, rising(touch, rise=rise))
    assert learned(kiss) == pytest.approx(touch, abs=1e-6)
    assert not kiss._seen


@pytest.mark.parametrize(("grown", "is_seen"), [(59.9, False), (60.1, True)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_growth_of_less_than_60_rad_s2_is_what_an_engine_does_by_itself(
    grown: float, is_seen: bool, sign: float
) -> None:
    own = 20.0
    accelerations = [own, own + sign * 2.0, own + sign * 24.0, own + sign * grown]
    kiss = fed(KissPoint(SHEET), POSITIONS, accelerations)
    found = learned(kiss)
    assert (found is not None) is is_seen
    if found is not None:
        assert found == pytest.approx(crossing(accelerations), abs=1e-6)


@pytest.mark.parametrize(
    ("third", "fourth", "is_seen"),
    [(50.0, 100.0, True), (-50.0, 100.0, False), (20.0, 100.0, False), (100.0, 100.0, False),
     (150.0, 100.0, False), (100.0, 120.0, False), (22.0, 100.0, False), (95.0, 146.0, True),
     (95.0, 144.0, False), (60.0, 139.0, True), (60.0, 141.0, False)],
)  # fmt: skip
def test_a_line_that_meets_its_own_outside_the_second_interval_is_no_touch(
    third: float, fourth: float, is_seen: bool
) -> None:
    """The growth has to have begun between the second and the third sample, and go on."""
    accelerations = [20.0, 20.0, third, fourth]
    kiss = fed(KissPoint(SHEET), POSITIONS, accelerations)
    found = learned(kiss)
    assert (found is not None) is is_seen
    if found is not None:
        assert 0.31 <= found <= 0.36
        assert found == pytest.approx(crossing(accelerations), abs=1e-6)


@pytest.mark.parametrize(("shift", "is_taken"), [
    (CLUTCH.surely_open_share - 0.001, False), (CLUTCH.surely_open_share + 0.001, True),
    (CLUTCH.kiss_share + CLUTCH.kiss_tolerance - 0.001, True),
    (CLUTCH.kiss_share + CLUTCH.kiss_tolerance + 0.001, False),
])  # fmt: skip
def test_no_touch_is_taken_that_the_sheet_does_not_allow(shift: float, is_taken: bool) -> None:
    first = shift - 0.075
    kiss = fed(KissPoint(SHEET), [first + 0.05 * k for k in range(5)], rising(shift, first))
    found = learned(kiss)
    assert (found is not None) is is_taken
    if found is not None:
        assert found == pytest.approx(shift, abs=1e-6)


def test_a_sample_that_is_looked_at_twice_counts_once() -> None:
    kiss = fed(KissPoint(SHEET), POSITIONS, rising(0.33), again2=3)
    assert learned(kiss) == pytest.approx(0.33, abs=1e-6)


@pytest.mark.parametrize("at", [0, 2, 4])
def test_without_the_engines_speed_a_closing_begins_anew(at: int) -> None:
    kiss = fed(KissPoint(SHEET), POSITIONS, rising(0.33), **{f"speed{at}": None})
    assert learned(kiss) is None
    assert len(kiss._seen) == 4 - at


def test_a_clutch_that_stands_or_opens_shows_no_touch() -> None:
    kiss = fed(KissPoint(SHEET), POSITIONS[::-1], rising(0.33))
    assert learned(kiss) is None
    assert not kiss._seen
    kiss.look(ClutchTrack(), 100.0)
    assert not kiss._seen


def test_a_clutch_that_closes_slowly_shows_its_touch_too() -> None:
    """By 0.8 in a second: 1.7 intervals after the first sample."""
    kiss = fed(KissPoint(SHEET), [0.34 + 0.008 * k for k in range(5)], [20.0, 20.0, 60.0, 110.0])
    assert learned(kiss) == pytest.approx(0.34 + 1.7 * 0.008, abs=1e-6)


def test_past_touches_weigh_as_ten() -> None:
    """sd / sqrt 10 at least: linings wear."""
    kiss = KissPoint(SHEET)
    for _ in range(40):
        before, sd = kiss.share, kiss.sd
        fed(kiss, POSITIONS, rising(0.33))
        kiss._seen.clear()
        weight = sd**2 / (sd**2 + 0.02**2)
        assert kiss.share == pytest.approx(before + weight * (0.33 - before))
        assert kiss.sd == pytest.approx(max(sd * math.sqrt(1.0 - weight), 0.02 / math.sqrt(10.0)))
    assert kiss.sd == pytest.approx(0.02 / math.sqrt(10.0))


class Raising(Step):
    """A gear that the engine is to raise, whose slip wanted is laid down."""

    wanted = 4.0

    def __init__(self, slip: float | None = 4.0, closed: float | None = 0.98) -> None:
        super().__init__(Gear())
        self.snapshot.speeds = SimpleNamespace(layshaft=100.0, slip_rad_s=self._slip, main=60.0)
        self.slip = slip
        self.view = self.snapshot.view
        self.view.clutch_closed, self.view.clutch_parted = closed, False
        self.context.clutch = ClutchAction.OPEN
        self.asked: list[tuple[Any, ...]] = []
        context: Any = self.context
        context.ask_engine = lambda *given: self.asked.append(given)

    def _slip(self, gear: MainGear) -> float | None:
        assert gear is TARGET.main
        return self.slip


@pytest.fixture
def _wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed_up, "_raised_slip", lambda *_: Raising.wanted)


@pytest.mark.usefixtures("_wanted")
@pytest.mark.parametrize(
    ("slip", "closed", "is_raised"),
    [(4.0, 0.98, True), (3.0, 1.0, True), (2.99, 1.0, False), (7.0, 1.0, True),
     (7.01, 1.0, False), (4.0, 0.979, False), (4.0, None, False), (None, 1.0, False)],
)  # fmt: skip
def test_a_gear_is_raised_within_10_rpm_below_and_30_above_through_a_closed_clutch(
    slip: float | None, closed: float | None, is_raised: bool
) -> None:
    step = Raising(slip, closed)
    assert raise_speed(step.context, step.snapshot) is (Trigger.RAISED if is_raised else None)
    assert step.context.clutch is ClutchAction.CLOSE
    assert step.asked == [(TARGET, 4.0, step.snapshot)]


@pytest.mark.usefixtures("_wanted")
@pytest.mark.parametrize(("late_us", "gives_up"), [(0, False), (1, True)])
@pytest.mark.parametrize("closed", [1.0, 0.5])
def test_an_engine_or_a_clutch_that_does_not_come_ends_the_shift(
    late_us: int, gives_up: bool, closed: float
) -> None:
    step = Raising(0.0, closed)
    step.context.since_us = NOW_US - LIMITS.raise_ms * MS - late_us
    found = raise_speed(step.context, step.snapshot)
    assert found is (Trigger.GAVE_UP if gives_up else None)
    fault = FaultCode.ENGINE_FAILED if closed == 1.0 else FaultCode.CLUTCH_STUCK
    assert step.shift.fault is (fault if gives_up else FaultCode.NONE)


@pytest.mark.usefixtures("_wanted")
def test_a_clutch_that_parts_lets_the_engine_go() -> None:
    step = Raising()
    step.context.clutch, step.context.engine_rad_s = ClutchAction.CLOSE, 150.0
    assert part_clutch(step.context, step.snapshot) is None
    assert step.context.clutch is ClutchAction.OPEN
    assert step.context.engine_rad_s == 150.0
    assert step.asked == [(TARGET, 4.0, step.snapshot)]
    step.view.clutch_parted = True
    step.context.board.schedule(BRAKE, True, NOW_US, NOW_US)
    assert part_clutch(step.context, step.snapshot) is Trigger.CLUTCH_OPEN
    asked: Any = step.context.engine_rad_s
    assert asked is None
    assert step.command(BRAKE) == OFF


@pytest.mark.usefixtures("_wanted")
@pytest.mark.parametrize(("late_us", "gives_up"), [(0, False), (1, True)])
def test_a_clutch_that_does_not_part_ends_the_shift(late_us: int, gives_up: bool) -> None:
    step = Raising()
    step.context.since_us = NOW_US - LIMITS.clutch_ms * MS - late_us
    found = part_clutch(step.context, step.snapshot)
    assert found is (Trigger.GAVE_UP if gives_up else None)
    assert step.shift.fault is (FaultCode.CLUTCH_STUCK if gives_up else FaultCode.NONE)


@pytest.mark.parametrize(("used", "left"), [(1, True), (0, False)])
def test_the_engine_is_asked_so_often_in_a_shift(used: int, left: bool) -> None:
    """And the firing and the release that were planned are none any more."""
    step = Step().braking().planned(NOW_US + 50 * MS)
    step.shift.raises, step.shift.release_us = LIMITS.raises - used, NOW_US + 9
    found = too_slow(step.context, step.snapshot)
    assert found is (Trigger.TOO_SLOW if left else Trigger.GAVE_UP)
    assert step.shift.raises == LIMITS.raises
    assert step.command(BRAKE) == OFF
    assert step.context.brake.switches[-1] == (NOW_US, False)
    planned: tuple[Any, ...] = (step.shift.plan, step.shift.release_us)
    if left:
        assert planned == (None, None)
    else:
        assert step.shift.fault is FaultCode.SYNCHRONISE_FAILED


@pytest.mark.parametrize("layshaft", [150.0, None])
def test_a_gear_is_raised_by_what_drag_takes_until_20_ms_after_the_plates_have_surely_parted(
    layshaft: float | None,
) -> None:
    step = Step()
    step.context.kiss.share = 0.4
    step.snapshot.speeds = SimpleNamespace(layshaft=layshaft)
    step.snapshot.layshaft = SimpleNamespace(drag_nm=lambda omega: 1.0 + 0.02 * omega)
    drag = 1.0 + 0.02 * (layshaft or 0.0)
    falls_s = (0.4 - CLUTCH.surely_open_share) * CLUTCH.open_delay_s + 0.02
    ratio = SHEET.main_mesh(TARGET.main).ratio
    taken = ratio * drag / SHEET.inertia_kgm2(TARGET.split) * falls_s
    raised = speed_up._raised_slip(step.context, step.snapshot)
    assert raised == pytest.approx(step.context.settings.window.raised_rad_s + taken)
