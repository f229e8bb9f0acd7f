"""Phase references: the angle between gear teeth and sleeve teeth, learned when a gear locks.

The sensor wheels count teeth but know no angle (thesis 8.2). When a gear has locked, its tooth lies
on the flank its slip carried it to, so the phase is sign(slip) b/2 and the constant between counted
angles and phase is known. Tooth counts keep it exact from then on. It is lost when either wheel's
count is lost: at power-up and at every stop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from controller.kinematics import raw_phase_rad, wrap_to_pitch
from gearbox import GearboxSheet, MainGear

LEARN_TIMES = 5
"""Steps a locked gear is watched before its reference is stored; averages the edge quantisation."""
FLANK_SLIP_RAD_S = 0.2
"""Below this slip (2 rpm) the flank cannot be told."""


@dataclass
class _Learning:
    """A gear being watched: the flank it lies on, 0 while not certain, and what was seen."""

    gear: MainGear
    flank: int
    seen: list[float] = field(default_factory=list)


class PhaseReferences:
    """One learned constant a gear, or none."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._sheet = sheet
        self._offset_rad: dict[MainGear, float] = {}
        self._learning: _Learning | None = None

    def known(self, gear: MainGear) -> bool:
        """Whether this gear's phase can be told."""
        return gear in self._offset_rad

    def phase_rad(self, gear: MainGear, theta_layshaft: float, theta_main: float) -> float:
        """Phase of the gear, unwrapped: wrap it to the pitch to see where in the gap it is.

        KeyError while the reference is unknown."""
        ratio = self._sheet.main_mesh(gear).ratio
        return raw_phase_rad(ratio, theta_layshaft, theta_main) - self._offset_rad[gear]

    def locked(self, gear: MainGear, slip_rad_s: float) -> None:
        """The gear has just locked after meeting its flank at this slip: begin to watch it."""
        certain = abs(slip_rad_s) >= FLANK_SLIP_RAD_S
        self._learning = _Learning(gear, int(math.copysign(certain, slip_rad_s)))

    def slips(self, slip_rad_s: float) -> None:
        """The gear in mesh still turns in its gap: it will lie on the flank it turns to at last."""
        if self._learning is not None and abs(slip_rad_s) >= FLANK_SLIP_RAD_S:
            self.locked(self._learning.gear, slip_rad_s)

    def watch(self, gear: MainGear, theta_layshaft: float, theta_main: float) -> bool:
        """One look at the gear in mesh. True when its reference has just been stored."""
        learning = self._learning
        if learning is None or learning.gear is not gear or learning.flank == 0:
            return False
        mesh, dog = self._sheet.main_mesh(gear), self._sheet.dog
        raw = raw_phase_rad(mesh.ratio, theta_layshaft, theta_main)
        first = learning.seen[0] if learning.seen else raw
        learning.seen.append(first + wrap_to_pitch(raw - first, dog.pitch_rad))
        if len(learning.seen) < LEARN_TIMES:
            return False
        mean = sum(learning.seen) / len(learning.seen)
        self._offset_rad[gear] = mean - learning.flank * dog.backlash_rad / 2.0
        self._learning = None
        return True

    def released(self) -> None:
        """The gear left the mesh before it was learned."""
        self._learning = None

    def lose_all(self) -> None:
        """A wheel's count was lost: nothing is known any more."""
        self._offset_rad.clear()
        self._learning = None

    @property
    def mask(self) -> int:
        """Bit 0 crawl, 1 first, 2 second, 3 third, as the status frame reports them."""
        return sum(1 << (gear - 1) for gear in self._offset_rad)
