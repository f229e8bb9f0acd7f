"""Phase references: the angle between gear teeth and sleeve teeth, learned when a gear locks.

The sensor wheels count teeth but do not measure absolute angles (thesis 8.2). In mesh a tooth lies
in its gap, so the constant between counted angles and phase follows from where it is seen while the
gear is in mesh. An observation of the phase of a gear in mesh is called a measurement. Counting
teeth keeps the reference exact; it is lost when the count of either wheel is lost. A gear that has
been in mesh has a reference from then on, with a standard deviation that says how well it is known;
plans price it.

**The middle of the gap** follows from all measurements by Bayes' rule on a grid. In mesh a tooth is
somewhere in its gap, most of the time at one of the two flanks, whichever the torque presses it to.
On a driveline that swings it changes flanks again and again and never lies still for long, but the
measurements of it pile up at two phases one backlash apart. The density of a measurement at phase
phi from the middle of the gap, b the backlash:

    p(phi) = (1 - e) (f u N(phi - b/2) + f (1 - u) N(phi + b/2) + (1 - f) U(|phi| < b/2) * N)
             + e / pitch

N is a measurement's own error, f the share of measurements at a flank, u the share of those at the
upper one, and e that of measurements gone astray by an impact. Measurements at one flank alone
leave two middles alike. What decides then is that the slip at which tooth and flank met has carried
the tooth to the flank on its side: u is near 1 or 0 for the first measurements, and 1/2 for all
others.

**Whole turns of the layshaft** that were not counted are one set of hypotheses for all gears. After
a restart the tooth numbers of both sensor wheels can be recovered, whole turns cannot. A gear's
phase is i theta_layshaft - theta_main less its reference, i = z1 / z2, modulo the pitch of d dog
teeth:

- Turns of the main shaft do not enter: 2 pi is d pitches.
- N turns of the layshaft move the phase by N d z1 / z2 pitches, which is whole again after
  n = z2 / gcd(z2, d z1) turns. So a gear has n candidates, one pitch / n apart.

N is one number for all gears on the layshaft, so the hypotheses are N modulo lcm(n). They need not
be listed: gear g shares with the others no more than c_g = gcd(n_g, lcm of the other n), and by the
Chinese remainder theorem the joint set is exactly

    { N : N modulo C is in `turns`, N modulo n_g is in `residues[g]` for each g },  C = lcm(c_g).

Each prime power of C divides two of the n, so C^2 divides their product at most: 40,000 hypotheses
for four gears of 200 teeth, 1 for coprime n. Where the turns are bounded, because a wheel's edges
were counted on, N itself is listed: then all n share all, c_g = n_g.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from meshpoint.dbc.messages import ReferenceSource
from meshpoint.gearbox import GearboxSheet, MainGear
from meshpoint.gearbox.kinematics import raw_phase_rad, wrap_to_pitch
from meshpoint.kernels.records import Vector

CELLS: Final = 300
"""Middles of the gap that are compared, over a pitch."""
MEASUREMENT_SHARES: Final = (
    *(0.1, 0.12, 0.14, 0.17, 0.2, 0.24, 0.28, 0.34, 0.4, 0.48, 0.6),
    *(0.8, 1.1, 1.5, 2.0, 2.8, 4.0, 6.0),
)
"""Standard deviations of measurements, in backlashes; one counts with the next larger of them, and
with none it says nothing of a gap."""
AT_FLANK: Final = 0.6
ASTRAY: Final = 0.02
CARRIED: Final = 0.98
"""Share of first measurements at a flank that are at the one to which the slip carried the
tooth."""
INDEPENDENT: Final = 0.25
"""Weight of one measurement: they follow each other every 10 ms, sooner than a tooth moves on, so
that only one in four adds something of its own."""
NEAR_SHARE: Final = 0.3
"""Middles within this of the likeliest one, in backlashes, are the same."""
BEYOND_SD: Final = 2.5
"""Of measurements at a flank, one in 160 lies further beyond it by chance, in its standard
deviations; more do where the gap is wider than the sheet says, or elsewhere."""

MOST_MEASUREMENTS: Final = 60
"""A gear in mesh is looked at no further: 0.6 s, in which a driveline swings several times."""
FLANK_SLIP_RAD_S: Final = 0.2
"""Below this slip (2 rpm) at contact it is not certain which flank the tooth was carried to."""
CARRIED_MEASUREMENTS: Final = 2
"""The first ones of a gear that has just locked are of a tooth where the slip has carried it: 20
ms."""
LEARNED_SD_RAD: Final = math.radians(0.1)
"""Standard deviation of the difference of two references learned of one gear at different times
(docs/calibration.md), beyond what the measurements in mesh say."""
OTHER_SHARE: Final = 0.3
"""A constant that differs by so much, in backlashes, is another one: a flank was taken for the
other. One known no better than this may be that one."""


class TurnSet(NamedTuple):
    """All N that are still possible; gears are those whose reference is remembered."""

    moduli: Mapping[MainGear, int]
    """The modulus n of each gear."""
    shared: Mapping[MainGear, int]
    """The modulus c of each gear: `turns` determines its residue modulo c."""
    turns: frozenset[int]
    """N modulo the lcm of `shared`, or N itself where it is bounded."""
    residues: Mapping[MainGear, frozenset[int]]
    """N modulo n of each gear: the residues that the gear's own measurements allow."""

    def candidates(self, gear: MainGear) -> frozenset[int]:
        """N modulo n of a gear that are still possible, one phase each; empty for a gear to which
        turns do not matter."""
        if gear not in self.moduli:
            return frozenset()
        c = self.shared[gear]
        possible = {turn % c for turn in self.turns}
        return frozenset(r for r in self.residues[gear] if r % c in possible)

    @property
    def empty(self) -> bool:
        """Whether every hypothesis is excluded: what was remembered is wrong."""
        return not self.turns


