"""The plan by which the engine's torque is taken away."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from meshpoint.controller.models.twist import Twist, TwistFigures
from meshpoint.controller.shift.engine import Band, unload

DECAY_S = 0.1
LEFT_NM = 2_730.0


def swings_down() -> Any:
    """A driveline whose swing dies away by itself, whatever the engine is asked for. To wait until
    t costs t, and 2 ms for each Nm that is left: least after 0.4 s."""
    return SimpleNamespace(
        state=np.eye(6)[0],
        left_nm=LEFT_NM * np.eye(5, 6),
        coasting_nm=0.0,
        within=lambda seconds: np.diag([math.exp(-seconds / DECAY_S), *np.ones(6)]),
    )


@pytest.mark.parametrize("step_ms", [5, 10, 20])
def test_it_looks_as_far_ahead_whatever_its_steps_are(step_ms: int) -> None:
    """Red before: of 5 ms it looked 0.3 s ahead, of 20 ms 1.2 s."""
    plan = unload(swings_down(), Band(0.0, 0.0), 1e-3 * step_ms, 1, None)
    assert plan is not None
    assert step_ms * (plan.steps - 1) == 400
    assert plan.left_nm == pytest.approx(LEFT_NM * math.exp(-1e-3 * step_ms * plan.steps / DECAY_S))


STEP_S = 0.01
PARTING = 6
UPHILL = TwistFigures(
    ratio=13.3, geared_kgm2=620.0, released_kgm2=8.0, constant_nm=-130.0, shaft_nm_rad=2e4,
    shaft_nms=10.0, wheels_kgm2=16.0, tyre_nm_rad=9e4, tyre_nms=60.0, fading=2.5,
    vehicle_inverse=1 / 1400, hill_rad_s2=-4.3, lag_s=0.06,
)  # fmt: skip
"""The second gear from below of a truck of 37 t, 8 % uphill."""
OWN_NM = 460.0
CARRIED_NM = UPHILL.ratio * OWN_NM + UPHILL.constant_nm


def sets_off_after_s(planned: Band, allowed: Band) -> float:
    """How long it takes until the clutch may set off where it is planned within one band, and what
    is asked for is held within another."""
    tyre_rad = CARRIED_NM / UPHILL.tyre_nm_rad
    state = np.array((0, CARRIED_NM / UPHILL.shaft_nm_rad, 2.5 * tyre_rad, tyre_rad, OWN_NM, 1.0))
    before = None
    for k in range(200):
        twist = Twist(UPHILL, state)
        plan = unload(twist, planned, STEP_S, PARTING, before)
        assert plan is not None
        assert planned.least_nm - 1e-6 <= plan.torque_nm <= planned.most_nm + 1e-6
        if plan.steps <= PARTING:
            return STEP_S * k
        asked = min(max(plan.torque_nm, allowed.least_nm), allowed.most_nm)
        state, before = (twist.within(STEP_S) @ np.append(state, asked))[:-1], plan.steps
    return math.inf


def test_a_plan_counts_on_no_torque_that_may_not_be_asked_for() -> None:
    """Red before: uphill it counted on the torque with which the engine coasts, far beyond none,
    and went on waiting for it."""
    allowed = Band(-12.5, OWN_NM)
    coasting_nm = Twist(UPHILL, np.zeros(6)).coasting_nm
    assert coasting_nm < -150.0
    waited_s = sets_off_after_s(Band(coasting_nm, OWN_NM), allowed)
    assert sets_off_after_s(allowed, allowed) < min(0.45, 0.75 * waited_s)
