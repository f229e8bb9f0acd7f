"""Phase references: the angle between gear teeth and sleeve teeth, learned when a gear locks.

The sensor wheels count teeth but do not measure absolute angles (thesis 8.2). In mesh a tooth lies
at one of the two flanks of its gap, so the phase is +b/2 or -b/2 (b: backlash), and the constant
between counted angles and phase follows once it is known which flank.

- A tooth that has moved through the gap from above lies at the lower flank, and vice versa.
- A tooth that has not moved lies where the slip at contact carried it, if the sleeve went straight
  in; in a gearbox where teeth have been observed to move, where the layshaft's drag pulls it.
- With very little torque a tooth floats. Its lowest and highest phase between lock and release then
  bound the gap, which is as wide as that range or slightly wider.
- On a driveline that swings a tooth goes from flank to flank. Then all measurements together show
  where the gap is (`gap_posterior`).

An observation of the phase of a gear in mesh is called a measurement. Counting teeth keeps the
reference exact; it is lost when the count of either wheel is lost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from meshpoint.controller.phase.gap_posterior import GapPosterior, log_densities
from meshpoint.dbc.messages import ReferenceSource
from meshpoint.gearbox import GearboxSheet, MainGear
from meshpoint.gearbox.kinematics import raw_phase_rad, wrap_to_pitch

STILL_MEASUREMENTS = 5
"""Measurements, one every 10 ms, during which a tooth that has crossed its gap must then lie
still."""
STILL_SHARE = 0.05
"""A tooth lies still if the standard deviation of its measurements is below this, in backlashes."""
CROSSED_SHARE = 0.85
MOVED_SHARE = 0.3
STAYED_SHARE = 0.2
"""Distances moved, in backlashes: above the first a tooth has crossed its gap, above the second it
has moved, below the third it has not moved."""
NEAR_SHARE = 0.1
"""Earlier measurements this close to where the tooth lies, in backlashes, enter its mean phase."""
GAP_SHARE = 1.25
"""A measurement farther away than this, in backlashes, is wrong: the gap is not that wide."""
MOVED_MEASUREMENTS = 16
"""Still measurements required of a tooth that started inside the gap: it may also stop there and
reverse."""
UNMOVED_MEASUREMENTS = 20
"""After this many measurements without a move the tooth lies where the slip at contact carried
it."""
PULLED_MEASUREMENTS = 6
"""Still measurements under drag alone: longer than a tooth needs to reverse inside its gap."""
FLOATED_MEASUREMENTS = 3
"""Number of consecutive measurements that together give one position of a floating tooth."""
FLOATED_SHARE = 0.2
"""They do only if they lie within this distance, in backlashes: an impact disturbs single
measurements."""
LEAST_SPAN, MOST_SPAN = 0.8, 1.1
"""Range of a floating tooth's positions, in backlashes, from which the gap is determined: its
middle is then wrong by a tenth of the backlash at most."""
OTHER_SHARE = 0.3
"""A constant this far, in backlashes, from the middle of what was seen of the whole gap is wrong:
it took one flank for the other."""
MOST_MEASUREMENTS = 60
"""A gear in mesh is looked at no further: 0.6 s, in which a driveline swings several times."""
FLANK_SLIP_RAD_S = 0.2
"""Below this slip (2 rpm) at contact it is not certain which flank the tooth was carried to."""


class Floated(NamedTuple):
    """Lowest and highest raw phase (rad) at which a floating tooth of a gear has been seen."""

    gear: MainGear
    low_rad: float
    high_rad: float


class Watched(Protocol):
    """A gear that has locked and is watched: gear; flank, +1 or -1, to which the slip at contact
    carried the tooth, 0 if that is not certain; whether the sleeve went straight in."""

    gear: MainGear
    flank: int
    straight: bool


@dataclass
class _Learning:
    """A gear in mesh whose reference is being learned. flank: +1 or -1, the flank to which the slip
    at contact carried the tooth; 0 if that is not certain."""

    gear: MainGear
    flank: int
    straight: bool
    """Whether the sleeve went straight in, so that the tooth cannot have left its flank before."""
    seen: list[float] = field(default_factory=list)
    pulled: int = 0
    """Number of newest consecutive measurements during which drag alone pulled the tooth to the
    lower flank."""
    done: bool = False
    """Its constant has been found; measurements go on, to see the whole gap."""

    def add(self, raw_rad: float, pitch_rad: float, pulled: bool) -> None:
        """Adds a measurement: raw phase (rad), unwrapped to lie within half a pitch of the
        first."""
        first = self.seen[0] if self.seen else raw_rad
        self.pulled = self.pulled + 1 if pulled else 0
        self.seen.append(first + wrap_to_pitch(raw_rad - first, pitch_rad))

    def lies(self, backlash_rad: float, moves: bool, stays: bool) -> tuple[int, float] | None:
        """Flank (+1, -1) and mean raw phase (rad) of a tooth that lies still; None while not
        certain.

        moves, stays: whether in this gearbox a tooth was seen to cross its gap before, and whether
        one was seen not to move."""
        if (
            moves
            and self.pulled >= PULLED_MEASUREMENTS
            and self._still(PULLED_MEASUREMENTS, backlash_rad)
        ):
            return -1, _mean(self.seen[-PULLED_MEASUREMENTS:])
        if not self._still(STILL_MEASUREMENTS, backlash_rad):
            return None
        mean = _mean(self.seen[-STILL_MEASUREMENTS:])
        moved = self.moved_share(mean, backlash_rad)
        if moved is None:
            return None
        if abs(moved) > CROSSED_SHARE or (moved and self._still(MOVED_MEASUREMENTS, backlash_rad)):
            return int(math.copysign(1.0, moved)), mean
        certain = self.straight or stays
        if moves or not certain or self.flank == 0 or not self.stayed(backlash_rad):
            return None
        return self.flank, mean

    def stayed(self, backlash_rad: float) -> bool:
        """Whether no measurement of a long series differs: the tooth has not moved."""
        near = STAYED_SHARE * backlash_rad
        return (
            len(self.seen) >= UNMOVED_MEASUREMENTS and max(self.seen) - min(self.seen) < 2.0 * near
        )

    def moved_share(self, mean: float, backlash_rad: float) -> float | None:
        """Signed distance that the tooth has moved to where it lies, in backlashes; 0 if it has not
        moved, None if it has been on both sides. Median filtered: an impact disturbs single
        measurements."""
        away = [(measurement - mean) / backlash_rad for measurement in self.seen]
        smooth = [sorted(away[k - 1 : k + 2])[1] for k in range(1, len(away) - 1)]
        possible = [share for share in smooth if abs(share) < GAP_SHARE]
        above, below = max(possible, default=0.0), -min(possible, default=0.0)
        if max(above, below) < STAYED_SHARE:
            return 0.0
        if above > MOVED_SHARE and below < STAYED_SHARE:
            return -above
        if below > MOVED_SHARE and above < STAYED_SHARE:
            return below
        return None

    def floated(self, backlash_rad: float) -> tuple[float, float] | None:
        """Lowest and highest raw phase (rad) of the tooth; None without enough quiet
        measurements."""
        runs = [
            self.seen[k : k + FLOATED_MEASUREMENTS]
            for k in range(len(self.seen) - FLOATED_MEASUREMENTS + 1)
        ]
        quiet = [sorted(run) for run in runs if max(run) - min(run) < FLOATED_SHARE * backlash_rad]
        if not quiet:
            return None
        middle = [run[FLOATED_MEASUREMENTS // 2] for run in quiet]
        return min(middle), max(middle)

    def _still(self, measurements: int, backlash_rad: float) -> bool:
        if len(self.seen) < measurements:
            return False
        still = self.seen[-measurements:]
        mean = _mean(still)
        variance = sum((measurement - mean) ** 2 for measurement in still) / measurements
        return variance <= (STILL_SHARE * backlash_rad) ** 2


def _mean(measurements: list[float]) -> float:
    return sum(measurements) / len(measurements)


class PhaseReferences:
    """The learned phase reference of each main gear: a constant in rad, or none."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._sheet = sheet
        self._offset_rad: dict[MainGear, float] = {}
        self._sd_rad: dict[MainGear, float] = {}
        self._adopted: dict[MainGear, ReferenceSource] = {}
        """Source of each constant that was not measured with the gear in mesh."""
        self._learning: _Learning | None = None
        self._moves = False
        """Whether a tooth of this gearbox has been seen to cross its gap."""
        self._stays = False
        """Whether a tooth of this gearbox has been seen not to move."""
        self._floated_rad: dict[MainGear, tuple[float, float]] = {}
        """Lowest and highest raw phase (rad) of floating teeth, by gear."""
        self._gaps: dict[MainGear, GapPosterior] = {}
        """What all measurements at a gear show of where its gap is."""
        self._likely_rad: dict[MainGear, float] = {}
        """Constants that are valid if teeth of this gearbox stay where the slip carried them."""
        # Now, not in the step of the first lock.
        log_densities(sheet.dog.pitch_rad, sheet.dog.backlash_rad)

    def known(self, gear: MainGear) -> bool:
        """Whether this gear's reference is known, and so its phase."""
        return gear in self._offset_rad

    def sd_rad(self, gear: MainGear) -> float:
        """Standard deviation (rad) of a gear's constant, by the scatter of the measurements it was
        learned from; 0 where it was learned in another way."""
        return self._sd_rad.get(gear, 0.0)

    def phase_rad(self, gear: MainGear, theta_layshaft: float, theta_main: float) -> float:
        """Phase of the gear, unwrapped: wrap it to the pitch to see where in the gap it is.

        KeyError while the reference is unknown."""
        ratio = self._sheet.main_mesh(gear).ratio
        return raw_phase_rad(ratio, theta_layshaft, theta_main) - self._offset_rad[gear]

    def locked(self, gear: MainGear, slip_rad_s: float, straight: bool = True) -> None:
        """The gear has just locked after meeting its flank at this slip: begin to watch it.

        straight: the sleeve went in without having rubbed on a tooth, or waited in the gap."""
        certain = abs(slip_rad_s) >= FLANK_SLIP_RAD_S
        flank = int(math.copysign(certain, slip_rad_s))
        self._learning = _Learning(gear, flank, straight)

    def watches(self, gear: MainGear) -> bool:
        """Whether this gear's reference is being learned, so that measurements are wanted."""
        learning = self._learning
        return (
            learning is not None
            and learning.gear is gear
            and len(learning.seen) < MOST_MEASUREMENTS
        )

    @property
    def watched(self) -> Watched | None:
        """The gear in mesh whose reference is being learned; the same object as long as it is the
        same lock."""
        return self._learning

    def see(self, gear: MainGear, theta_layshaft: float, theta_main: float, sd_rad: float) -> None:
        """One measurement at the gear in mesh, however vague: it counts by its standard
        deviation."""
        dog = self._sheet.dog
        if gear not in self._gaps:
            self._gaps[gear] = GapPosterior(dog.pitch_rad, dog.backlash_rad)
        ratio = self._sheet.main_mesh(gear).ratio
        self._gaps[gear].measure(raw_phase_rad(ratio, theta_layshaft, theta_main), sd_rad)

    def watch(
        self, gear: MainGear, theta_layshaft: float, theta_main: float, pulled: bool = False
    ) -> bool:
        """One measurement at the gear in mesh; `pulled`: drag alone pulls its teeth, hard enough to
        cross the gap within a few measurements. True when its reference has just been stored."""
        learning = self._learning
        if learning is None or learning.gear is not gear:
            return False
        mesh, dog = self._sheet.main_mesh(gear), self._sheet.dog
        raw = raw_phase_rad(mesh.ratio, theta_layshaft, theta_main)
        learning.add(raw, dog.pitch_rad, pulled)
        if learning.done:
            return False
        lies = learning.lies(dog.backlash_rad, self._moves, self._stays)
        if lies is None:
            return False
        flank, mean = lies
        # earlier measurements at the same place reduce the noise
        near = [
            measurement
            for measurement in learning.seen
            if abs(measurement - mean) < NEAR_SHARE * dog.backlash_rad
        ]
        mean = _mean(near)
        # Not less for more measurements: what is left of the tooth errors is the same in all of
        # them.
        self._sd_rad[gear] = math.sqrt(_mean([(measurement - mean) ** 2 for measurement in near]))
        share = learning.moved_share(mean, dog.backlash_rad)
        self._moves = self._moves or (share is not None and abs(share) > CROSSED_SHARE)
        self._stays = self._stays or share == 0.0
        if not self._moves:
            self._offset_rad = self._likely_rad | self._offset_rad
        self._likely_rad.clear()
        self._offset_rad[gear] = mean - flank * dog.backlash_rad / 2.0
        self._adopted.pop(gear, None)
        learning.done = True
        return True

    def released(self) -> Floated | None:
        """The gear leaves the mesh. Returns where its tooth floated if its reference was still
        being learned."""
        learning, backlash_rad = self._learning, self._sheet.dog.backlash_rad
        self._learning = None
        if learning is None:
            return None
        floated = learning.floated(backlash_rad)
        if floated is not None:
            self._bound(learning.gear, *floated)
        self._weigh(learning.gear)
        if learning.done:
            return None
        if learning.stayed(backlash_rad):
            self._stays = True
            if learning.flank != 0:
                mean = _mean(learning.seen)
                self._likely_rad[learning.gear] = mean - learning.flank * backlash_rad / 2.0
        return None if floated is None else Floated(learning.gear, *floated)

    def _bound(self, gear: MainGear, low: float, high: float) -> None:
        """Determines the reference of a gear that leaves the mesh from the range of phases of this
        and earlier times, if that range is about a backlash: where it was not known, or where it
        took one flank for the other."""
        dog = self._sheet.dog
        if gear in self._floated_rad:
            before_low, before_high = self._floated_rad[gear]
            turned = low - before_low - wrap_to_pitch(low - before_low, dog.pitch_rad)
            low, high = min(low - turned, before_low), max(high - turned, before_high)
        self._floated_rad[gear] = low, high
        span = (high - low) / dog.backlash_rad
        if span > MOST_SPAN:
            del self._floated_rad[gear]
        elif span > LEAST_SPAN:
            middle = 0.5 * (low + high)
            off = wrap_to_pitch(self._offset_rad.get(gear, middle) - middle, dog.pitch_rad)
            if not self.known(gear) or abs(off) > OTHER_SHARE * dog.backlash_rad:
                self._offset_rad[gear] = middle
                self._adopted.pop(gear, None)

    def _weigh(self, gear: MainGear) -> None:
        """Determines the reference of a gear that leaves the mesh from all measurements at it,
        where it was not known, or where it took one flank for the other."""
        gap = self._gaps.get(gear)
        middle = None if gap is None else gap.middle()
        if middle is None:
            return
        dog = self._sheet.dog
        known = self._offset_rad.get(gear)
        off = 0.0 if known is None else wrap_to_pitch(known - middle.raw_rad, dog.pitch_rad)
        if known is None or abs(off) > OTHER_SHARE * dog.backlash_rad:
            self._offset_rad[gear], self._sd_rad[gear] = middle
            self._adopted.pop(gear, None)

    @property
    def offsets_rad(self) -> dict[MainGear, float]:
        """The known constants by gear."""
        return dict(self._offset_rad)

    def adopt(self, gear: MainGear, offset_rad: float, source: ReferenceSource) -> None:
        """Takes a constant (rad) that was derived without the gear in mesh."""
        self._offset_rad[gear] = offset_rad
        self._adopted[gear] = source

    def source(self, gear: MainGear) -> ReferenceSource:
        """Where a gear's constant came from; NONE while it is unknown."""
        known = ReferenceSource.MEASURED if gear in self._offset_rad else ReferenceSource.NONE
        return self._adopted.get(gear, known)

    def lose(self, gear: MainGear) -> None:
        """Drops one gear's constant, because it was wrong."""
        self._offset_rad.pop(gear, None)
        self._adopted.pop(gear, None)
        self._gaps.pop(gear, None)

    def lose_all(self) -> None:
        """Drops all constants, because a wheel's count was lost."""
        self._offset_rad.clear()
        self._adopted.clear()
        self._likely_rad.clear()
        self._floated_rad.clear()
        self._gaps.clear()
        self._learning = None

    @property
    def mask(self) -> int:
        """Bit 0 crawl, 1 first, 2 second, 3 third, as the status frame reports them."""
        return sum(1 << (gear - 1) for gear in self._offset_rad)
