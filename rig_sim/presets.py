"""Which physics a rig has."""

from __future__ import annotations

from meshpoint.gearbox.gears import MainGear
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.kernels.watch import uncollected
from meshpoint.rig_sim.settings import Preset, RigSettings
from meshpoint.rig_sim.shared import angle_kernels
from meshpoint.rig_sim.shared.world import RigWorld
from meshpoint.rig_sim.thesis import closed_form
from meshpoint.rig_sim.thesis.world import World
from meshpoint.rig_sim.truck.world import TruckWorld


def build_world(sheet: GearboxSheet, settings: RigSettings) -> RigWorld:
    """The gearbox of the preset, at power-up, its kernels compiled."""
    with uncollected():
        angle_kernels.warm_up()
        if settings.preset is Preset.TRUCK:
            world = TruckWorld(sheet, settings)
            world.plant.find_torques()  # compiles what is not compiled yet
            return world
        closed_form.warm_up()
        return World(sheet, settings)


def warm_up(sheet: GearboxSheet, preset: Preset) -> None:
    """Compiles all that a rig of this preset calls, or loads it: also what looks up its true
    future, which no node does."""
    world = build_world(sheet, RigSettings(preset=preset))
    if isinstance(world, TruckWorld):
        with uncollected():
            world.plant.advance_alone(0.0)
            world.plant.sample(MainGear.FIRST, 1.0, 0.0, range(1))
