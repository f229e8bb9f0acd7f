"""The guard's own sensor clock: drift, late frames, restarts."""

from __future__ import annotations

import pytest

from meshpoint.controller.guard.own_clock import GuardClock

CYCLE_US = 10_000


class Heard:
    """A clock that hears a frame each 10 ms; the sensors' clock is `ahead_us` of the controller's,
    and frames take `delay_us`."""

    def __init__(self, ahead_us: int = 1 << 32) -> None:
        self.clock, self.ahead_us, self.now_us = GuardClock(), ahead_us, 0

    def run(self, cycles: int, delay_us: int = 3_000) -> None:
        for _ in range(cycles):
            self.now_us += CYCLE_US
            self.clock.hear(self.now_us + self.ahead_us - delay_us, self.now_us)

    @property
    def error_us(self) -> int:
        """What it says less the sensors' time."""
        said_us = self.clock.now_us(self.now_us)
        assert said_us is not None
        return said_us - self.now_us - self.ahead_us


def test_before_the_first_frame_there_is_no_time() -> None:
    assert GuardClock().now_us(5) is None


def test_it_is_behind_by_the_least_delay() -> None:
    heard = Heard()
    heard.run(50, delay_us=9_000)
    assert heard.error_us == -9_000
    heard.run(1, delay_us=300)
    heard.run(250, delay_us=9_000)
    assert heard.error_us == -300


@pytest.mark.parametrize("late_us", [60_000, 700_000, 2_500_000])
def test_frames_that_come_late_are_old_and_do_not_hold_the_clock_back(late_us: int) -> None:
    """A node that hung: for four seconds its frames come late."""
    heard = Heard()
    heard.run(100)
    heard.now_us += late_us - 3_000
    for _ in range(400):
        heard.run(1, delay_us=late_us)
        assert heard.error_us == -3_000
    heard.run(100)
    assert heard.error_us == -3_000


@pytest.mark.parametrize("step_us", [-2_000_000, -300_000, -40_000, 30_000, 400_000, 2_000_000])
def test_a_clock_that_steps_is_followed_at_once(step_us: int) -> None:
    heard = Heard()
    heard.run(300)
    heard.ahead_us += step_us
    heard.run(1)
    assert heard.error_us == -3_000


@pytest.mark.parametrize("ppm", [-200, 200])
def test_drift_is_followed(ppm: int) -> None:
    heard = Heard()
    for _ in range(2_000):
        heard.run(1)
        heard.ahead_us += 2 if ppm > 0 else -2
    assert abs(heard.error_us + 3_000) <= 1_200  # six seconds of it
