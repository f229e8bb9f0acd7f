"""Which physics a rig has."""

from __future__ import annotations

import math

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
        world.plant.advance(-1.0, math.inf)  # compiles, and goes nowhere
        return world
    return World(sheet, settings)
