"""How a bench rests before a shift: in a simulation, step by step and in a campaign alike."""

from __future__ import annotations

from collections.abc import Callable

import pytest

import meshpoint
from meshpoint.bench.bench import plan_shifts
from meshpoint.bench.simulate import LAYSHAFT_RAD_S, Setup, simulate
from meshpoint.campaigns.draw import Draw
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.controller.estimate.loaded_driveline import LoadedDriveline
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile

SHEET = load_sheet("truck12")
SEED, SHIFTS = 2, 3
PAIR = (8, 10)


def in_a_campaign() -> None:
    plan = plan_shifts(SHEET, [PAIR], SHIFTS, LAYSHAFT_RAD_S)
    drawn = Draw(SEED, tuple(plan), profile=Profile.TYPICAL)
    loop = ClosedLoop(SHEET, ControllerSettings(), Preset.TRUCK, drawn)
    for _ in range(SHIFTS):
        loop.shift()


def in_a_simulation() -> None:
    settings = ControllerSettings()
    simulate(
        Setup(SHEET, settings, seed=SEED, shifts=SHIFTS, pairs=(PAIR,), profile=Profile.TYPICAL)
    )


def step_by_step() -> None:
    from_gear, to_gear = PAIR
    with meshpoint.Bench(gearbox=SHEET, seed=SEED, as_built="typical") as bench:
        for _ in range(SHIFTS):
            bench.shift(to_gear, from_gear)


@pytest.mark.parametrize(
    "run", [in_a_campaign, in_a_simulation, pytest.param(step_by_step, marks=pytest.mark.long)]
)
def test_every_shift_but_the_first_begins_with_what_was_seen_of_the_loaded_driveline(
    run: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The truck has been in its gear for so long that the controller has followed what its shafts
    carry. In the first shift it may not know of their backlash yet; a tooth that is thrown out of
    its gear begins another window in neutral, in which nothing is known from before."""
    reported, count = LoadedDriveline.behind, 0

    def behind(driveline: LoadedDriveline, time_us: float) -> object:
        nonlocal count
        found = reported(driveline, time_us)
        count += found is not None
        return found

    monkeypatch.setattr(LoadedDriveline, "behind", behind)
    run()
    assert count >= SHIFTS - 1
