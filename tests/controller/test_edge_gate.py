"""Whatever a sensor adds or leaves out: an edge's tooth is right, or it is said to be lost."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from turning import LEAD_US, Seen, Turning, run

MOST_RAD_S2 = 300.0
TEETH = 45
JITTER_S = 8e-6
WRONG = 0.45
"""An edge nearer than this to its tooth, in pitches, has the right one."""


@st.composite
def motions(draw: st.DrawFn, missing: tuple[int, ...] = ()) -> Turning:
    """500 to 2,400 rpm, braked or driven as hard as the gearbox can."""
    pitch = 2.0 * math.pi / TEETH
    rate = draw(st.floats(52.0, 250.0)) / pitch
    bend = draw(st.floats(-MOST_RAD_S2, MOST_RAD_S2)) / pitch
    duty = draw(st.floats(0.35, 0.65))
    return Turning(TEETH, duty, rate, bend, 0.3, missing)


def edges_with_jitter(motion: Turning, seed: int) -> list[dict[int, float]]:
    """Both polarities by tooth: pitch errors of 0.1 deg, jitter."""
    rng = np.random.default_rng(seed)
    errors = rng.uniform(-0.1, 0.1, (2, TEETH)) / 360.0 * TEETH
    return [
        {
            k: t
            + errors[falling, k % TEETH] / (motion.rate + motion.bend * t)
            + JITTER_S * float(rng.standard_normal())
            for k, t in motion.edges(falling).items()
        }
        for falling in (0, 1)
    ]


def see(motion: Turning, rise: dict[int, float], fall: dict[int, float], extra_s: list) -> Seen:
    rise_s, fall_s = list(rise.values()), list(fall.values())
    for falling, at_s in extra_s:
        (fall_s if falling else rise_s).append(at_s)
    return run(motion, rise_s, fall_s, MOST_RAD_S2)


FAULTS = st.lists(
    st.tuples(
        st.sampled_from(["missing", "tooth", "extra", "pulse", "double", "burst"]),
        st.integers(0, 1),
        st.floats(0.0, 1.0),
        st.floats(0.0, 1.0),
    ),
    max_size=8,
)


def apply(faults: list, motion: Turning, edges: list[dict[int, float]]) -> list[tuple[int, float]]:
    """Takes edges away; returns the extra ones."""
    extra: list[tuple[int, float]] = []
    for kind, falling, when, much in faults:
        teeth = sorted(edges[falling])
        if not teeth:
            continue
        tooth = teeth[int(when * (len(teeth) - 1))]
        at = edges[falling][tooth]
        if kind == "missing":
            del edges[falling][tooth]
        elif kind == "tooth":
            for polarity in (0, 1):
                edges[polarity].pop(tooth, None)
        elif kind == "extra":
            extra.append((falling, motion.until_s * when))
        elif kind == "pulse":
            at = motion.until_s * when
            extra += [(falling, at), (1 - falling, at + 1e-4 * (0.1 + much))]
        else:
            extra += [(falling, at + 60e-6 * k) for k in range(1, 2 if kind == "double" else 9)]
    return [(polarity, at) for polarity, at in extra if 0.0 < at < motion.until_s]


@settings(deadline=None, max_examples=150, derandomize=True)
@given(motion=motions(), faults=FAULTS, seed=st.integers(0, 99))
def test_a_tooth_is_right_or_declared_lost(motion: Turning, faults: list, seed: int) -> None:
    edges = edges_with_jitter(motion, seed)
    extra = apply(faults, motion, edges)
    seen = see(motion, *edges, extra)
    assert max(seen.teeth_wrong(motion), default=0.0) < WRONG


@settings(deadline=None, max_examples=60, derandomize=True)
@given(motion=motions((17, 43, 44)), faults=FAULTS, seed=st.integers(0, 99))
def test_on_a_wheel_with_missing_teeth_the_tooth_is_that_of_the_drawing(
    motion: Turning, faults: list, seed: int
) -> None:
    edges = edges_with_jitter(motion, seed)
    extra = apply(faults, motion, edges)
    seen = see(motion, *edges, extra)
    assert max(seen.teeth_wrong(motion), default=0.0) < WRONG
    if not faults and motion.angle(motion.until_s) > 3 * TEETH:
        assert seen.time_us


@pytest.mark.parametrize("kind", ["missing", "tooth", "extra", "pulse", "double", "burst"])
@pytest.mark.parametrize("falling", [0, 1])
@pytest.mark.parametrize("bend", [-300.0, 0.0, 100.0])
def test_one_fault_in_cruise_costs_no_tooth_number(kind: str, falling: int, bend: float) -> None:
    """Every true edge comes with its tooth, and nothing else does."""
    pitch = 2.0 * math.pi / TEETH
    motion = Turning(TEETH, 0.5, 150.0 / pitch, bend / pitch, 0.3)
    for share in (0.5, 0.52, 0.541, 0.57):
        edges = edges_with_jitter(motion, 7)
        extra = apply([(kind, falling, share, 0.3)], motion, edges)
        seen = see(motion, *edges, extra)
        assert seen.edges is not None
        assert seen.edges.broken == 0
        true_us = sorted(LEAD_US + round(t * 1e6) for half in edges for t in half.values())
        first_us, last_us = seen.time_us[0], seen.time_us[-1]
        true_us = [t for t in true_us if first_us <= t <= last_us]
        assert len(seen.time_us) == len(true_us)
        # An extra edge may stand for the true one that it is 7 % of a pitch or less away from.
        allowed_us = 90 if kind in ("extra", "pulse") else 0
        off_us = [abs(a - b) for a, b in zip(seen.time_us, true_us, strict=True)]
        assert max(off_us) <= allowed_us
        assert sum(off > 0 for off in off_us) <= 2


@pytest.mark.parametrize("place", [0.01, 0.05, 0.3, 0.6, 0.95])
def test_a_wheel_that_turns_back_has_lost_its_teeth(place: float) -> None:
    """Its edges come on as those of a wheel that turns on; the sensor cannot see the direction."""
    pitch = 2.0 * math.pi / TEETH
    bend = -MOST_RAD_S2 / pitch
    turning = 40.0 + place
    rate = math.sqrt(-2.0 * bend * turning)
    there = Turning(TEETH, 0.5, rate, bend, rate / -bend)
    rise, fall = there.edges(0), there.edges(1)
    top = rate / -bend
    # Back over the same teeth: each edge again, with the other polarity.
    back_rise = [2.0 * top - t for t in fall.values()]
    back_fall = [2.0 * top - t for t in rise.values()]
    motion = Turning(TEETH, 0.5, rate, bend, 2.0 * top)
    seen = run(motion, [*rise.values(), *back_rise], [*fall.values(), *back_fall], MOST_RAD_S2)
    assert seen.edges is not None
    assert seen.edges.broken >= 1
    last_us = LEAD_US + top * 1e6
    before = [part for t, part in zip(seen.time_us, seen.part, strict=True) if t < last_us]
    after = [part for t, part in zip(seen.time_us, seen.part, strict=True) if t > last_us]
    assert not after or min(after) > max(before)


def test_the_first_edges_after_power_up_are_not_believed() -> None:
    """A Hall sensor that finds its thresholds may misplace up to nine (ATS645)."""
    pitch = 2.0 * math.pi / TEETH
    motion = Turning(TEETH, 0.5, 150.0 / pitch, 0.0, 0.3)
    rng = np.random.default_rng(1)
    edges = [list(motion.edges(falling).values()) for falling in (0, 1)]
    wrong = [[t + 0.2 * rng.uniform(-1, 1) * pitch / 150.0 for t in half[:9]] for half in edges]
    rise, fall = (w + half[9:] for w, half in zip(wrong, edges, strict=True))
    seen = run(motion, rise, fall, MOST_RAD_S2, just_powered_up=True)
    assert max(seen.teeth_wrong(motion)) < 0.01
    assert len(seen.time_us) > 2 * (len(rise) - 12)


@pytest.mark.parametrize("silent", [3, 10])
def test_a_longer_silence_of_both_polarities_is_a_loss(silent: int) -> None:
    """The wheel may have been braked in it by more than a shaft can be, as when a dog engages."""
    pitch = 2.0 * math.pi / TEETH
    motion = Turning(TEETH, 0.5, 150.0 / pitch, 0.0, 0.3)
    edges = edges_with_jitter(motion, 3)
    for half in edges:
        for tooth in range(100, 100 + silent):
            half.pop(tooth)
    seen = see(motion, *edges, [])
    assert seen.edges is not None
    assert seen.edges.broken == 1
    assert max(seen.teeth_wrong(motion)) < WRONG
