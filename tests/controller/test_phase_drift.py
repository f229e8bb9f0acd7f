"""The drift of a gear's phase: learned from aimed contacts whose true drift is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from meshpoint.controller.calibration.learned import DriftRecords
from meshpoint.controller.planning.gear_predictor import GearPredictor
from meshpoint.controller.planning.phase_drift import (
    FAR_RAD_S,
    LEAST_SPREAD_SHARE,
    PhaseDrifts,
)
from meshpoint.gearbox import MainGear
from meshpoint.units import DEG
from tests.controller.test_strategy import GEAR, MAIN, SHEET, predictor_at


def fresh() -> PhaseDrifts:
    """Before any contact, half a newton metre of drag unknown."""
    return PhaseDrifts(SHEET, 0.5)


FIRED_US, SEEN_US, CONTACT_US = 0.0, 52_000.0, 58_000.0


def contact(drifts: PhaseDrifts, drift_rad_s: float, off_rad: float = 0.0) -> float:
    """One aimed contact of a gear that drifts from its model; the error of its prediction."""
    fired = replace(
        predictor_at(18.0),
        drift_rad_s=drifts.rad_s(GEAR),
        spread_share=drifts.spread_share(GEAR),
    )
    predicted, _ = fired.phase_and_slip(CONTACT_US)
    moved = drift_rad_s * (CONTACT_US - fired.main.time_us) * 1e-6 + off_rad
    drifts.learn(fired, _seen(fired, moved), CONTACT_US)
    undrifted, _ = replace(fired, drift_rad_s=0.0).phase_and_slip(CONTACT_US)
    return undrifted + moved - predicted


def _seen(fired: GearPredictor, moved_rad: float) -> GearPredictor:
    """The predictor just before contact, when the gear had moved so much more than its model."""
    state = fired.layshaft_at(SEEN_US, None)
    theta = state.theta_rad + moved_rad / fired.i_gear
    main = MAIN._replace(time_us=SEEN_US, theta_rad=MAIN.theta_at(SEEN_US))
    return replace(fired, layshaft=state._replace(theta_rad=theta), main=main, drift_rad_s=0.3)


@given(st.floats(-8.0, 8.0))
def test_a_steady_drift_is_known_after_some_contacts(drift_deg_s: float) -> None:
    drifts = fresh()
    first = contact(drifts, drift_deg_s * DEG)
    assert first == pytest.approx(drift_deg_s * DEG * CONTACT_US * 1e-6, abs=1e-9)
    for _ in range(14):
        last = contact(drifts, drift_deg_s * DEG)
    assert abs(last) <= 0.1 * abs(first) + 1e-9
    assert drifts.rad_s(MainGear.CRAWL) == 0.0


@pytest.mark.parametrize("share", [0.5, 1.0, 1.5])
def test_phases_are_foretold_to_scatter_by_what_they_have_scattered_by(share: float) -> None:
    """Contacts that scatter by a share of what the filters claim; 400 of them, seed 1."""
    drifts = fresh()
    claimed = math.sqrt(predictor_at(18.0).estimate_variance(CONTACT_US))
    scatter = np.random.default_rng(1).normal(0.0, share * claimed, 400)
    shares = []
    for off_rad in scatter.tolist():
        contact(drifts, 0.0, off_rad)
        shares.append(drifts.spread_share(GEAR))
    drawn = math.sqrt(np.mean(scatter[30:] ** 2)) / claimed
    assert np.mean(shares[30:]) == pytest.approx(drawn, rel=0.1)


def test_steady_phases_still_scatter_by_a_little() -> None:
    drifts = fresh()
    for _ in range(200):
        contact(drifts, 0.02)
    assert drifts.spread_share(GEAR) == LEAST_SPREAD_SHARE


@pytest.mark.parametrize("off_rad", [2.0 * FAR_RAD_S * 0.06, math.nan, math.inf])
def test_a_contact_that_no_drift_explains_teaches_nothing(off_rad: float) -> None:
    drifts = fresh()
    contact(drifts, 0.05)
    before = drifts.records()
    contact(drifts, 0.0, off_rad)
    assert drifts.records() == before


def test_what_was_learned_is_kept_and_taken_up_again() -> None:
    drifts, again = fresh(), fresh()
    assert drifts.records() == DriftRecords()
    for _ in range(5):
        contact(drifts, 0.06)
    again.restore(drifts.records())
    assert again.rad_s(GEAR) == pytest.approx(drifts.rad_s(GEAR))
    assert contact(again, 0.06) == pytest.approx(contact(drifts, 0.06))
    assert again.spread_share(GEAR) == pytest.approx(drifts.spread_share(GEAR))
