"""The virtual gearbox: shafts, brake, valves, sleeves and sensors, seen only through CAN frames.

It is the second witness: built from the same data sheet as the controller, its physics written
independently of the controller's model. `core.RigCore` is the node; `settings.RigSettings` says
which preset and which seed.
"""

from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import Preset, RigSettings, SettingsError

__all__ = ["Preset", "RigCore", "RigSettings", "SettingsError"]
