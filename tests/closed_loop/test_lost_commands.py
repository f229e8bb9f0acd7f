"""Commands that are lost as a sleeve is pulled: the pull gets no longer, and nothing is thrown."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from loop_bench import Loop

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ShiftResult
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile
from meshpoint.rig_sim.shared.valve_drivers import Valve

COMMAND = CODECS["ValveCommand"].spec.can_id
REQUEST_US = 600_000
SPLITTER = (Valve.SPLIT_LOW, Valve.SPLIT_HIGH)
MAIN = (Valve.MAIN_FIRST, Valve.MAIN_SECOND, Valve.MAIN_CRAWL, Valve.MAIN_THIRD)
Spoil = Callable[[Frame], list[Frame]]


def lost(frame: Frame) -> list[Frame]:
    return []


def damaged(frame: Frame) -> list[Frame]:
    return [frame._replace(data=frame.data[:-1] + bytes([frame.data[-1] ^ 1]))]


def pulled(sheet: str, pair: tuple[int, int], seed: int, spoil: Spoil, frames: int) -> Loop:
    """A shift in which so many commands are spoiled, once its first pull is on."""
    from_, to = pair
    loop = Loop(
        [(REQUEST_US, to)], sheet=load_sheet(sheet), preset=Preset.TRUCK, start_gear=from_,
        toward=to, seed=seed, profile=Profile.TYPICAL,
    )  # fmt: skip
    pulls = SPLITTER if sheet == "truck12-dog" else MAIN
    left: list[Frame | None] = [None] * frames
    pull_us: list[int] = []

    def spoiled(frame: Frame) -> list[Frame]:
        if frame.can_id != COMMAND or not left:
            return [frame]
        if not pull_us and not any(loop.world.valves.energised[valve] for valve in pulls):
            return [frame]
        pull_us.append(loop.time.now_us)
        left.pop()
        return spoil(frame)

    loop.rig.receiving = spoiled
    loop.until(lambda: bool(loop.outcomes), 9_000_000)
    assert not left
    return loop


@pytest.mark.parametrize("spoil", [lost, damaged])
@pytest.mark.parametrize(
    ("sheet", "pair", "seed"),
    [("truck12", (10, 8), 2), ("truck12", (6, 8), 2), ("truck12-dog", (11, 12), 2)],
)
def test_a_pull_whose_end_is_lost_throws_no_sleeve_through(
    sheet: str, pair: tuple[int, int], seed: int, spoil: Spoil
) -> None:
    """The end is said with the beginning. Before, two lost frames threw the sleeve onto the
    opposite gear or the other step, at up to 349 rpm."""
    loop = pulled(sheet, pair, seed, spoil, 4)
    assert loop.violations == 0
    assert loop.outcomes[0].result in (ShiftResult.ENGAGED, ShiftResult.ENDED_IN_OLD_GEAR)
