"""The main shaft in a downshift: followed from when the old gear is out until the new one is met,
whatever clutch and splitter do with the layshaft meanwhile."""

from __future__ import annotations

from typing import NamedTuple

import pytest

from benchmarks.shifts import make_shifts
from meshpoint.bench.setup import Setup
from meshpoint.bus.core import AroundCore, Step
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.messages import ControllerState
from meshpoint.gearbox import MainGear, load_sheet
from meshpoint.rig_sim.settings import Profile

SHEET = load_sheet("truck12")
HALF_GAP_RAD = 0.5 * SHEET.dog.backlash_rad
SHIFTS, LEARNED = 20, 6
AHEAD_US, SETTLED_US = 30_000, 100_000
RAISED = (ControllerState.SPEED_RAISING, ControllerState.CLUTCH_PARTING)


class Expected(NamedTuple):
    """An angle that the main shaft is expected to come to."""

    time_us: int
    angle_rad: float


class Watched(AroundCore[ControllerCore]):
    """Holds what is expected of the main shaft while the engine raises against what comes."""

    def __init__(self, core: ControllerCore) -> None:
        super().__init__(core)
        self._open, self._neutral_us = list[Expected](), 0
        self.off_rad = list[float]()

    def step(self, now_us: int) -> Step:
        step = self._core.step(now_us)
        snapshot = self._core.snapshot
        if snapshot is None or snapshot.main is None or self._core.shifts < LEARNED:
            self._open.clear()
            return step
        now_us, main, view = snapshot.now_us, snapshot.main, snapshot.view
        if view.main_gear is not MainGear.NEUTRAL or view.range_ is None:
            self._neutral_us = now_us
            self._open.clear()
            return step
        while self._open and self._open[0].time_us <= now_us:
            expected = self._open.pop(0)
            self.off_rad.append(abs(main.theta_at(expected.time_us) - expected.angle_rad))
        is_settled = now_us - self._neutral_us > SETTLED_US
        if self._core.sequence.state in RAISED and is_settled:
            then_us = now_us + AHEAD_US
            self._open.append(Expected(then_us, main.theta_at(then_us)))
        return step


@pytest.mark.parametrize(
    ("pair", "seeds", "least"),
    [((10, 8), (3,), 0.8), ((4, 2), (3,), 0.6), ((7, 5), (3, 4, 5), 0.45)],
)
def test_while_the_engine_raises_a_gear_it_is_known_where_the_main_shaft_will_be(
    pair: tuple[int, int], seeds: tuple[int, ...], least: float
) -> None:
    """30 ms ahead, within half a gap, from a tenth of a second in neutral on. From fourth to second
    the raise is over before the swing has died down: 0.66 of 14 shifts, whose share is 0.12 off by
    chance. Across the range gearboxes differ: 0.40, 0.48 and 0.73."""
    off = list[float]()
    for seed in seeds:
        setup = Setup(
            SHEET, ControllerSettings(), profile=Profile.TYPICAL, seed=seed, shifts=SHIFTS,
            pairs=(pair,),
        )  # fmt: skip
        watched = Watched(ControllerCore(setup.header))
        make_shifts(setup, watched)
        off += watched.off_rad
    assert len(off) > 40
    share = sum(each < HALF_GAP_RAD for each in off) / len(off)
    assert share > least
