"""Clutch, engine and requests under the guard, against the rig's truth.

As in `test_guard_truth`: a sequence gone mad, once with the guard blind and once with it looking.
The plates' slip, the shafts' speeds and the sleeves are the rig's own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import pytest
from loop_bench import Loop

from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.header import RunHeader
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import (
    TC1,
    ClutchAction,
    ClutchCommand,
    ControllerState,
    ShiftResult,
    SleevesAux,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import Sleeve, load_sheet
from meshpoint.rig_sim.settings import Preset
from meshpoint.rig_sim.shared.sleeves import SleeveState
from meshpoint.rig_sim.truck import layout as at
from meshpoint.units import RPM

TRUCK12 = load_sheet("truck12")
OPEN, CLOSE = ClutchAction.OPEN, ClutchAction.CLOSE
ValveRequest = Callable[[int], tuple[ClutchAction, float | None, ValveName | None]]
"""Clutch, engine speed in rpm and sleeve valve that are commanded so long (us) after going mad."""


class MadCore(ControllerCore):
    """From a moment on it commands what `wish` says; the guard may be blind to it."""

    def __init__(self, header: RunHeader, wish: ValveRequest, guarded: bool) -> None:
        super().__init__(header)
        self.wish = wish
        self.mad_us: int | None = None
        self.rows: set[int] = set()
        guard, driveline = self._guarded.guard, self._guarded.driveline
        for judge, name in (
            (guard, "passes"),
            (driveline, "passes_clutch"),
            (driveline, "passes_engine"),
        ):
            setattr(judge, name, self._watched(judge, getattr(judge, name), guarded))

    def _watched(
        self, judge: Any, passes: Callable[..., bool], guarded: bool
    ) -> Callable[..., bool]:
        def measurement(*frame: Any) -> bool:
            passed = passes(*frame)
            if self.mad_us is not None and not passed:
                self.rows.add(judge.blocked_row)
            return passed or not guarded

        return measurement

    def _decide(self, requested: int | None, snapshot: StepSnapshot, events: list[str]) -> None:
        if self.mad_us is None:
            super()._decide(requested, snapshot, events)
            return
        sequence = self.sequence
        sequence.finished = sequence.decision = None
        clutch, engine_rpm, valve = self.wish(snapshot.now_us - self.mad_us)
        sequence.clutch = clutch
        sequence.engine_rad_s = None if engine_rpm is None else engine_rpm * RPM
        for other in ValveName:
            if other is not valve:
                self._board.off(other)
        if valve is not None and not self._board.command(valve).on:
            self._board.schedule(valve, True, snapshot.earliest_us, snapshot.now_us)


@dataclass
class Deed:
    """What a row forbids, from which gear, and how the rig says that it was done."""

    name: str
    row: int
    wish: ValveRequest
    harm: Callable[[Loop], bool]
    gear: int = 5
    lasts_us: int = 3_000_000
    asked: bool = False


def input_overspeeds(loop: Loop) -> bool:
    return bool(loop.world.truth.speeds_rad_s[0] > 1.02 * TRUCK12.limits.input_max_rad_s)


def plates_rub(loop: Loop) -> bool:
    """The clutch bites on more than 750 rpm with a gear in."""
    speeds = loop.world.plant.y.speed_rad_s
    slip = speeds[at.ENGINE] - loop.world.truth.speeds_rad_s[0]
    bites = loop.world.plant.y.clutch > loop.world.plant.p.plates.kiss
    locked = loop.world.truth.locked_gear != 0
    return bool(bites and locked and abs(slip) > 750.0 * RPM)


def closings(loop: Loop) -> int:
    actions = [message.action for message in loop.of(ClutchCommand)]
    return sum(a is OPEN and b is CLOSE for a, b in pairwise(actions))


def left_the_gear(loop: Loop) -> bool:
    states = [loop.world.truth.sleeve_state(s) for s in (Sleeve.FIRST_SECOND, Sleeve.CRAWL_THIRD)]
    return SleeveState.LOCKED not in states


def splitter_ways(loop: Loop) -> int:
    """How often the splitter's sleeve went through its middle."""
    sides = [message.sleeve_splitter_m[0] > 0.0 for message in loop.of(SleevesAux)]
    return sum(a is not b for a, b in pairwise(sides))


