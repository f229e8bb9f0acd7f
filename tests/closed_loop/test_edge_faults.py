"""The rig's Hall faults through the controller's edge gate: tooth numbers and the true angle."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from meshpoint.controller.measure.clock import SensorClockEstimate
from meshpoint.controller.measure.wheel_edges import WheelEdges
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import EdgesMainFall, EdgesMainRise, RigFault
from meshpoint.dbc.node import Node
from meshpoint.gearbox.sheet import GearboxSheet, load_sheet
from meshpoint.rig_sim import RigCore, RigSettings
from meshpoint.rig_sim.orders import FaultOrder, ScheduledFault
from meshpoint.rig_sim.settings import Profile
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.world import TruckWorld

SHEET = load_sheet("thesis")
MAIN_RISE, MAIN_FALL = 4, 5
BEGIN_US, FOR_US, UNTIL_US = 300_000, 150_000, 600_000


class GateOnTheRig:
    """The main shaft's wheel as the controller sees it, beside the rig's angle of that shaft."""

    def __init__(self, sheet: GearboxSheet, *faults: FaultOrder) -> None:
        scheduled = tuple(ScheduledFault(BEGIN_US, order) for order in faults)
        self.core = RigCore(sheet, RigSettings(seed=3, faults=scheduled, profile=Profile.CLEAN))
        wheel = sheet.wheels.main
        self.teeth = wheel.teeth
        self.wheel = WheelEdges(wheel.teeth, wheel.duty_share, wheel.missing)
        self.offsets: list[float] = []
        """Angle said less true angle at each read, in pitches, for each number of losses."""
        self.parts: list[int] = []

    def run(self) -> GateOnTheRig:
        clock, ears = SensorClockEstimate(), Receiver(Node.TRANSMISSION_CONTROL)
        for now_us in range(0, UNTIL_US, 10_000):
            frames, _ = self.core.step(now_us)
            messages = [ears.receive(frame).message for frame in frames]
            rise = [m for m in messages if isinstance(m, EdgesMainRise)]
            fall = [m for m in messages if isinstance(m, EdgesMainFall)]
            batch = self.wheel.read(rise, fall, clock, now_us)
            newest = self.wheel.newest
            if not batch.time_us.size or newest is None:
                continue
            world = self.core._world
            assert isinstance(world, TruckWorld)
            speed = world.plant.main_rad_s
            turns, rest_rad = world.plant.angle(at.MAIN)
            true = turns * 2.0 * math.pi + rest_rad
            now_sensor_us = clock.now_us(now_us)
            said = newest.theta_rad + speed * (now_sensor_us - newest.time_us) * 1e-6
            self.offsets.append((said - true) / self.wheel.pitch_rad)
            self.parts.append(self.wheel.broken)
        return self


def spread(values: list[float]) -> float:
    return max(values) - min(values)


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        (RigFault.HALL_DROPOUT, 0.0),
        (RigFault.HALL_MISSING_TOOTH, 7.0),
        (RigFault.HALL_DOUBLE_EDGE, 0.0),
        (RigFault.HALL_NOISE_BURST, 1.0),
        (RigFault.HALL_NOISE_BURST, 4.0),
        (RigFault.HALL_NOISE_BURST, 8.0),
    ],
)
@pytest.mark.parametrize("channel", [MAIN_RISE, MAIN_FALL])
def test_a_fault_of_one_channel_costs_no_tooth(kind: RigFault, value: float, channel: int) -> None:
    """The other polarity counts on, and the edges that are extra are left out."""
    bench = GateOnTheRig(SHEET, FaultOrder(int(kind), channel, value, FOR_US)).run()
    assert bench.wheel.broken == 0
    assert len(bench.offsets) > 50
    assert spread(bench.offsets) < 0.3


def test_both_channels_silent_is_a_declared_loss() -> None:
    orders = [FaultOrder(int(RigFault.HALL_DROPOUT), c, 0.0, FOR_US) for c in (4, 5)]
    bench = GateOnTheRig(SHEET, *orders).run()
    assert bench.wheel.broken == 1
    assert bench.wheel.health.counting


@pytest.mark.parametrize("missing", [(43, 44), (17, 43, 44)])
def test_missing_teeth_give_the_angle_in_the_turn(missing: tuple[int, ...]) -> None:
    """The rig's tooth 0 is the drawing's: the offset is a whole number of turns."""
    wheels = replace(SHEET.wheels, main=replace(SHEET.wheels.main, missing=missing))
    bench = GateOnTheRig(replace(SHEET, wheels=wheels)).run()
    assert bench.wheel.broken == 0
    assert len(bench.offsets) > 30
    turns = [offset / bench.teeth for offset in bench.offsets]
    assert max(abs(turn - round(turn)) for turn in turns) < 0.3 / bench.teeth
