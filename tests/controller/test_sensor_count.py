"""The sensor's running number across losses: by how many teeth a wheel can have been renumbered."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wheel import READ_US, capture

from meshpoint.controller.measure.clock import SensorClockEstimate
from meshpoint.controller.measure.wheel_edges import SLACK, SensorCount, WheelEdges
from meshpoint.dbc.messages import EdgesMainFall, EdgesMainRise

TEETH, DUTY, START_US = 45, 0.5, 1 << 20
PITCHES_A_RPM = TEETH / 60.0
PITCHES_A_RAD = TEETH / (2.0 * math.pi)


@dataclass
class Trajectory:
    """A wheel's angle in pitches, piece by piece, and what its sensor sees of it."""

    at_s: float = 0.0
    angle: float = 0.3
    rise_s: list[float] = field(default_factory=list)
    fall_s: list[float] = field(default_factory=list)
    pieces: list[tuple[float, float, float, float]] = field(default_factory=list)

    def go(self, pitches: float, from_: float, to: float) -> None:
        """So far at speeds that change evenly, pitches/s; turning back where it is negative."""
        sign, far = math.copysign(1.0, pitches), abs(pitches)
        bend, begin = (to * to - from_ * from_) / (2.0 * far), self.angle
        least = math.floor(min(begin, begin + pitches)) - 1
        for k in range(2 * least, 2 * (least + math.ceil(far) + 3)):
            passed = (k / 2.0 - begin) * sign
            if 0.0 < passed <= far:
                after = 2.0 * passed / (from_ + math.sqrt(from_**2 + 2.0 * bend * passed))
                is_rise = (k % 2 == 0) == (sign > 0)
                (self.rise_s if is_rise else self.fall_s).append(self.at_s + after)
        lasts = 2.0 * far / (from_ + to)
        self.pieces.append((self.at_s, begin, sign * from_, sign * bend))
        self.at_s, self.angle = self.at_s + lasts, begin + pitches

    def stand(self, for_s: float) -> None:
        self.pieces.append((self.at_s, self.angle, 0.0, 0.0))
        self.at_s += for_s

    def true(self, time_s: float) -> float:
        since, angle, rate, bend = next(p for p in reversed(self.pieces) if p[0] <= time_s)
        return angle + rate * (time_s - since) + 0.5 * bend * (time_s - since) ** 2


def watched(
    trajectory: Trajectory,
    deaf_s: tuple[float, float] = (0.0, 0.0),
    blind: bool = False,
    first: int = 1,
) -> tuple[WheelEdges, list[int]]:
    """The wheel after all frames, and by how much it counts ahead in each part between losses.
    deaf_s: while no frame comes, or, blind, while the sensor sees nothing; first: where the sensor
    has begun to count."""

    def times(edges_s: list[float]) -> list[int]:
        seen = [t for t in edges_s if not (blind and deaf_s[0] < t < deaf_s[1])]
        before = [START_US - 100_000 * k for k in range(27, 0, -1)]
        return before + sorted({START_US + round(t * 1e6) for t in seen})

    rise, fall = times(trajectory.rise_s), times(trajectory.fall_s)
    wheel, clock = WheelEdges(TEETH, DUTY), SensorClockEstimate()
    ahead: list[int] = []
    for read_us in range(START_US, START_US + round(trajectory.at_s * 1e6), READ_US):
        if not blind and deaf_s[0] < (read_us - START_US) * 1e-6 < deaf_s[1]:
            continue
        risen = EdgesMainRise(**capture(rise, first, read_us))
        fallen = EdgesMainFall(**capture(fall, first, read_us))
        batch = wheel.read([risen], [fallen], clock, read_us)
        if batch.time_us.size:
            place = float(batch.tooth[-1]) + DUTY * float(batch.falling[-1])
            now = round(place - trajectory.true((float(batch.time_us[-1]) - START_US) * 1e-6))
            if not ahead or len(ahead) <= wheel.broken:
                ahead.append(now)
            assert ahead[-1] == now
    return wheel, ahead


SLOW_RAD_S = math.sqrt(6.0 * 300.0 * 2.0 * math.pi / TEETH)
"""Below it a wheel counts as stopping."""
RPM = st.floats(300.0, 1500.0)
BRAKED = st.floats(60.0, 250.0)


