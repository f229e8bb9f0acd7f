"""How figures are learned from shift to shift: as Bayes has it, within their ranges, and no surer
than they may be; the swing's figures and the two models' rivalry among them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from meshpoint.controller.estimate.driveline_swing import (
    START_SHARE,
    DrivelineSwing,
    EdgeRun,
)
from meshpoint.controller.estimate.figures import GROWTH, Figure, learn, prior
from meshpoint.controller.estimate.lash import Lash
from meshpoint.controller.estimate.main_tracker import (
    EACH_US,
    LEAST_WINDOWS,
    ModelSelector,
    Prediction,
)
from meshpoint.controller.models.swing import RATE, STEADY, SWING, SWING_STATES
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.controller.settings.learned import SwingRecord
from meshpoint.gearbox.driveline import Axle
from meshpoint.units import TURN

TUNING = CrossingFilterTuning()
Deviance = Callable[[Sequence[float]], float]


def test_a_figure_lies_within_its_factor_of_a_typical_one() -> None:
    one = prior(20.0, 2.0, (1.0, 400.0), 0.01)
    assert one.value == pytest.approx(20.0)
    assert one.sd == one.prior_sd == pytest.approx(math.log(2.0))
    assert math.exp(one.least_log) == pytest.approx(1.0)
    assert math.exp(one.most_log) == pytest.approx(400.0)
    for value, sd, kept, kept_sd in (
        (30.0, 0.1, 30.0, 0.1),
        (0.5, 0.1, 1.0, 0.1),
        (500.0, 0.1, 400.0, 0.1),
        (30.0, 1e-4, 30.0, 0.01),
        (30.0, 9.0, 30.0, math.log(2.0)),
    ):
        found = one.restored(value, sd)
        assert found.value == pytest.approx(kept)
        assert found.sd == pytest.approx(kept_sd)


def seen_at(log: float, sd: float, k: int = 0) -> Deviance:
    """Minus twice the log-likelihood of a shift that saw a figure there, by that deviation."""
    return lambda logs: 3.0 + ((logs[k] - log) / sd) ** 2


@pytest.mark.parametrize(("at", "sd"), [(0.3, 0.2), (-0.1, 0.05), (0.2, 1.0)])
def test_a_shift_and_what_was_known_are_weighed_by_their_variances(at: float, sd: float) -> None:
    """What was known has become a little less sure in between."""
    known = Figure(0.1, 0.25, -3.0, 3.0, 0.6, 0.001)
    (found,), deviance = learn([known], seen_at(at, sd))
    grown = GROWTH * known.sd**2
    weight = 1.0 / grown + 1.0 / sd**2
    assert found.log == pytest.approx((0.1 / grown + at / sd**2) / weight, abs=1e-6)
    assert found.sd == pytest.approx(weight**-0.5, rel=1e-6)
    assert deviance == pytest.approx(3.0 + (at - 0.1) ** 2 / (grown + sd**2), rel=1e-6)
    assert (found.prior_sd, found.least_sd) == (known.prior_sd, known.least_sd)


def test_many_shifts_make_a_figure_no_surer_than_it_may_be_and_none_as_unsure_as_at_first() -> None:
    known = Figure(0.0, 0.5, -3.0, 3.0, 0.5, 0.04)
    for _ in range(12):
        (known,), _ = learn([known], seen_at(0.4, 0.05))
    assert known.log == pytest.approx(0.4, abs=0.01)
    assert known.sd == pytest.approx(0.04)
    for _ in range(100):
        (known,), _ = learn([known], lambda _: 0.0)
    assert known.sd == pytest.approx(0.5), "shifts that tell nothing, roads and loads that change"


def test_a_figure_stays_within_its_range() -> None:
    for far in (-2.0, 2.0):
        known = Figure(0.0, 0.6, -0.5, 0.7, 0.6, 0.01)
        (found,), _ = learn([known], seen_at(far, 0.02))
        assert found.log == pytest.approx(-0.5 if far < 0.0 else 0.7)


def test_a_shift_that_no_figure_explains_teaches_nothing() -> None:
    known = [Figure(0.1, 0.3, -3.0, 3.0, 0.6, 0.01)]
    for none in (math.inf, math.nan):
        found, deviance = learn(known, lambda _, none=none: none)
        assert found == known
        assert deviance == math.inf


def test_two_figures_that_make_up_for_each_other_are_found_in_the_valley() -> None:
    known = [Figure(0.0, 0.5, -3.0, 3.0, 0.5, 0.01) for _ in range(2)]

    def deviance(logs: Sequence[float]) -> float:
        return ((logs[0] + 0.3 * logs[1] - 0.4) / 0.05) ** 2 + ((logs[1] - 0.1) / 0.2) ** 2

    found, _ = learn(known, deviance)
    assert found[0].log + 0.3 * found[1].log == pytest.approx(0.4, abs=0.02)
    assert found[1].log == pytest.approx(0.1, abs=0.06)


def test_of_several_minima_the_deepest_is_found_where_the_whole_range_is_looked_at() -> None:
    """And only while the figure is not well known."""

    def deviance(logs: Sequence[float]) -> float:
        return 10.0 * (1.0 - math.cos(6.0 * (logs[0] - 0.9))) + 4.0 * abs(logs[0] - 0.9)

    unsure = Figure(0.0, 1.0, -1.5, 1.5, 1.0, 0.005)
    (found,), _ = learn([unsure], deviance, (0,))
    assert found.log == pytest.approx(0.9, abs=0.02)
    (near,), _ = learn([unsure], deviance)
    assert abs(near.log - 0.9) > 0.3
    sure = Figure(-0.15, 0.05, -1.5, 1.5, 1.0, 0.005)
    (kept,), _ = learn([sure], deviance, (0,))
    assert abs(kept.log + 0.15) < 0.1


def test_a_driveline_s_swing_begins_with_what_the_settings_say() -> None:
    swing = DrivelineSwing(TUNING)
    natural = TURN * TUNING.swing_hz
    assert swing.motion.part("natural_rad_s")[0] == pytest.approx(natural)
    assert swing.motion.part("decay_per_s")[0] == pytest.approx(TUNING.swing_damping * natural)
    lash = Lash(Axle(), TUNING.lash_rad, TUNING.lash_factor, 1.0)
    assert swing.record(lash.known, False) is None


def test_what_is_not_known_of_a_swing_is_noise_that_drives_it() -> None:
    """Off by a share e of its frequency it accelerates otherwise by 2 e w times its speed v, for
    1 / w at a time: a density of (2 e w v)^2 / w, and the same of its decay."""
    w, speed = TURN * TUNING.swing_hz, TUNING.swing_rad_s
    by_frequency = (2.0 * math.log(TUNING.swing_factor) * w * speed) ** 2 / w
    by_decay = (2.0 * TUNING.swing_damping * math.log(2.0) * w * speed) ** 2 / w
    expected = TUNING.swing_noise_rad2_s3 + by_frequency + by_decay
    found = DrivelineSwing(TUNING).motion.part("noise_rad2_s3")[0]
    assert found == pytest.approx(expected)


def test_a_gear_that_comes_out_leaves_angle_and_speed_and_a_swing_of_any_phase() -> None:
    swing = DrivelineSwing(TUNING)
    x, p = np.arange(1.0, SWING_STATES + 1.0), np.full((SWING_STATES, SWING_STATES), 7.0)
    swing.start(x, p)
    assert x.tolist() == [1.0, 2.0, *[0.0] * (SWING_STATES - 2)]
    assert (p[:2, :2] == 7.0).all()
    diagonal = np.diag(p)[2:]
    assert np.count_nonzero(p) == 4 + diagonal.size
    assert p[STEADY, STEADY] == pytest.approx((START_SHARE * TUNING.main_start_rad_s2) ** 2)
    assert p[RATE, RATE] == pytest.approx((START_SHARE * TUNING.swing_rad_s) ** 2)
    assert p[SWING, SWING] == pytest.approx(p[RATE, RATE] / (TURN * TUNING.swing_hz) ** 2)


def test_a_swing_that_was_kept_is_taken_up_as_it_was() -> None:
    """Each figure no surer than it may be."""
    lash = Lash(Axle(), TUNING.lash_rad, TUNING.lash_factor, 1.0)
    kept = SwingRecord(
        3, 120.0, 0.01, 0.04, 0.3, 1.1, 0.9, 0.1, 0.8, 0.3, 0.6, 17.0, 0.35, True,
        lash.known.half.value, lash.known.half.sd,
    )  # fmt: skip
    swing = DrivelineSwing(TUNING)
    swing.restore(kept)
    again = swing.record(lash.known, True)
    assert again is not None
    assert vars(again) == {name: pytest.approx(value) for name, value in vars(kept).items()}
    assert swing.motion.part("natural_rad_s")[0] == pytest.approx(120.0)
    assert swing.motion.part("decay_per_s")[0] == pytest.approx(0.04 * 120.0)
    assert swing.motion.part("white_rad2_s3")[0] == pytest.approx(0.3)


def test_edges_of_a_run_are_kept_in_their_order_until_the_next_begins() -> None:
    run = EdgeRun()
    assert run.edges.shape == (2, 0)
    assert run.places.size == 0
    run.add(np.array([1.0, 2.0]), np.array([0.1, 0.2]), np.array([5, 6]))
    run.add(np.array([3.0]), np.array([0.3]), np.array([7]))
    assert run.edges.tolist() == [[1.0, 2.0, 3.0], [0.1, 0.2, 0.3]]
    assert run.places.tolist() == [5, 6, 7]
    run.begin()
    assert run.edges.shape == (2, 0)


EVEN = np.arange(0.0, 400_000.0, 5_000.0)
GAP_RAD = math.radians(1.0)


def judged(rivals: ModelSelector, swing: Prediction, lash: Prediction) -> None:
    """A window of a shaft that stands at 0, in which both predict at each time they are asked."""
    rivals.begin()
    for k in range(0, EVEN.size, 2):
        edges = np.array((EVEN[k : k + 2], np.zeros(2)))
        rivals.judge(edges, GAP_RAD)
        if rivals.is_due(float(EVEN[k + 1])):
            rivals.predict(float(EVEN[k + 1]), swing, lash)
    rivals.end()


def test_a_backlash_doubted_however_often_is_tried_again_after_four_windows() -> None:
    good, bad = Prediction(0.0, 0.3 * GAP_RAD), Prediction(3.0 * GAP_RAD, 0.3 * GAP_RAD)
    rivals = ModelSelector()
    for _ in range(3):
        judged(rivals, good, bad)
    tried = []
    for _ in range(4):
        rivals.begin()
        rivals.end()
        tried.append(rivals.lash_is_candidate)
    assert tried == [False, False, False, True]


def test_backlash_is_believed_after_some_windows_and_forgotten_where_it_fails() -> None:
    good, bad = Prediction(0.0, 0.3 * GAP_RAD), Prediction(3.0 * GAP_RAD, 0.3 * GAP_RAD)
    rivals = ModelSelector()
    for window in range(1, 5):
        judged(rivals, bad, good)
        assert rivals.lash_is_selected is (window >= LEAST_WINDOWS)
    for _ in range(4):
        judged(rivals, good, bad)
    assert not rivals.lash_is_selected
    assert not rivals.lash_is_candidate
    other = ModelSelector()
    other.restore(True)
    assert other.lash_is_selected
    other.restore(False)
    assert not other.lash_is_selected
    assert other.lash_is_candidate


def test_predictions_are_asked_for_one_step_after_another() -> None:
    rivals = ModelSelector()
    assert rivals.is_due(0.0)
    rivals.predict(0.0, Prediction(0.0, 1.0), Prediction(0.0, 1.0))
    assert not rivals.is_due(EACH_US - 1.0)
    assert rivals.is_due(EACH_US)
    rivals.begin()
    assert rivals.is_due(0.0)
