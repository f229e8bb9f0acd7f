"""Which physics a rig has."""

from __future__ import annotations

from gearbox.sheet import GearboxSheet
from rig_sim.kernels import warm_up
from rig_sim.rig_world import RigWorld
from rig_sim.settings import Preset, RigSettings
from rig_sim.truck_world import TruckWorld
from rig_sim.world import World


def build_world(sheet: GearboxSheet, settings: RigSettings) -> RigWorld:
    """The gearbox of the preset, at power-up, its kernels compiled."""
    warm_up()
    if settings.preset is Preset.TRUCK:
        world = TruckWorld(sheet, settings)
        world.plant.find_torques()  # compiles what is not compiled yet
        return world
    return World(sheet, settings)
