"""What is said to be wrong with a wheel's edges is what is wrong with them, counted; and no more
edges are withheld than a doubt needs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from test_edge_gate import MOST_RAD_S2, TEETH, apply, edges_with_jitter, see
from turning import LEAD_US, Turning, run

PITCH = 2.0 * math.pi / TEETH
MISSING = (17, 43, 44)
COUNTED = {
    "nothing": (0, 0),
    "extra": (1, 0),
    "pulse": (2, 0),
    "double": (1, 0),
    "burst": (8, 0),
    "missing": (0, 1),
}
"""Edges too many and too few."""


def motion_of(missing: tuple[int, ...] = (), bend: float = 0.0, rad_s: float = 150.0) -> Turning:
    return Turning(TEETH, 0.5, rad_s / PITCH, bend / PITCH, 0.3, missing)


@pytest.mark.parametrize("kind", COUNTED)
@pytest.mark.parametrize("missing", [(), MISSING])
@pytest.mark.parametrize("falling", [0, 1])
def test_edges_too_many_and_too_few_are_counted_and_nothing_is_withheld_for_them(
    kind: str, missing: tuple[int, ...], falling: int
) -> None:
    motion = motion_of(missing)
    clean = see(motion, *edges_with_jitter(motion, 7), [])
    for share in (0.6, 0.655, 0.71):
        edges = edges_with_jitter(motion, 7)
        faults = [] if kind == "nothing" else [(kind, falling, share, 0.3)]
        seen = see(motion, *edges, apply(faults, motion, edges))
        assert seen.edges is not None
        extra, missed = COUNTED[kind]
        assert tuple(seen.edges.health) == (extra, missed, 0, 0, True)
        assert seen.edges.broken == 0
        assert len(seen.time_us) == len(clean.time_us) - missed


@pytest.mark.parametrize("teeth", [1, 2])
def test_a_tooth_that_is_broken_off_a_whole_wheel_is_counted_as_its_two_edges(teeth: int) -> None:
    motion = motion_of()
    edges = edges_with_jitter(motion, 7)
    for tooth in range(200, 200 + teeth):
        for half in edges:
            half.pop(tooth)
    seen = see(motion, *edges, [])
    assert seen.edges is not None
    assert tuple(seen.edges.health) == (0, 2 * teeth, 0, 0, True)
    assert max(seen.teeth_wrong(motion)) < 0.1


def test_a_hole_that_the_drawing_does_not_have_is_a_doubt_until_the_next_gap_shows_the_count() -> (
    None
):
    """Edges are withheld for that long, and then have their teeth again: a doubt, no loss."""
    motion = motion_of(MISSING)
    edges = edges_with_jitter(motion, 7)
    hole = next(k for k in sorted(edges[0]) if k > 200 and k % TEETH == 25)
    gone_us = 1e6 * edges[0][hole]
    for half in edges:
        half.pop(hole)
    seen = see(motion, *edges, [])
    assert seen.edges is not None
    health = seen.edges.health
    assert (health.extra, health.missed, health.doubts, health.stops) == (0, 0, 1, 0)
    assert health[4], "it counts again"
    assert seen.edges.broken == 0
    assert max(seen.teeth_wrong(motion)) < 0.1
    gaps = np.diff(seen.time_us)
    turn_us = 1e6 * 2.0 * math.pi / 150.0
    widest = int(np.argmax(gaps))
    assert seen.time_us[widest] - seen.time_us[0] < gone_us
    assert gaps[widest] < 1.1 * turn_us


@pytest.mark.parametrize("rad_s", [60.0, 150.0, 240.0])
@pytest.mark.parametrize("bend", [-100.0, 0.0, 250.0])
def test_a_wheel_is_counted_from_its_first_teeth_or_from_when_its_gaps_have_shown_where_it_is(
    rad_s: float, bend: float
) -> None:
    for missing in ((), MISSING):
        motion = Turning(TEETH, 0.5, rad_s / PITCH, bend / PITCH, 0.45, missing)
        edges = edges_with_jitter(motion, 5)
        seen = see(motion, *edges, [])
        assert seen.edges is not None
        assert tuple(seen.edges.health) == (0, 0, 0, 0, True)
        all_us = sorted(t for half in edges for t in half.values())
        first = motion.angle(1e-6 * (seen.time_us[0] - LEAD_US))
        if missing:
            assert TEETH < first < 2.5 * TEETH
        else:
            # A frame begins with the edge before it, of which nobody knows how long it took.
            assert first < 10.0 + 0.01 * motion.rate
        later = [t for t in all_us if motion.angle(t) >= first - 0.01]
        assert len(seen.time_us) == pytest.approx(len(later), abs=2)


def test_a_wheel_so_inexact_that_edges_change_places_is_not_counted_but_a_bad_one_is() -> None:
    """Errors of 8 % of a pitch are a bad wheel; of 40 % no wheel at all."""
    rng = np.random.default_rng(3)
    for share, counted in ((0.08, True), (0.4, False)):
        motion = motion_of()
        rise, fall = (
            [t + share * PITCH / 150.0 * rng.uniform(-1.0, 1.0) for t in half.values()]
            for half in (motion.edges(0), motion.edges(1))
        )
        seen = run(motion, rise, fall, MOST_RAD_S2)
        assert seen.edges is not None
        assert (seen.edges.broken == 0) is counted
        assert (len(seen.time_us) > 0.9 * (len(rise) + len(fall))) is counted


@pytest.mark.parametrize("missing", [(), MISSING])
def test_a_shaft_that_is_braked_to_a_stop_is_counted_until_it_might_have_stood(
    missing: tuple[int, ...],
) -> None:
    """Then the teeth are lost for having stopped, not for a doubt."""
    bend = -MOST_RAD_S2 / PITCH
    motion = Turning(TEETH, 0.5, 120.0 / PITCH, bend, 0.6, missing)
    rise, fall = (list(motion.edges(falling).values()) for falling in (0, 1))
    seen = run(motion, rise, fall, MOST_RAD_S2)
    assert seen.edges is not None
    health = seen.edges.health
    assert (health[0], health[1], health[2], health[3], health[4]) == (0, 0, 0, 1, False)
    counted = motion.angle(1e-6 * (seen.time_us[-1] - LEAD_US))
    assert 2.0 < motion.angle(0.6) - counted < 5.0, "it stops within three pitches"