def turn_candidates(sheet: GearboxSheet, gear: MainGear) -> int:
    """After how many turns of the layshaft a gear's phase is the same again (n above)."""
    mesh = sheet.main_mesh(gear)
    return mesh.driven // math.gcd(mesh.driven, mesh.driving * sheet.dog.teeth)


def all_turns(moduli: Mapping[MainGear, int], bounded: Iterable[int] | None = None) -> TurnSet:
    """The set with nothing excluded; `bounded`: the only possible N, where these are known."""
    residues = {gear: frozenset(range(n)) for gear, n in moduli.items()}
    if bounded is not None:
        return TurnSet(moduli, moduli, frozenset(bounded), residues)
    shared = {}
    for gear, n in moduli.items():
        others = math.lcm(*(m for other, m in moduli.items() if other is not gear))
        shared[gear] = math.gcd(n, others)
    return TurnSet(moduli, shared, frozenset(range(math.lcm(*shared.values()))), residues)


def narrowed(turns: TurnSet, gear: MainGear, agrees: Callable[[int], bool]) -> TurnSet:
    """The hypotheses that agree with a measurement of `gear`.

    agrees: whether a residue N modulo n of the gear agrees with it."""
    left = frozenset(r for r in turns.candidates(gear) if agrees(r))
    possible = {r % turns.shared[gear] for r in left}
    kept = frozenset(turn for turn in turns.turns if turn % turns.shared[gear] in possible)
    return turns._replace(turns=kept, residues={**turns.residues, gear: left})


def without(turns: TurnSet, gears: Collection[MainGear]) -> TurnSet:
    """The set without these gears; what they have excluded stays excluded."""
    return TurnSet(
        {gear: n for gear, n in turns.moduli.items() if gear not in gears},
        {gear: c for gear, c in turns.shared.items() if gear not in gears},
        turns.turns,
        {gear: left for gear, left in turns.residues.items() if gear not in gears},
    )