@settings(max_examples=25, deadline=None)
@given(
    rpm=RPM, braked_rad_s2=BRAKED, stands_s=st.floats(0.1, 1.0), back=st.floats(0.0, 60.0),
    then_rpm=RPM, driven_rad_s2=BRAKED, first=st.integers(65_300, 65_600),
)  # fmt: skip
def test_a_wheel_that_stopped_was_renumbered_by_no_more_than_it_was_counted(
    rpm: float, braked_rad_s2: float, stands_s: float, back: float, then_rpm: float,
    driven_rad_s2: float, first: int,
) -> None:  # fmt: skip
    """However far it turned back while it was slow; and the bounds are as near as the edges of the
    stop allow: two for each, and some slack."""
    trajectory, rate, then = Trajectory(), rpm * PITCHES_A_RPM, then_rpm * PITCHES_A_RPM
    trajectory.go(60.0, rate, rate)
    trajectory.go(rate**2 / (2.0 * braked_rad_s2 * PITCHES_A_RAD), rate, 0.0)
    trajectory.stand(stands_s)
    if back > 0.1:
        trajectory.go(-back / 2.0, 0.0, 30.0)
        trajectory.go(-back / 2.0, 30.0, 0.0)
        trajectory.stand(0.1)
    trajectory.go(then**2 / (2.0 * driven_rad_s2 * PITCHES_A_RAD), 0.0, then)
    trajectory.go(30.0, then, then)
    wheel, ahead = watched(trajectory, first=first)
    assert wheel.broken >= 1
    renumbered = wheel.sensor.renumbered
    assert renumbered.uncounted == 0
    assert renumbered.least <= ahead[0] - ahead[-1] <= renumbered.most
    slow = SLOW_RAD_S**2 / 2.0 * (1.0 / braked_rad_s2 + 1.0 / driven_rad_s2) * PITCHES_A_RAD
    edges = 1.3 * slow + 20.0 + 2.0 * back
    assert renumbered.most - renumbered.least <= 2.0 * edges + 2 * SLACK * wheel.broken


@settings(max_examples=25, deadline=None)
@given(
    rpm=st.floats(600.0, 2400.0), deaf_s=st.floats(0.12, 0.35), first=st.integers(64_000, 66_000)
)
def test_lost_frames_of_a_wheel_that_had_no_time_to_stop_cost_no_tooth(
    rpm: float, deaf_s: float, first: int
) -> None:
    trajectory, rate = Trajectory(), rpm * PITCHES_A_RPM
    trajectory.go(0.8 * rate, rate, rate)
    wheel, ahead = watched(trajectory, (0.2, 0.2 + deaf_s), first=first)
    assert wheel.broken >= 1
    renumbered = wheel.sensor.renumbered
    assert renumbered.uncounted == 0
    assert renumbered.least <= ahead[0] - ahead[-1] <= renumbered.most
    assert renumbered.most - renumbered.least == 2 * SLACK * wheel.broken


@settings(max_examples=25, deadline=None)
@given(
    rpm=st.floats(300.0, 900.0), then_rpm=st.floats(300.0, 900.0), back=st.floats(5.0, 20.0),
    hard_rad_s2=st.floats(200.0, 299.0),
)  # fmt: skip
def test_lost_frames_of_a_wheel_that_stopped_and_turned_back_meanwhile_hide_no_tooth(
    rpm: float, then_rpm: float, back: float, hard_rad_s2: float
) -> None:
    """As fast as a shaft can: the count then allows for two teeth an edge."""
    trajectory, rate, then = Trajectory(), rpm * PITCHES_A_RPM, then_rpm * PITCHES_A_RPM
    bend = hard_rad_s2 * PITCHES_A_RAD
    trajectory.go(60.0, rate, rate)
    since_s = trajectory.at_s - 0.02
    trajectory.go(rate**2 / (2.0 * bend), rate, 0.0)
    trajectory.go(-back / 2.0, 0.0, math.sqrt(bend * back))
    trajectory.go(-back / 2.0, math.sqrt(bend * back), 0.0)
    trajectory.go(then**2 / (2.0 * bend), 0.0, then)
    until_s = trajectory.at_s + 0.02
    trajectory.go(60.0, then, then)
    wheel, ahead = watched(trajectory, (since_s, until_s))
    renumbered = wheel.sensor.renumbered
    assert renumbered.uncounted == 0
    assert renumbered.least <= ahead[0] - ahead[-1] <= renumbered.most


