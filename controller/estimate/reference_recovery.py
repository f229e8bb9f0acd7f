"""Phase references that were lost with the tooth numbers, and how they come back.

A reference is a constant between counted angles, so it is unusable once a wheel's teeth are
numbered anew, until the wheel's tooth pattern is recognised (`teeth`). Remembered tooth t + k
being present tooth t on both wheels, the reference of a gear with mesh ratio i = z1/z2 is

    offset = remembered - i (k_L pitch_L + 2 pi N) + k_M pitch_M    (modulo the dog teeth's pitch)

with N the layshaft's whole turns since, one number for all gears. The set of possible N is kept for
all gears together (`reference.TurnSet`); each gear whose reference is measured excludes the N that
contradict it. A gear whose phase is the same for all remaining N is known without having been in
mesh. If no N remains, the remembered references are wrong: they are dropped, with a line in the
log.

A gear that has just locked is watched until its phase reference is known. A measurement is both
shafts' angles at the newest edge: there nothing is extrapolated, so an impact causes the least
error.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.estimate.reference import (
    LEARNED_SD_RAD,
    PhaseReferences,
    TurnSet,
    all_turns,
    any_one,
    narrowed,
    turn_candidates,
    without,
)
from meshpoint.controller.estimate.teeth import ToothPattern, WheelTeeth
from meshpoint.controller.measure.wheel_edges import Renumbered
from meshpoint.controller.models.layshaft import LayshaftState
from meshpoint.controller.models.swing import ShaftState
from meshpoint.dbc.messages import ReferenceSource
from meshpoint.gearbox import GearboxSheet, MainGear
from meshpoint.gearbox.kinematics import wrap_to_pitch
from meshpoint.units import TURN

AGREES_SDS: Final = 4.0
MOST_COUNTED: Final = 1000
"""Largest number of candidate turns of the layshaft that a sensor's count may leave."""
_WHY: Final = {
    ReferenceSource.RESTORED: "with the tooth numbers",
    ReferenceSource.NARROWED: "by the gears in mesh",
}

LOOKED_AT_US: Final = 185_000
"""Before it has been looked at for so long, 0.2 s but for the time from an edge to its read,
nothing is concluded of a gear that stays in mesh: its tooth may still be on its way to a flank."""


class SavedReferences(NamedTuple):
    """What is kept over a restart: tooth patterns, and the references (rad) in their numbering."""

    layshaft: ToothPattern | None
    main: ToothPattern | None
    offsets_rad: dict[MainGear, float]


@dataclass
class _Wheel:
    """A wheel, and its remembered tooth number less the present one; None while not known."""

    name: str
    teeth: WheelTeeth
    pitch_rad: float
    shift: int | None = 0
    base: int = 0
    """The shift that belongs to the numbering of the wheel's remembered pattern."""

    @property
    def unrecoverable(self) -> bool:
        """Whether its old numbering can no longer be found."""
        return self.shift is None and self.teeth.memory is None and self.teeth.found is None

    def saved(self) -> ToothPattern | None:
        """Its pattern in the remembered numbering."""
        pattern, teeth = self.teeth.pattern, (self.shift or 0) if self.teeth.learned else 0
        if self.shift is None and self.teeth.memory is not None:
            pattern, teeth = self.teeth.memory, self.base
        if pattern is None:
            return None
        return pattern._replace(error_rad=np.roll(pattern.error_rad, 2 * teeth))


