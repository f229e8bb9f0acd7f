"""Sensors of another make: the gap high instead of low, one polarity alone, speed that changes by
more than was assumed. A tooth is right, or said to be in doubt or lost."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from turning import LEAD_US, Seen, Turning, run

CRANKED_RAD_S2 = 150.0
WRONG = 0.45
STEP_S = 2e-5
WHEELS = [(36, (34, 35)), (60, (58, 59)), (36, (17, 34, 35)), (36, (15, 16, 34, 35))]


@dataclass(frozen=True)
class Kicked:
    """A wheel at a steady speed that after two turns is driven hard for 30 ms and braked again."""

    teeth: int
    missing: tuple[int, ...]
    rad_s: float
    rad_s2: float
    place: int
    """Tooth at which it begins."""

    def trajectory(self) -> tuple[np.ndarray, np.ndarray]:
        """Times, and the angle in pitches."""
        pitch = 2.0 * math.pi / self.teeth
        begin_s = (2 * self.teeth + self.place + 0.3) * pitch / self.rad_s
        time_s = np.arange(0.0, begin_s + 0.24 + 2.6 * math.pi / self.rad_s, STEP_S)
        since = (time_s - begin_s) % 0.12
        kicked = (time_s >= begin_s) & (time_s < begin_s + 0.24)
        bend = np.where(kicked, np.where(since < 0.03, self.rad_s2, -self.rad_s2 / 3.0), 0.0)
        speed = self.rad_s + np.cumsum(bend) * STEP_S
        return time_s, np.cumsum(speed) * STEP_S / pitch

    def seen(self, polarities: str) -> tuple[Seen, np.ndarray]:
        """What the gate makes of it, and how far each edge lies from its tooth, pitches.

        polarities: "both", "rising", "falling", or "inverted": the gap is high, and a tooth begins
        with its falling edge."""
        time_s, angle = self.trajectory()
        rng = np.random.default_rng(self.place)
        halves = []
        for share in (0.0, 0.5):
            tooth = np.arange(1, int(angle[-1]))
            tooth = tooth[~np.isin(tooth % self.teeth, self.missing)]
            at = np.interp(tooth + share, angle, time_s) + rng.normal(0.0, 5e-6, tooth.size)
            halves.append([t for t in at.tolist() if t < time_s[-1]])
        rise, fall = halves
        motion = Turning(self.teeth, 0.5, 1.0, 0.0, float(time_s[-1]), self.missing)
        if polarities == "inverted":
            rise, fall = fall, rise
        elif polarities != "both":
            rise, fall = (rise, []) if polarities == "rising" else ([], rise)
        seen = run(motion, rise, fall, CRANKED_RAD_S2)
        true = np.interp((np.array(seen.time_us) - LEAD_US) * 1e-6, time_s, angle)
        # Where teeth begin with the falling edge, its place is a duty share on.
        begins = 0.5 if polarities in ("inverted", "falling") else 0.0
        off = np.array(seen.place) - begins - true
        return seen, (off + self.teeth / 2) % self.teeth - self.teeth / 2


@pytest.mark.parametrize(("teeth", "missing"), WHEELS)
@pytest.mark.parametrize("polarities", ["both", "inverted", "rising", "falling"])
def test_a_wheel_locks_whatever_its_sensor_shows(
    teeth: int, missing: tuple[int, ...], polarities: str
) -> None:
    """Whichever edge ends the gap: all teeth behind a few turns have the drawing's numbers."""
    seen, off = Kicked(teeth, missing, 60.0, 0.0, 0).seen(polarities)
    assert seen.edges is not None
    assert np.abs(off).max() < 0.02
    assert seen.edges.health.counting
    assert seen.edges.broken == 0
    half = 0.5 if polarities in ("rising", "falling") else 1.0
    assert len(seen.time_us) > half * 0.4 * 2 * 3.2 * (teeth - len(missing))


@pytest.mark.parametrize("polarities", ["both", "inverted", "rising"])
@pytest.mark.parametrize(("teeth", "missing"), WHEELS)
@pytest.mark.parametrize(
    "rad_s2", [500.0, *(pytest.param(each, marks=pytest.mark.check) for each in (200.0, 330.0))]
)
def test_hard_acceleration_makes_no_true_edge_an_extra_one(
    teeth: int, missing: tuple[int, ...], rad_s2: float, polarities: str
) -> None:
    """300 rad/s2 are assumed. A tooth that comes early was called extra, and the teeth behind it
    were numbered one too low up to the gap."""
    doubts = 0
    for rad_s in (18.0, 25.0, 40.0):
        for place in (0, teeth - 6, teeth - 4, teeth - 2, teeth - 1):
            seen, off = Kicked(teeth, missing, rad_s, rad_s2, place).seen(polarities)
            assert seen.edges is not None
            assert np.abs(off).max(initial=0.0) < WRONG, (rad_s, place)
            doubts += seen.edges.health.doubts
    if rad_s2 > 300.0:
        assert doubts > 0


@pytest.mark.parametrize("polarities", ["both", "rising"])
def test_a_doubt_over_an_early_edge_ends_in_the_right_numbers(polarities: str) -> None:
    """Said and counted; behind the next gap the teeth have their numbers, and none was lost."""
    doubtful = 0
    for place in range(30, 36):
        seen, off = Kicked(36, (34, 35), 22.0, 330.0, place).seen(polarities)
        assert seen.edges is not None
        health = seen.edges.health
        if health.doubts and not seen.edges.broken:
            doubtful += 1
            assert health.counting
            assert health.extra == 0
            assert np.abs(off).max() < WRONG
    assert doubtful >= 2


def test_one_polarity_of_a_whole_wheel_is_enough() -> None:
    """Falling edges alone, as of an inductive sensor: numbered like rising ones."""
    for polarities in ("rising", "falling"):
        seen, off = Kicked(45, (), 60.0, 0.0, 0).seen(polarities)
        assert seen.edges is not None
        assert seen.edges.broken == 0
        assert np.ptp(off) < 0.02
        assert len(seen.time_us) > 80
