"""What a rig is started with."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.rig_sim.orders import ScheduledFault

CLOCK_MODULUS: Final = 1 << 32
MAX_MAIN_SPEED_RPM: Final = 5000.0
RETURN_RAMP_S: Final = 0.300


class SettingsError(ValueError):
    """A rig setting that cannot be used; the message names it, what was found, what is allowed."""


class Preset(StrEnum):
    """Which physics the rig has.

    THESIS: equations 4.1-4.17 to the letter, nothing else. TRUCK: a gearbox that misbehaves like
    one (docs/gearbox.md)."""

    THESIS = "thesis"
    TRUCK = "truck"

    @property
    def sheet_name(self) -> str:
        """The data sheet that people get who name none."""
        return "thesis" if self is Preset.THESIS else "truck12"


DEFAULT_PRESET: Final = Preset.TRUCK
"""What people get who name none."""


class Profile(StrEnum):
    """From which ranges the preset truck draws what is as built (docs/gearbox.md, Profiles).

    CLEAN: a rigid driveline and good sensors. TYPICAL: driveline oscillation, road input,
    sensor noise, part tolerances. HARSH: every range of it at its upper end."""

    CLEAN = "clean"
    TYPICAL = "typical"
    HARSH = "harsh"


DEFAULT_PROFILE: Final = Profile.TYPICAL
"""What people get who name none: a gearbox as it is met in a truck."""


@dataclass(frozen=True)
class RigSettings:
    """Everything a run of the rig depends on, besides the data sheet and the frames it receives.

    seed            draws every start angle, the sleeve delays, and clock_start_us where it is None
    start_gear      the drive gear the rig stands in at the start, 1..14
    main_speed_rpm  main shaft speed at the start; the default gives 1,484 rpm at the layshaft in
                    gear 8 of the sheet `truck12`, 1,400 rpm in that of `thesis`
    clock_start_us  sensor clock at power-up, 0..2^32-1; None draws one 0.5-5 s before the wrap
    profile         ranges of the truck's as-built values
    as_built        values of the truck that are fixed, not drawn, by name (`as_built`)
    return_ramp_s   how long the bench script takes to change the speeds (`bench_script`)
    faults          what goes wrong with the truck, and when
    truck_nodes     whether it plays the truck's other nodes as well (docs/wire.md)
    """

    preset: Preset = DEFAULT_PRESET
    seed: int = 1
    start_gear: int = 8
    main_speed_rpm: float = 644.0
    clock_start_us: int | None = None
    as_built: Mapping[str, float] = field(default_factory=dict)
    faults: tuple[ScheduledFault, ...] = ()
    return_ramp_s: float = RETURN_RAMP_S
    profile: Profile = DEFAULT_PROFILE
    truck_nodes: bool = False

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise SettingsError(f"seed: found {self.seed}, allowed: 0 and above")
        if self.start_gear not in DRIVE_GEARS:
            raise SettingsError(f"start_gear: found {self.start_gear}, allowed: 1..14")
        speed = self.main_speed_rpm
        if not (math.isfinite(speed) and 0.0 <= speed <= MAX_MAIN_SPEED_RPM):
            raise SettingsError(f"main_speed_rpm: found {speed}, allowed: 0..{MAX_MAIN_SPEED_RPM}")
        start = self.clock_start_us
        if start is not None and not 0 <= start < CLOCK_MODULUS:
            raise SettingsError(f"clock_start_us: found {start}, allowed: 0..{CLOCK_MODULUS - 1}")