class ReferenceRecovery:
    """Finds the references of a lost numbering again."""

    def __init__(
        self,
        sheet: GearboxSheet,
        references: PhaseReferences,
        layshaft: WheelTeeth,
        main: WheelTeeth,
    ) -> None:
        self._sheet = sheet
        self._references = references
        self._layshaft = _Wheel("layshaft", layshaft, sheet.wheels.layshaft.pitch_rad)
        self._main = _Wheel("main shaft", main, sheet.wheels.main.pitch_rad)
        self._wheels = (self._layshaft, self._main)
        self._remembered: dict[MainGear, float] = {}
        self._same_turn = True
        """Whether every turn of the layshaft since the references were remembered was counted."""
        self._turns: TurnSet = all_turns({})
        """Possible numbers of uncounted turns, for the gears whose phase depends on them."""
        self._renumbered = Renumbered()
        self._counted_from: Renumbered | None = None
        """The sensor's count when the references were remembered; None if it gives no bound."""
        self._found = False
        """Whether both wheels' numbering is known again, so that candidates can be excluded."""

    def restore(self, saved: SavedReferences) -> None:
        """Patterns and references of an earlier run."""
        self._remembered, self._same_turn = dict(saved.offsets_rad), False
        self._turns, self._found = all_turns({}), False
        self._counted_from = None
        for wheel, memory in zip(self._wheels, (saved.layshaft, saved.main), strict=True):
            wheel.teeth.memory = memory
            wheel.shift, wheel.base = None, 0

    def lost(self, layshaft: bool, main: bool) -> None:
        """The tooth numbers of the layshaft's or the main shaft's wheel are lost. Call it before
        the teeth are numbered again."""
        broken = [wheel for wheel, lost in zip(self._wheels, (layshaft, main), strict=True) if lost]
        if not self._pending:
            self._remember(turns_lost=layshaft)
        for wheel in broken:
            if wheel.teeth.learned is (wheel.shift is None):
                # This numbering has no pattern, or its shift to the remembered one is unknown.
                self._remembered = {}
            elif wheel.shift is not None:
                wheel.base = wheel.shift
            wheel.shift = None
        if layshaft:
            self._same_turn = False
            self._remembered, self._turns = self._without_waiting(), all_turns({})
        self._found = False
        self._references.lose_all()

    def _without_waiting(self) -> dict[MainGear, float]:
        """The remembered references without those of gears that depend on uncounted turns."""
        waiting = self._turns.moduli
        return {gear: at for gear, at in self._remembered.items() if gear not in waiting}

    @property
    def _pending(self) -> bool:
        return any(wheel.shift is None for wheel in self._wheels)

    def _remember(self, turns_lost: bool) -> None:
        """Before numbers are lost: remembers the references in the present numbering, those of
        gears included that still depend on uncounted turns, as far as these can still be
        resolved."""
        known, open_ = self._references.offsets_rad, self._open()
        if turns_lost:
            remembered = self._in_present_numbering()
            self._start(remembered)
            if remembered.keys() != known.keys():
                # Turns counted from here on do not resolve gears that depend on earlier ones.
                self._counted_from = None
            return
        at_zero = {gear: self._predicted(gear, 0) for gear in open_.moduli}
        self._start(at_zero | known)
        self._turns = open_

    def _open(self) -> TurnSet:
        """The turns that remain possible for gears whose reference is not known."""
        return without(self._turns if self._found else all_turns({}), self._references.offsets_rad)

    def _in_present_numbering(self) -> dict[MainGear, float]:
        """The references that stay usable when the layshaft's turns are lost: the known ones, and
        the others for one arbitrary possible turn. The latter are consistent with the known ones
        only if each known gear allows a single residue; otherwise they are left out."""
        known, turns = self._references.offsets_rad, self._turns
        if not self._found or not all(len(turns.candidates(gear)) == 1 for gear in known):
            return known
        one = any_one(turns)
        return {gear: self._predicted(gear, turn) for gear, turn in one.items()} | known

    def _start(self, remembered: dict[MainGear, float]) -> None:
        """Remembers these references in the present numbering."""
        self._counted_from = self._renumbered
        self._remembered, self._same_turn, self._found = remembered, True, False
        self._turns = all_turns({})
        for wheel in self._wheels:
            wheel.shift, wheel.base = 0, 0

    def measure(self, events: list[str], renumbered: Renumbered) -> None:
        """Takes the patterns recognised since the last step, and the sensor's count of the
        layshaft's teeth. Adds lines for the log to `events`."""
        self._renumbered = renumbered
        waiting = self._pending
        for wheel in self._wheels:
            found, wheel.teeth.found = wheel.teeth.found, None
            if found is None:
                continue
            events.append(f"{wheel.name} teeth found again: tooth 0 was {found.teeth}")
            if wheel.shift is None:
                wheel.shift = wheel.base + found.teeth
        if any(wheel.unrecoverable for wheel in self._wheels):
            self._start({})
        elif waiting and not self._pending:
            self._begin(events)

    def _begin(self, events: list[str]) -> None:
        """Both wheels' numbering is known again, except for whole turns of the layshaft."""
        if not self._same_turn:
            moduli = {gear: turn_candidates(self._sheet, gear) for gear in self._remembered}
            self._turns = all_turns(moduli, self._counted_turns())
        self._found = True
        for gear in list(self._references.offsets_rad):
            self.learned(gear, 0.0, events)
        self._use(ReferenceSource.RESTORED, events)

    def _counted_turns(self) -> range | None:
        """Turns of the layshaft that agree with the sensor's count; None if it gives no bound, or
        none that agrees with the teeth."""
        start, now = self._counted_from, self._renumbered
        if start is None or start.uncounted != now.uncounted:
            return None
        teeth, shift = self._layshaft.teeth.count, self._layshaft.shift or 0
        least = -((shift - (now.least - start.least)) // teeth)
        most = (now.most - start.most - shift) // teeth
        return range(least, most + 1) if 0 <= most - least < MOST_COUNTED else None

    def learned(self, gear: MainGear, sd_rad: float, events: list[str]) -> None:
        """A gear's reference has just been measured: excludes the turns that contradict it.

        sd_rad: standard deviation of the measured phase. Log lines are added to `events`."""
        if not self._found or gear not in self._remembered:
            return
        offset = self._references.offsets_rad.get(gear)
        if offset is None:
            return
        pitch_rad = self._sheet.dog.pitch_rad
        tolerance = AGREES_SDS * math.hypot(LEARNED_SD_RAD, sd_rad)
        self._exclude(
            gear, lambda at: abs(wrap_to_pitch(at - offset, pitch_rad)) < tolerance, events
        )

    def _exclude(self, gear: MainGear, agrees: Callable[[float], bool], events: list[str]) -> None:
        """Excludes turns for which a gear's reference (rad) does not agree."""

        def is_possible(turn: int) -> bool:
            return agrees(self._predicted(gear, turn))

        if gear in self._turns.moduli:
            self._turns = narrowed(self._turns, gear, is_possible)
        if self._turns.empty or not (gear in self._turns.moduli or is_possible(0)):
            self._drop(gear, events)
        else:
            self._use(ReferenceSource.NARROWED, events)

    def _drop(self, gear: MainGear, events: list[str]) -> None:
        """A gear in mesh contradicts all candidates: the measurement is kept, the memory
        dropped."""
        forgotten = [other.name.lower() for other in self._remembered if other is not gear]
        for other in self._references.offsets_rad:
            if self._references.source(other) is not ReferenceSource.MEASURED:
                self._references.lose(other)
        self._start({})
        events.append(
            f"remembered phase references do not agree with {gear.name.lower()} in mesh: forgotten"
            f" ({', '.join(forgotten) or 'no other'})"
        )

    def _use(self, source: ReferenceSource, events: list[str]) -> None:
        """Adopts the references of gears whose phase is the same for all remaining turns."""
        for gear in self._remembered:
            if self._references.certain(gear):
                continue
            offset = self._agreed(gear)
            if offset is not None:
                self._references.adopt(gear, offset, source)
                events.append(
                    f"phase reference of {gear.name.lower()} found again ({_WHY[source]})"
                )

    def _agreed(self, gear: MainGear) -> float | None:
        """The middle of a gear's candidate references if these are equal within LEARNED_SD_RAD."""
        first, *others = (self._predicted(gear, turn) for turn in self._turns_of(gear))
        pitch_rad = self._sheet.dog.pitch_rad
        away = [0.0, *(wrap_to_pitch(other - first, pitch_rad) for other in others)]
        if max(away) - min(away) > LEARNED_SD_RAD:
            return None
        return first + (max(away) + min(away)) / 2.0

    def _turns_of(self, gear: MainGear) -> frozenset[int]:
        """Possible N of a gear, modulo its n; only 0 if all turns were counted."""
        if not self._found or gear not in self._remembered:
            return frozenset()
        return self._turns.candidates(gear) or frozenset({0})

    def _predicted(self, gear: MainGear, turn: int) -> float:
        layshaft, main = self._wheels
        ratio = self._sheet.main_mesh(gear).ratio
        moved = (layshaft.shift or 0) * layshaft.pitch_rad + turn * TURN
        return self._remembered[gear] - ratio * moved + (main.shift or 0) * main.pitch_rad

    def candidates(self, gear: MainGear) -> int:
        """Number of possible phases of this gear; 0 if no reference of it is remembered."""
        return 1 if self._references.certain(gear) else len(self._turns_of(gear))

    def saved(self) -> SavedReferences:
        """What to keep for the next run: the remembered numbering while it may still be found
        again, else the present one."""
        if not self._pending:
            both = all(wheel.teeth.learned for wheel in self._wheels)
            layshaft, main = (wheel.teeth.pattern for wheel in self._wheels)
            return SavedReferences(layshaft, main, self._in_present_numbering() if both else {})
        layshaft, main = (wheel.saved() for wheel in self._wheels)
        whole = layshaft is not None and main is not None
        return SavedReferences(layshaft, main, self._without_waiting() if whole else {})


class LockedGear:
    """What is seen of a gear in mesh whose phase is looked for."""

    def __init__(
        self, sheet: GearboxSheet, references: PhaseReferences, recovery: ReferenceRecovery | None
    ) -> None:
        """recovery: what outlives lost tooth numbers; None for estimators that know no teeth."""
        self._sheet = sheet
        self._references = references
        self._recovery = recovery
        self._looked_us = 0.0
        """The newest edge at the latest measurement."""
        self._since_us = 0.0
        """The same at the first measurement of the gear that is watched."""

    def is_due(self, newest_us: float) -> bool:
        """Whether there are edges since the latest measurement: a step between two reads has
        none."""
        is_new, self._looked_us = newest_us != self._looked_us, newest_us
        return is_new

    def measure(
        self, gear: MainGear, layshaft: LayshaftState, main: ShaftState, events: list[str]
    ) -> None:
        """One measurement."""
        ratio = self._sheet.main_mesh(gear).ratio
        sd_rad = math.hypot(ratio * layshaft.theta_sd_rad, main.theta_sd_rad)
        references = self._references
        references.measure(gear, layshaft.theta_rad, main.theta_rad, sd_rad)
        watched = references.watched
        if watched is not None and watched.measurements == 1:
            self._since_us = layshaft.time_us
        if watched is not None and layshaft.time_us - self._since_us >= LOOKED_AT_US:
            self._settle(gear, events)

    def released(self, events: list[str]) -> None:
        """No gear is in mesh any more."""
        gear = self._references.released()
        if gear is None or self._settle(gear, events) or self._references.known(gear):
            return
        name = gear.name.lower()
        events.append(f"phase reference of {name} not learned: its tooth was not seen in mesh")

    def _settle(self, gear: MainGear, events: list[str]) -> bool:
        """Whether the gear's reference has just been learned."""
        if not self._references.settle(gear):
            return False
        events.append(f"phase reference of {gear.name.lower()} learned")
        if self._recovery is not None:
            self._recovery.learned(gear, self._references.sd_rad(gear), events)
        return True
