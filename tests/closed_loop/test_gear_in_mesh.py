"""The bench brings the box into a gear while a shift is under way and its sleeves are to be in
neutral: the shift ends at once when the gear is seen in mesh, and does not wait for its limits."""

from __future__ import annotations

import pytest
from loop_bench import Loop, Operator

from meshpoint.bus.core import Step
from meshpoint.controller.sensing.gearbox_view import ENGAGED_SHORT_M
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import (
    BenchAction,
    BenchCommand,
    ControllerState,
    ControllerStatus,
    FaultCode,
    ShiftResult,
    SleevesMain,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS, SLEEVE_OF_MAIN
from meshpoint.rig_sim.settings import Preset
from meshpoint.testbench.loop.bench import plan_shifts

State = ControllerState
OLD, ASKED = 8, 10
REQUEST_US = 300_000
SEEN_US = 25_000
"""From the frame that shows the gear in mesh to the outcome: a step of the controller, 10 ms, and
the way on the bus."""


class BringingIn(Operator):
    """Asks for a gear once; and brings the box into a gear by itself, as soon as it is told to."""

    def __init__(self) -> None:
        super().__init__([(REQUEST_US, ASKED)])
        self.command: BenchCommand | None = None
        self._bench = Transmitter(Node.BENCH)

    def step(self, now_us: int) -> Step:
        frames, events = super().step(now_us)
        if self.command is not None:
            frames.append(self._bench.encode(self.command))
        return Step(frames, events)


class BroughtIn(Loop):
    """A shift from gear 8 to 10, in which the bench brings the box into another one."""

    def new_operator(self) -> BringingIn:
        return BringingIn()

    def bring_in(self, gear: int) -> None:
        assert isinstance(self.operator, BringingIn)
        (plan,) = plan_shifts(self.sheet, [(gear, gear)], 1, self.layshaft_rad_s)
        self.operator.command = BenchCommand(
            action=BenchAction.RETURN_TO_GEAR, gear=gear, sequence=1,
            main_speed_rad_s=plan.main_rad_s,
        )  # fmt: skip

    def is_seen_in(self, gear: int) -> bool:
        """Whether the newest positions on the bus show this gear in mesh."""
        side, seen = SLEEVE_OF_MAIN[DRIVE_GEARS[gear].main], self.last(SleevesMain)
        samples_m = (seen.sleeve_first_second_m, seen.sleeve_crawl_third_m)[side.sleeve]
        in_mesh_m = self.sheet.sleeve.stroke_m - ENGAGED_SHORT_M
        return bool(samples_m[0] * side.direction >= in_mesh_m)


@pytest.mark.parametrize(
    ("preset", "sheet"), [(Preset.THESIS, "thesis"), (Preset.TRUCK, "truck12")]
)
@pytest.mark.parametrize(("gear", "state"), [(8, State.SYNCHRONISING), (12, State.SPEED_RAISING)])
def test_a_shift_under_way_ends_at_once_when_a_gear_is_seen_in_mesh(
    gear: int, state: State, preset: Preset, sheet: str
) -> None:
    """Into the old gear, whose speed is too high for the one asked for; into a higher gear, whose
    speed is too low for it."""
    loop = BroughtIn(sheet=load_sheet(sheet), preset=preset, start_gear=OLD, toward=ASKED)
    loop.run_to_state(State.SYNCHRONISING, 2_000_000)
    loop.bring_in(gear)
    assert loop.until(lambda: loop.is_seen_in(gear), 3_000_000)
    seen_us = loop.time.now_us
    assert loop.status.state is state
    assert not loop.outcomes
    assert loop.until(lambda: bool(loop.outcomes), seen_us + SEEN_US), loop.states
    (outcome,) = loop.outcomes
    assert outcome.result is ShiftResult.ENDED_IN_OLD_GEAR
    assert outcome.fault is FaultCode.SYNCHRONISE_FAILED
    loop.run_to_state(State.IN_GEAR, seen_us + 1_000_000)
    assert loop.seen(ControllerStatus, current_gear=gear)
    assert not loop.valves_driven
