"""Tooth patterns found again in another numbering. The wheels here are made: their true pattern is
known."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.controller.estimate.teeth import PatternEquations, ToothPattern, compare, turned
from meshpoint.units import DEG

TURN = 2.0 * math.pi
TEETH = 45
EDGE_SD = 0.05 * DEG
"""Of one measurement at an edge."""
FREE_SD = 2.0 * DEG


def pattern(rng: np.random.Generator, sd_rad: float = 0.06 * DEG) -> np.ndarray:
    errors = rng.normal(0.0, sd_rad, 2 * TEETH)
    return errors - errors.mean()


def seen(rng: np.random.Generator, errors: np.ndarray, measurements: int) -> PatternEquations:
    """Equations of this many measurements at each edge, the mean error not to be seen in them."""
    weight = measurements / EDGE_SD**2
    normal = weight * (np.eye(2 * TEETH) - np.full((2 * TEETH, 2 * TEETH), 0.5 / TEETH))
    means = errors + rng.normal(0.0, EDGE_SD / math.sqrt(measurements), 2 * TEETH)
    right = normal @ means
    scatter = (2 * TEETH) * (measurements - 1)
    return PatternEquations(
        normal, right, scatter + float(means @ right), 2.0 * TEETH * measurements
    )


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 1 << 30), teeth=st.integers(0, TEETH - 1), measurements=st.integers(2, 10)
)
def test_a_pattern_is_found_at_whatever_tooth_the_count_begins(
    seed: int, teeth: int, measurements: int
) -> None:
    rng = np.random.default_rng(seed)
    errors = pattern(rng)
    memory = ToothPattern(errors, 0.01 * DEG, 5000)
    verdict = compare(memory, seen(rng, turned(errors, teeth), measurements), FREE_SD, False)
    assert verdict is not None
    assert not verdict.stranger
    assert verdict.certain
    assert verdict.teeth == teeth


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1 << 30), measurements=st.integers(2, 10))
def test_a_wheel_without_a_pattern_is_never_certain(seed: int, measurements: int) -> None:
    """What was learned of an ideal wheel is noise, and so is what is seen of it."""
    rng = np.random.default_rng(seed)
    memory = ToothPattern(pattern(rng, 0.01 * DEG), 0.01 * DEG, 5000)
    verdict = compare(memory, seen(rng, np.zeros(2 * TEETH), measurements), FREE_SD, False)
    assert verdict is not None
    assert not verdict.certain
    assert not verdict.stranger


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1 << 30), measurements=st.integers(2, 10))
def test_another_wheel_is_never_taken_for_the_remembered_one(seed: int, measurements: int) -> None:
    rng = np.random.default_rng(seed)
    memory = ToothPattern(pattern(rng), 0.01 * DEG, 5000)
    verdict = compare(memory, seen(rng, pattern(rng), measurements), FREE_SD, False)
    assert verdict is not None
    assert not verdict.certain
    assert verdict.stranger or measurements < 4


def test_less_than_two_turns_of_the_wheel_say_nothing() -> None:
    rng = np.random.default_rng(1)
    errors = pattern(rng)
    few = seen(rng, errors, 2)._replace(edges=4.0 * TEETH - 1)
    assert compare(ToothPattern(errors, 0.01 * DEG, 1), few, FREE_SD, False) is None


def test_missing_teeth_leave_one_turn_only() -> None:
    """Then even a wheel without pattern errors has its numbers, and a stranger is seen as one."""
    rng = np.random.default_rng(1)
    nothing = np.zeros(2 * TEETH)
    ideal = ToothPattern(nothing, 0.01 * DEG, 1)
    same = compare(ideal, seen(rng, nothing, 4), FREE_SD, True)
    other = compare(ideal, seen(rng, pattern(rng), 4), FREE_SD, True)
    assert same is not None
    assert other is not None
    assert (same.certain, same.teeth) == (True, 0)
    assert other.stranger
