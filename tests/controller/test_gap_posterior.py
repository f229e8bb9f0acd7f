"""Where a gear's gap is, by measurements of a tooth that a driveline throws from flank to flank."""

from __future__ import annotations

import math

import normal_law
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.controller.estimate.reference import (
    MEASUREMENT_SHARES,
    GapPosterior,
    PhaseReferences,
)
from meshpoint.gearbox import MainGear, load_sheet
from meshpoint.gearbox.kinematics import wrap_to_pitch

SHEET = load_sheet("thesis")
PITCH, BACKLASH = SHEET.dog.pitch_rad, SHEET.dog.backlash_rad
SD = 0.1 * BACKLASH


def measurements(
    rng: np.random.Generator,
    middle: float,
    count: int,
    flanks: tuple[float, ...],
    sd: float = SD,
) -> np.ndarray:
    """Raw phases: the tooth stays at a flank for 50 ms, five measurements, or crosses the gap in
    one."""
    at = np.repeat(rng.choice(flanks, size=count // 5 + 1), 5)[:count] * BACKLASH / 2.0
    crossing = rng.random(count) < 0.2
    at[crossing] = rng.uniform(min(flanks), max(flanks), crossing.sum()) * BACKLASH / 2.0
    turned = PITCH * rng.integers(-50, 50, count)
    return np.asarray(middle + at + sd * rng.standard_normal(count) + turned)


def posterior(raw: np.ndarray, sd: float = SD) -> GapPosterior:
    found = GapPosterior(PITCH, BACKLASH)
    for phase in raw:
        found.measure(float(phase), sd)
    return found


def test_a_tooth_thrown_from_flank_to_flank_tells_its_gap_as_well_as_is_said() -> None:
    rng = np.random.default_rng(4)
    squares, most_rad = [], 0.0
    for _ in range(60):
        middle = rng.uniform(0.0, PITCH)
        found = posterior(measurements(rng, middle, 60, (-1.0, 1.0))).middle()
        assert found is not None
        off = wrap_to_pitch(found.raw_rad - middle, PITCH)
        squares.append((off / found.sd_rad) ** 2)
        most_rad = max(most_rad, found.sd_rad)
    assert np.mean(squares) < 2.0
    assert most_rad < 0.3 * BACKLASH


@pytest.mark.parametrize("flanks", [(1.0,), (-1.0,)])
def test_measurements_at_one_flank_alone_leave_two_middles(flanks: tuple[float, ...]) -> None:
    """One backlash apart, and alike: whichever is said, the deviation is that between them."""
    rng = np.random.default_rng(5)
    found = posterior(measurements(rng, 0.3 * PITCH, 400, flanks)).middle()
    assert found is not None
    assert 0.4 * BACKLASH < found.sd_rad < 0.8 * BACKLASH


@pytest.mark.parametrize("flank", [1, -1])
def test_the_slip_that_carried_the_tooth_tells_its_flank(flank: int) -> None:
    """Two measurements of a tooth carried there, and some more at the same place."""
    rng, middle = np.random.default_rng(7), 0.3 * PITCH
    raw = middle + flank * BACKLASH / 2.0 + SD * rng.standard_normal(40)
    found = GapPosterior(PITCH, BACKLASH)
    for k, phase in enumerate(raw):
        found.measure(float(phase), SD, flank if k < 2 else 0)
    shown = found.middle()
    assert shown is not None
    assert abs(wrap_to_pitch(shown.raw_rad - middle, PITCH)) < 0.1 * BACKLASH


@pytest.mark.parametrize("wider", [1.3, 1.6, 2.2])
def test_a_gap_wider_than_the_sheets_is_known_less_well(wider: float) -> None:
    """The likeliest middle is off then, and the deviation says so."""
    rng, squares = np.random.default_rng(6), []
    for _ in range(30):
        middle = rng.uniform(0.0, PITCH)
        found = posterior(measurements(rng, middle, 200, (-wider, wider))).middle()
        assert found is not None
        off = wrap_to_pitch(found.raw_rad - middle, PITCH)
        squares.append((off / found.sd_rad) ** 2)
    assert np.mean(squares) < 3.0


@settings(max_examples=100, deadline=None)
@given(
    share=st.floats(0.04, 0.4),
    sd_deg=st.floats(0.02, 2.0),
    lies=st.floats(-0.5, 0.5),
    count=st.integers(1, 60),
)
def test_whatever_was_seen_there_is_a_middle_and_a_deviation(
    share: float, sd_deg: float, lies: float, count: int
) -> None:
    """Also of small gaps and poor sensors: a tooth that was seen once has been in its gap."""
    backlash = share * PITCH
    found = GapPosterior(PITCH, backlash)
    sd = min(math.radians(sd_deg), MEASUREMENT_SHARES[-1] * backlash)
    for _ in range(count):
        assert found.measure(lies * backlash, sd)
    middle = found.middle()
    assert middle is not None
    off = abs(wrap_to_pitch(middle.raw_rad, PITCH))
    assert off <= backlash + 3.0 * middle.sd_rad
    assert 0.0 < middle.sd_rad <= PITCH / 2.0


def test_a_reference_is_known_after_one_engagement_on_a_driveline_that_swings() -> None:
    """The tooth never lies still for the measurements that a flank by itself would take, and these
    scatter too much for their lowest and highest to bound the gap."""
    rng, gear, middle = np.random.default_rng(8), MainGear.SECOND, 0.4 * PITCH
    references, ratio = PhaseReferences(SHEET), SHEET.main_mesh(gear).ratio
    references.locked(gear, 0.0)
    sd = 1.6 * SD
    for raw in measurements(rng, middle, 60, (-1.0, 1.0), sd):
        theta_main = 40.0 * rng.random()
        theta_layshaft = (raw + theta_main) / ratio
        references.measure(gear, theta_layshaft, theta_main, sd)
    assert references.settle(gear)
    phase = references.phase_rad(gear, 0.0, 0.0)
    assert abs(wrap_to_pitch(phase + middle, PITCH)) < 0.15 * BACKLASH
    references.lose_all()
    assert not references.settle(gear)


ROUND_PITCH, ROUND_BACKLASH, CELLS = 3.0, 0.625, 300
MIDDLES = ROUND_PITCH / CELLS * np.arange(CELLS)


def by_bayes(raw: np.ndarray, sd: float, flanks: tuple[int, ...]) -> tuple[float, float]:
    """Mean of the middles within 0.3 backlashes of the likeliest, and deviation of all from it. Of
    a measurement's phase from the middle 3 of 5 are at a flank, 1 of 50 is astray anywhere, the
    others are even over the gap, all blurred by its error; it reports a quarter of one alone.
    Those of a tooth that the slip has just carried to a flank are at that one in 49 of 50, and
    report each its own."""
    half, logs = ROUND_BACKLASH / 2.0, np.zeros(CELLS)
    for phase, carried in zip(raw, flanks, strict=False):
        off = wrapped(phase - MIDDLES)
        upper = (0.5, 0.98, 0.02)[carried]
        flank = upper * normal_law.pdf(off, half, sd) + (1.0 - upper) * normal_law.pdf(
            off, -half, sd
        )
        amid = (normal_law.cdf(off, -half, sd) - normal_law.cdf(off, half, sd)) / ROUND_BACKLASH
        density = 0.98 * (0.6 * flank + 0.4 * amid) + 0.02 / ROUND_PITCH
        logs += (1.0 if carried else 0.25) * np.log(density)
    weight = np.exp(logs - logs.max())
    best = MIDDLES[np.argmax(weight)]
    away = wrapped(MIDDLES - best)
    near = np.abs(away) < 0.3 * ROUND_BACKLASH
    mean = weight[near] @ away[near] / weight[near].sum()
    spread = math.sqrt(weight @ (away - mean) ** 2 / weight.sum())
    return float(best + mean), spread


def wrapped(phase: np.ndarray) -> np.ndarray:
    return np.asarray(phase - ROUND_PITCH * np.round(phase / ROUND_PITCH))


@pytest.mark.parametrize("slip", [0, 1, -1])
@pytest.mark.parametrize(
    "share", [0.17, *(pytest.param(each, marks=pytest.mark.check) for each in (0.1, 0.28))]
)
@pytest.mark.parametrize("cell", [5, 100, 290])
def test_the_middle_is_what_bayes_rule_makes_of_the_measurements(
    cell: int, share: float, slip: int
) -> None:
    """Measurement by measurement, at a flank, at the other and amid the gap, also at a pitch's end.
    Measurements lie on the cells, so that none is moved to the next one."""
    half = round(ROUND_BACKLASH / 2.0 / ROUND_PITCH * CELLS)
    flanks = (slip, slip, *[0] * 158)
    cells = cell + np.tile([-half, half, half, half // 3], 40)
    # From the second on: by one alone two middles are equally likely, where no slip tells.
    for count in (*range(2, 32), 160):
        raw, sd = MIDDLES[cells[:count] % CELLS], share * ROUND_BACKLASH
        middle, spread = by_bayes(raw, sd, flanks)
        seen = GapPosterior(ROUND_PITCH, ROUND_BACKLASH)
        for phase, flank in zip(raw, flanks, strict=False):
            assert seen.measure(float(phase), sd, flank)
        found = seen.middle()
        assert found is not None
        assert wrapped(np.array(found.raw_rad - middle)) == pytest.approx(0.0, abs=1e-9)
        # A middle half a pitch away may be taken on either side.
        assert found.sd_rad == pytest.approx(spread, rel=1e-4)