@pytest.mark.parametrize("rpm", [400.0, 1400.0])
def test_what_a_blind_sensor_has_not_counted_is_not_said(rpm: float) -> None:
    trajectory, rate = Trajectory(), rpm * PITCHES_A_RPM
    trajectory.go(0.8 * rate, rate, rate)
    wheel, ahead = watched(trajectory, (0.2, 0.4), blind=True)
    assert wheel.broken == 1
    assert ahead[0] != ahead[-1], "it would be wrong"
    assert wheel.sensor.renumbered.uncounted == 1


def test_a_sensor_that_was_powered_up_anew_has_not_counted_on() -> None:
    """Its clock may go on where it was; that its frames are not full yet gives it away."""
    trajectory, rate = Trajectory(), 1400.0 * PITCHES_A_RPM
    trajectory.go(0.8 * rate, rate, rate)
    wheel, _ = watched(trajectory)
    assert wheel.sensor.renumbered.uncounted == 0
    later_us = START_US + 900_000
    edges = [later_us - 9_000 + 950 * k for k in range(9)]
    risen = EdgesMainRise(**capture(edges, 1, later_us))
    wheel.read([risen], [], SensorClockEstimate(), later_us)
    assert wheel.sensor.renumbered.uncounted == 1


def test_too_long_without_frames_is_not_said_either() -> None:
    trajectory, rate = Trajectory(), 1400.0 * PITCHES_A_RPM
    trajectory.go(6.5 * rate, rate, rate)
    wheel, _ = watched(trajectory, (0.3, 5.6))
    assert wheel.broken == 1
    assert wheel.sensor.renumbered.uncounted >= 1


def test_of_a_wheel_with_missing_teeth_nothing_is_said() -> None:
    wheel = WheelEdges(60, DUTY, (58, 59))
    wheel.sensor.counting(5, 0, START_US, 1.0)
    wheel.sensor.lost()
    assert wheel.sensor.renumbered.uncounted == 1


LEAST_RATE, BEND = 1e-4, 1e-10
"""From and to the least speed (teeth/us) a stop takes a second at this half acceleration."""


@pytest.mark.parametrize(
    ("falls", "after_us", "dragged", "renumbered"),
    [
        # Ten edges that may each have gone back: the tooth's number was 43 more, less two for each
        # of them, and three to spare.
        (10, 1_000_000, False, (43 - 20 - SLACK, 43 + SLACK, 0)),
        # Without time for a stop all of them have gone on; what is dragged may stop at once.
        (10, 999_999, False, (43 - SLACK, 43 + SLACK, 0)),
        (10, 20_000, True, (43 - 20 - SLACK, 43 + SLACK, 0)),
        # Polarities that have counted apart by more than three bound nothing.
        (13, 999_999, False, (43 - SLACK, 43 + SLACK, 0)), (14, 999_999, False, (0, 0, 1)),
    ],
)  # fmt: skip
def test_a_loss_counts_each_edge_of_it_as_one_on_or_back(
    falls: int, after_us: int, dragged: bool, renumbered: tuple[int, int, int]
) -> None:
    """Edge 1000 of the sensor was tooth 40, with two newer ones waiting; ten edges later the tooth
    called 7 has the number that would have been 50."""
    count = SensorCount(BEND, LEAST_RATE, True)
    for falling in (False, True):
        count.frame(falling, 1002, 27, 0)
    count.counting(40, 2, 0, LEAST_RATE)
    count.lost()
    if dragged:
        count.dragged()
    count.frame(False, 1012, 27, 20_000)
    count.frame(True, 1002 + falls, 27, 20_000)
    count.counting(7, 2, after_us, LEAST_RATE)
    assert count.renumbered[2] == renumbered[2]
    if not renumbered[2]:
        assert count.renumbered == renumbered
