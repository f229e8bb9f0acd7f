"""How long a bench rests between two shifts, in virtual time and live."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.rig_sim.settings import Preset, Profile

SETTLE_US: Final = 200_000
"""In the old gear before the request: speeds settle as they would in driving."""
LEARN_US: Final = 300_000
"""In the new gear before it is left: time to learn its phase."""
SETTLED_US: Final = 400_000
SETTLED_US_A_RATIO: Final = 160_000
"""On a driveline that twists the lock makes engine and vehicle swing against each other, by up to
4 kNm in the propeller shaft a tenth of a second after it. A truck has been in its gear for seconds
when it is left; here it has for `SETTLED_US`, and so much more for each whole of the gear's overall
ratio, with which the period of the swing grows (0.1 s to 1.1 s). Some 100 Nm are left then, as the
road makes of itself, and the controller has followed the loaded driveline for long enough to tell
where it is when the gear comes out."""


@dataclass(frozen=True)
class Pauses:
    """How long a bench rests in the old gear before a request, and in the new one after it."""

    settle_us: int = SETTLE_US
    """From when the controller says that it is in the old gear with its clutch closed."""
    locked_us: int = 0
    """From when the rig says that the old gear is locked, at least."""
    settled_us: Mapping[int, int] = field(default_factory=dict)
    """The same, by the number of the old gear, where it takes longer."""
    learn_us: int = LEARN_US
    """In the new gear, from the shift's outcome."""
    learned_us: int = LEARN_US
    """The same, at least, where the gear's phase reference is known before `learn_us`."""

    def locked_least_us(self, gear: int) -> int:
        """From the lock of the old gear to the request, at least."""
        return max(self.locked_us, self.settled_us.get(gear, 0))


def pauses_of(sheet: GearboxSheet, profile: Profile, preset: Preset = Preset.TRUCK) -> Pauses:
    """How long a bench rests with this gearbox: on a driveline that twists, or on a rigid one, as
    those of the profile clean and of the preset thesis are."""
    if profile is Profile.CLEAN or preset is Preset.THESIS:
        return Pauses()
    return Pauses(
        settled_us={
            number: round(SETTLED_US + SETTLED_US_A_RATIO * sheet.overall_ratio(gear))
            for number, gear in DRIVE_GEARS.items()
        }
    )
