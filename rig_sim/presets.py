"""Which physics a rig has."""

from __future__ import annotations

from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.settings import Preset, RigSettings
from meshpoint.rig_sim.shared.world import RigWorld
from meshpoint.rig_sim.thesis.closed_form import warm_up
from meshpoint.rig_sim.thesis.world import World
from meshpoint.rig_sim.truck.world import TruckWorld


def build_world(sheet: GearboxSheet, settings: RigSettings) -> RigWorld:
    """The gearbox of the preset, at power-up, its kernels compiled."""
    warm_up()
    if settings.preset is Preset.TRUCK:
        world = TruckWorld(sheet, settings)
        world.plant.find_torques()  # compiles what is not compiled yet
        return world
    return World(sheet, settings)