def flap(since_us: int) -> tuple[ClutchAction, None, None]:
    return (OPEN if since_us // 300_000 % 2 == 0 else CLOSE), None, None


def race(_: int) -> tuple[ClutchAction, float, None]:
    return CLOSE, 3305.0, None


def race_and_close(since_us: int) -> tuple[ClutchAction, float, None]:
    """The free engine to 2,300 rpm, then the clutch onto a gear at 1,463."""
    return (OPEN if since_us < 2_000_000 else CLOSE), 2300.0, None


def swing(since_us: int) -> tuple[ClutchAction, None, ValveName]:
    low = since_us // 120_000 % 2 == 0
    return OPEN, None, ValveName.SPLIT_LOW if low else ValveName.SPLIT_HIGH


def pull_out(since_us: int) -> tuple[ClutchAction, None, ValveName | None]:
    """Gear 5 is the main box's third: the valve of the crawl pulls it out."""
    return OPEN, None, ValveName.MAIN_CRAWL if since_us > 200_000 else None


DEEDS = [
    Deed("overspeed by TSC1", 14, race, input_overspeeds, lasts_us=8_000_000),
    Deed("closing onto slip", 15, race_and_close, plates_rub),
    Deed("clutch flapping", 16, flap, lambda loop: closings(loop) > 7, lasts_us=5_000_000),
    Deed("neutral unasked", 17, pull_out, left_the_gear, lasts_us=800_000),
    Deed(
        "splitter swinging", 18, swing, lambda loop: splitter_ways(loop) > 7,
        lasts_us=1_500_000, asked=True,
    ),
]  # fmt: skip


def run(deed: Deed, guarded: bool) -> tuple[MadCore, Loop, bool]:
    loop = Loop(
        sheet=TRUCK12,
        preset=Preset.TRUCK,
        start_gear=deed.gear,
        layshaft_rad_s=1123.0 * RPM,
        seed=6,
    )
    mad = MadCore(loop.header, deed.wish, guarded)
    loop.controller.core = mad
    loop.run_to_state(ControllerState.IN_GEAR, 2_000_000)
    loop.run(loop.time.now_us + 500_000)
    if deed.asked:
        loop.controller.receive(Transmitter(Node.BENCH).encode(TC1(requested_gear=deed.gear + 2)))
    mad.mad_us = mad.observer.clock.latest_us
    harmed = loop.until(lambda: deed.harm(loop), loop.time.now_us + deed.lasts_us)
    return mad, loop, harmed


def deeds() -> Iterator[Any]:
    """Flapping and overspeed need seconds until they do harm, and the guard's rows as many."""
    for deed in DEEDS:
        yield pytest.param(deed, id=deed.name, marks=(pytest.mark.long,) * (deed.row in (14, 16)))


@pytest.mark.parametrize("deed", list(deeds()))
def test_what_a_driveline_row_forbids_does_harm_and_under_guard_does_none(deed: Deed) -> None:
    _, _, harmed = run(deed, guarded=False)
    assert harmed
    mad, loop, harmed = run(deed, guarded=True)
    assert not harmed, loop.events
    assert deed.row in mad.rows


def test_a_shift_by_request_meets_no_row_of_the_driveline() -> None:
    """Up and down, with the engine asked and the clutch closed twice."""
    loop = Loop(
        [(300_000, 10), (2_300_000, 8)], sheet=TRUCK12, preset=Preset.TRUCK, toward=10, seed=6
    )
    loop.run(5_000_000)
    assert [outcome.result for outcome in loop.outcomes] == [ShiftResult.ENGAGED] * 2
    assert loop.status.guard_blocks == 0, loop.events


@pytest.mark.parametrize(("layshaft_rpm", "gears"), [(1400.0, (8, 6)), (1350.0, (8, 6))])
def test_a_downshift_near_the_limit_does_not_overspeed_the_input_shaft(
    layshaft_rpm: float, gears: tuple[int, int]
) -> None:
    """Found by the swarm: asked for 2,396 rpm, the engine overshot to 2,525 of 2,400 allowed."""
    loop = Loop(
        [(300_000, gears[1])],
        sheet=TRUCK12,
        preset=Preset.TRUCK,
        start_gear=gears[0],
        layshaft_rad_s=layshaft_rpm * RPM,
        seed=1,
    )
    assert not loop.until(lambda: input_overspeeds(loop), 2_500_000), loop.events
    assert loop.outcomes