def any_one(turns: TurnSet) -> dict[MainGear, int]:
    """N modulo n of each gear, for one possible N."""
    turn = min(turns.turns)
    return {
        gear: min(r for r in residues if (r - turn) % turns.shared[gear] == 0)
        for gear, residues in turns.residues.items()
    }


class GapMiddle(NamedTuple):
    """The middle of a gear's gap."""

    raw_rad: float
    """Its raw phase, within a pitch."""
    sd_rad: float
    """Standard deviation: of all middles that are possible, and of what none of them explains."""


@lru_cache(maxsize=8)
def _distances_rad(pitch_rad: float) -> Vector:
    """Distance of each cell from the first, at most half a pitch. Kept, not to be changed."""
    away = pitch_rad / CELLS * np.arange(CELLS)
    return away - pitch_rad * (away > pitch_rad / 2.0)


@lru_cache(maxsize=8)
def log_densities(pitch_rad: float, backlash_rad: float) -> dict[tuple[int, int], Vector]:
    """What a measurement adds to the logarithm of a middle in each cell beyond its own: by the
    flank to which the slip carried the tooth (0: not known), and the index of its standard
    deviation. Kept, as it takes some milliseconds and is the same for all gears of a gearbox."""
    phases, half, tables = (-_distances_rad(pitch_rad)).tolist(), backlash_rad / 2.0, {}
    for kind, share in enumerate(MEASUREMENT_SHARES):
        sd = share * backlash_rad
        # Of the flanks, and of what lies between them: by their distances once for all.
        lower, upper = (
            np.array([math.exp(-0.5 * ((phase - at) / sd) ** 2) for phase in phases])
            for at in (-half, half)
        )
        above, below = (
            np.array([math.erf((phase + at) / (sd * math.sqrt(2.0))) for phase in phases])
            for at in (half, -half)
        )
        between = 0.5 * (above - below) / backlash_rad
        for flank, most in ((0, 0.5), (1, CARRIED), (-1, 1.0 - CARRIED)):
            flanks = ((1.0 - most) * lower + most * upper) / (sd * math.sqrt(2.0 * math.pi))
            inside = AT_FLANK * flanks + (1.0 - AT_FLANK) * between
            weight = INDEPENDENT if flank == 0 else 1.0
            tables[flank, kind] = weight * np.log((1.0 - ASTRAY) * inside + ASTRAY / pitch_rad)
    return tables


class GapPosterior:
    """What the measurements at one gear show of the middle of its gap."""

    def __init__(self, pitch_rad: float, backlash_rad: float) -> None:
        self._pitch_rad, self._backlash_rad = pitch_rad, backlash_rad
        self._log: Vector = np.zeros(CELLS)
        self._measurements = np.zeros((len(MEASUREMENT_SHARES), CELLS))
        """How many measurements of each standard deviation there were in each cell."""
        self._beside_rad = 0.0
        """Sum of how far they lay from the middles of their cells."""

    def measure(self, raw_rad: float, sd_rad: float, flank: int = 0) -> bool:
        """One measurement at the gear in mesh: its raw phase and standard deviation. flank: +1 or
        -1, that to which the slip has just carried the tooth; 0: not known. Whether it counts: it
        is not too vague."""
        share = sd_rad / self._backlash_rad
        if share > MEASUREMENT_SHARES[-1]:
            return False
        kind = next(k for k, largest in enumerate(MEASUREMENT_SHARES) if share <= largest)
        nearest = round(raw_rad / self._pitch_rad * CELLS)
        cell = nearest % CELLS
        self._measurements[kind, cell] += 1.0
        self._beside_rad += raw_rad - nearest * self._pitch_rad / CELLS
        # A middle in cell k explains the measurement by the density of its distance from there.
        densities = log_densities(self._pitch_rad, self._backlash_rad)
        self._log += np.roll(densities[flank, kind], cell)
        return True

    def middle(self) -> GapMiddle | None:
        """The likeliest middle of the gap; None before the first measurement."""
        count = float(self._measurements.sum())
        if count == 0.0:
            return None
        weight = np.exp(self._log - self._log.max())
        weight /= weight.sum()
        best = int(weight.argmax())
        away = np.roll(_distances_rad(self._pitch_rad), best)
        near = np.abs(away) < NEAR_SHARE * self._backlash_rad
        off = float((weight * away)[near].sum()) / float(weight[near].sum())
        # Of all middles, not of those near the likeliest alone: another flank may be the right one.
        variance = float(weight @ (away - off) ** 2) + self._unexplained_rad2(away)
        off += self._beside_rad / count
        return GapMiddle(best * self._pitch_rad / CELLS + off, math.sqrt(variance))

    def _unexplained_rad2(self, away: Vector) -> float:
        """Mean square of how far measurements lie outside a gap from whose middle the cells are so
        far away, further from a flank than chance carries them."""
        reach = self._backlash_rad * (0.5 + BEYOND_SD * np.array(MEASUREMENT_SHARES))
        outside = np.maximum(0.0, np.abs(away) - reach[:, np.newaxis])
        return float((self._measurements * outside**2).sum() / self._measurements.sum())


