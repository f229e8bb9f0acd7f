"""Models of a shaft's motion as they are written down, number by number."""

from __future__ import annotations

import math

import numpy as np

from meshpoint.controller.motion.models import (
    WALK_RAD_S2,
    diagonal,
    first_order_law,
    following_motion,
    state_of,
)


def test_a_law_of_the_first_order_is_one_segment_a_direction() -> None:
    """b = 1/tau whatever the valve does; r none or b times the supply. The other five segments
    begin nowhere, and would hold a pressure that is none."""
    law = first_order_law(20.0, 8e5)
    assert law.shape == (2, 6, 3)
    assert law[0, 0].tolist() == [-math.inf, 20.0, 0.0]
    assert law[1, 0].tolist() == [-math.inf, 20.0, 1.6e7]
    assert law[:, 1:].reshape(10, 3).tolist() == [[math.inf, 1.0, 0.0]] * 10


def test_a_shaft_that_something_unknown_drives_has_no_friction_no_brake_and_no_supply() -> None:
    """Its accelerations of 60 rad/s2 last 10 ms: density 2 sigma^2 / tau; what wanders is the
    steady one. A pressure, were there one, would fade in a second and wander by 1 Pa."""
    model = following_motion(60.0, 0.01, 50.0)
    assert model.flat[:3].tolist() == [0.0, 0.0, 100.0]
    assert np.array_equal(model.part("segments"), first_order_law(1.0, 0.0))
    assert model.flat[-4:].tolist() == [2.0 * 60.0**2 * 100.0, 1.0, 0.0, 2500.0]
    assert WALK_RAD_S2 == 50.0


def test_a_filter_s_state_tells_nothing_of_edges_to_come() -> None:
    assert state_of(np.ones(6), diagonal(*[1.0] * 6), 0.0).edge_rad2_s == 0.0
