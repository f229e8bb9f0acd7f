"""The mechanical data sheet of a gearbox: tooth counts, inertias, valves. Data, no behaviour.

Controller and rig are both built from the same sheet; the rig may deviate from it (as built), the
controller believes it. The sheets that are shipped are the TOML files in `sheets/`. See
`meshpoint.gearbox.sheet` for what a sheet holds and `meshpoint.gearbox.gears` for how the 14 gears
are numbered.
"""

from meshpoint.gearbox.gears import DriveGear, MainGear, Range, Sleeve, Split, drive_gear
from meshpoint.gearbox.sheet import GearboxSheet, SheetError, load_sheet

__all__ = [
    "DriveGear",
    "GearboxSheet",
    "MainGear",
    "Range",
    "SheetError",
    "Sleeve",
    "Split",
    "drive_gear",
    "load_sheet",
]