class MeshChange(NamedTuple):
    """A gear has locked, or leaves the mesh: as the shift's sequence knows it."""

    gear: MainGear | None
    """None: the gear that was in mesh is being pulled."""
    slip_rad_s: float = 0.0
    """At which its tooth met a flank; 0 where that is not known."""


RELEASED: Final = MeshChange(None)


@dataclass
class Watched:
    """A gear that has locked and is watched."""

    gear: MainGear
    flank: int
    """+1 or -1, to which the slip at contact carried the tooth; 0: that is not certain."""
    measurements: int = 0
    counted: int = 0
    """Of these, the ones that were not too vague."""


class PhaseReferences:
    """The learned phase reference of each main gear: a constant in rad, or none."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._sheet = sheet
        self._other_rad = OTHER_SHARE * sheet.dog.backlash_rad
        self._offset_rad: dict[MainGear, float] = {}
        self._sd_rad: dict[MainGear, float] = {}
        self._adopted: dict[MainGear, ReferenceSource] = {}
        """Source of each constant that was not measured with the gear in mesh."""
        self._gaps: dict[MainGear, GapPosterior] = {}
        """What all measurements at a gear show of where its gap is."""
        self._unseen: set[MainGear] = set()
        """Gears that have been in mesh without a measurement that counted."""
        self.watched: Watched | None = None
        """The gear in mesh that is watched; the same object as long as it is the same lock."""
        # Now, not in the step of the first lock.
        log_densities(sheet.dog.pitch_rad, sheet.dog.backlash_rad)

    def known(self, gear: MainGear) -> bool:
        """Whether this gear's reference is known, and so its phase."""
        return gear in self._offset_rad

    def sd_rad(self, gear: MainGear) -> float:
        """Standard deviation (rad) of a gear's constant, by the measurements it was learned from; 0
        where it was learned in another way."""
        return 0.0 if gear in self._adopted else self._sd_rad.get(gear, 0.0)

    def certain(self, gear: MainGear) -> bool:
        """Whether it is known, and at which flank the tooth was seen: enough to be remembered."""
        return self.known(gear) and self.sd_rad(gear) < self._other_rad

    def phase_rad(self, gear: MainGear, theta_layshaft: float, theta_main: float) -> float:
        """Phase of the gear, unwrapped: wrap it to the pitch to see where in the gap it is.

        KeyError while the reference is unknown."""
        ratio = self._sheet.main_mesh(gear).ratio
        return raw_phase_rad(ratio, theta_layshaft, theta_main) - self._offset_rad[gear]

    def take(self, change: MeshChange) -> None:
        """What has come into mesh or leaves it."""
        if change.gear is None:
            self.released()
        else:
            self.locked(change.gear, change.slip_rad_s)

    def locked(self, gear: MainGear, slip_rad_s: float) -> None:
        """The gear has just locked after its tooth met a flank at this slip, 0 if that is not
        known: begin to watch it."""
        certain = abs(slip_rad_s) >= FLANK_SLIP_RAD_S
        self.watched = Watched(gear, int(math.copysign(certain, slip_rad_s)))

    def watches(self, gear: MainGear) -> bool:
        """Whether measurements of this gear are wanted."""
        watched = self.watched
        return (
            watched is not None
            and watched.gear is gear
            and watched.measurements < MOST_MEASUREMENTS
        )

    def measure(
        self, gear: MainGear, theta_layshaft: float, theta_main: float, sd_rad: float
    ) -> None:
        """One measurement at the gear that is watched, however vague: it counts by its standard
        deviation."""
        watched, dog = self.watched, self._sheet.dog
        if watched is None or watched.gear is not gear:
            return
        flank = watched.flank if watched.counted < CARRIED_MEASUREMENTS else 0
        watched.measurements += 1
        ratio = self._sheet.main_mesh(gear).ratio
        gap = self._gaps.setdefault(gear, GapPosterior(dog.pitch_rad, dog.backlash_rad))
        raw_rad = raw_phase_rad(ratio, theta_layshaft, theta_main)
        watched.counted += gap.measure(raw_rad, sd_rad, flank)

    def settle(self, gear: MainGear) -> bool:
        """Takes over what the measurements show; true where that is a reference, or another one
        than before."""
        gap = self._gaps.get(gear)
        middle = None if gap is None else gap.middle()
        if middle is None:
            return False
        if gear in self._adopted and middle.sd_rad > self._other_rad:
            return False
        is_new = self.source(gear) is not ReferenceSource.MEASURED
        moved_rad = self._offset_rad.get(gear, 0.0) - middle.raw_rad
        off = wrap_to_pitch(moved_rad, self._sheet.dog.pitch_rad)
        self._offset_rad[gear], self._sd_rad[gear] = middle
        self._adopted.pop(gear, None)
        return is_new or abs(off) > self._other_rad

    def released(self) -> MainGear | None:
        """The gear leaves the mesh. Returns it where it was watched."""
        watched, self.watched = self.watched, None
        if watched is None:
            return None
        if watched.counted == 0:
            self._unseen.add(watched.gear)
        return watched.gear

    @property
    def offsets_rad(self) -> dict[MainGear, float]:
        """The constants by gear that are certain."""
        return {gear: at for gear, at in self._offset_rad.items() if self.certain(gear)}

    def adopt(self, gear: MainGear, offset_rad: float, source: ReferenceSource) -> None:
        """Takes a constant (rad) that was derived without the gear in mesh."""
        self._offset_rad[gear] = offset_rad
        self._adopted[gear] = source

    def source(self, gear: MainGear) -> ReferenceSource:
        """Where a gear's constant came from; while it is unknown, why."""
        if gear in self._offset_rad:
            return self._adopted.get(gear, ReferenceSource.MEASURED)
        return ReferenceSource.UNSEEN if gear in self._unseen else ReferenceSource.NONE

    def lose(self, gear: MainGear) -> None:
        """Drops one gear's constant, because it was wrong."""
        self._offset_rad.pop(gear, None)
        self._adopted.pop(gear, None)
        self._gaps.pop(gear, None)

    def lose_all(self) -> None:
        """Drops all constants, because a wheel's count was lost."""
        self._offset_rad.clear()
        self._adopted.clear()
        self._gaps.clear()
        self._unseen.clear()
        self.watched = None

    @property
    def mask(self) -> int:
        """Bit 0 crawl, 1 first, 2 second, 3 third, as the status frame reports them."""
        return sum(1 << (gear - 1) for gear in self._offset_rad)
