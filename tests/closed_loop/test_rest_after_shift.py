"""TC1 carries no protection: requests that flood the bus are heeded no more often than the clutch
can open and close."""

from __future__ import annotations

from itertools import pairwise

from loop_bench import Loop

from meshpoint.bus.core import Step
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import TC1, RigFault, ShiftOutcome
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile

SHEET = load_sheet("truck12")
REST_US = round(1e6 * (SHEET.clutch.open_delay_s + SHEET.clutch.close_delay_s))
STEP_US = 10_000
WRAP = 1 << 32


class Flood:
    """Asks for two gears in turn, each step, from a time on."""

    def __init__(self, from_us: int, *gears: int) -> None:
        self._from_us, self._gears = from_us, gears
        self._transmitter = Transmitter(Node.BENCH)
        self.next_step_us, self.done = 0, False

    def receive(self, frame: object) -> None:
        pass

    def step(self, now_us: int) -> Step:
        self.next_step_us = now_us + STEP_US
        if now_us < self._from_us:
            return Step([], [])
        gear = self._gears[now_us // STEP_US % len(self._gears)]
        return Step([self._transmitter.encode(TC1(requested_gear=gear))], [])

    def shutdown(self, now_us: int) -> Step:
        return Step([], [])


class Flooded(Loop):
    def new_operator(self) -> Flood:  # type: ignore[override]
        return Flood(300_000, 8, 10)


def flooded() -> Flooded:
    return Flooded(sheet=SHEET, preset=Preset.TRUCK, profile=Profile.CLEAN, toward=10)


def test_requests_that_flood_the_bus_begin_a_shift_no_sooner_than_the_rest_after_one() -> None:
    """And as soon as it is over."""
    loop = flooded()
    loop.until(lambda: len(loop.outcomes) == 3, 10_000_000)
    assert len(loop.outcomes) == 3
    for before, after in pairwise(loop.outcomes):
        rested_us = (after.request_time_us - before.end_time_us) % WRAP
        assert rested_us >= REST_US
        assert rested_us <= REST_US + 5 * STEP_US


def test_a_sensor_clock_that_restarts_behind_lets_no_request_wait_until_it_is_where_it_was() -> (
    None
):
    """How long ago the last shift was, nobody knows then. It is a minute behind here; the next
    shift is under way as soon as the controller has its teeth and phases again."""
    loop = flooded()
    loop.until(lambda: loop.last(ShiftOutcome) is not None, 10_000_000)
    before = loop.outcomes[-1]
    loop.fault(RigFault.CLOCK_STEP, value=-60e6)
    began_us, shifts = loop.time.now_us, len(loop.outcomes)
    assert loop.until(lambda: len(loop.outcomes) > shifts, began_us + 2_000_000)
    behind_us = (before.end_time_us - loop.outcomes[-1].request_time_us) % WRAP
    assert 57_000_000 < behind_us < 60_000_000
