"""The virtual gearbox: shafts, brake, valves, sleeves and sensors, seen only through CAN frames.

Built from the same data sheet as the controller, but its physics is written independently of the
controller's model, so that a mistake in one shows. `core.RigCore` is the node;
`settings.RigSettings` says which preset and which seed. The rooms:

    truck    the preset `truck`, with its faults and sensors
    thesis   the preset `thesis`
    parts    one physical law in each file
    truck_nodes  the truck's other nodes, as `--truck` asks for them
    shared   what both presets use: valve drivers, sleeves, sensor clock, the bench's script
"""

from __future__ import annotations

from typing import Any

from meshpoint.rig_sim.settings import Preset, RigSettings, SettingsError

__all__ = ["Preset", "RigSettings", "SettingsError"]


def __getattr__(name: str) -> Any:
    """`RigCore`, loaded where it is asked for: whoever only sets a rig up need not wait for it."""
    if name != "RigCore":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from meshpoint.rig_sim.core import RigCore

    return RigCore
