"""Phase references that were lost with the tooth numbers, and how they come back.

A reference is a constant between counted angles, so it is worth nothing once a wheel is numbered
anew, until the wheel's tooth pattern is found again (`tooth_match`). Remembered tooth t + k being
present tooth t on both wheels, the reference of a gear with mesh ratio i = z1/z2 is

    offset = remembered - i (k_L pitch_L + 2 pi N) + k_M pitch_M    (modulo the dog teeth's pitch)

with N the layshaft's whole turns since, which no sensor wheel can tell. N matters modulo
n = z2 / gcd(z2, z1 x dog teeth): one candidate where that is 1, else n of them, one pitch / n
apart. The gears are fixed to one layshaft, so N is the same for all: each gear that is learned
leaves fewer candidates to the others, where their n have a common factor (design: two gears of
coprime n tell nothing of each other). Turns of the main shaft do not matter: the sleeve's teeth
turn with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from controller.kinematics import wrap_to_pitch
from controller.reference import PhaseReferences
from controller.teeth import WheelTeeth
from controller.tooth_match import Memory
from gearbox import GearboxSheet, MainGear
from gearbox.gears import MAIN_GEARS

TURN: Final = 2.0 * math.pi
AGREES_SHARE: Final = 0.2
"""Two references of one gear learned apart differ by less than this share of the backlash."""


class Kept(NamedTuple):
    """Tooth patterns and the references in their numbering: what outlives a restart."""

    layshaft: Memory | None
    main: Memory | None
    offsets_rad: dict[MainGear, float]


@dataclass
class _Wheel:
    """A wheel, and its remembered tooth number less the present one; None while not known."""

    name: str
    teeth: WheelTeeth
    pitch_rad: float
    shift: int | None = 0
    base: int = 0
    """The shift of the numbering that the wheel's own memory is in."""

    @property
    def hopeless(self) -> bool:
        """Nothing is left by which its old numbers could be found."""
        return self.shift is None and self.teeth.memory is None and self.teeth.found is None

    def kept(self) -> Memory | None:
        """Its pattern in the remembered numbering."""
        teeth, memory = self.teeth, self.teeth.memory
        if self.shift is None and memory is not None:
            return Memory(np.roll(memory.error_rad, 2 * self.base), memory.sd_rad, memory.edges)
        if not teeth.learned:
            return memory
        turned = np.roll(teeth.error_rad, 2 * (self.shift or 0))
        return Memory(turned, teeth.sd_rad, teeth.edges_seen)


def turn_candidates(sheet: GearboxSheet, gear: MainGear) -> int:
    """After how many turns of the layshaft a gear's dog teeth stand as before."""
    mesh = sheet.main_mesh(gear)
    return mesh.driven // math.gcd(mesh.driven, mesh.driving * sheet.dog.teeth)


class Recall:
    """The references of a numbering that was lost, and what is known of it by now."""

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
        """No turn of the layshaft has gone uncounted."""
        self._turns: dict[MainGear, set[int]] = {}
        """Possible N of each gear, modulo its n; empty until both wheels were found."""
        self._from_memory: set[MainGear] = set()

    def restore(self, kept: Kept) -> None:
        """Patterns and references of an earlier run."""
        self._remembered, self._same_turn = dict(kept.offsets_rad), False
        for wheel, memory in zip(self._wheels, (kept.layshaft, kept.main), strict=True):
            wheel.teeth.memory = memory
            wheel.shift, wheel.base = None, 0

    def lost(self, layshaft: bool, main: bool) -> None:
        """A wheel's numbers are lost; its teeth have not been told yet."""
        broken = [wheel for wheel, lost in zip(self._wheels, (layshaft, main), strict=True) if lost]
        if not self._pending:
            self._start(self._references.offsets_rad)
        for wheel in broken:
            if wheel.teeth.learned is (wheel.shift is None):
                # No pattern of this numbering, or of its relation to the remembered one.
                self._remembered = {}
            elif wheel.shift is not None:
                wheel.base = wheel.shift
            wheel.shift = None
        if layshaft:
            self._same_turn = False
        self._turns.clear()
        self._from_memory.clear()
        self._references.lose_all()

    @property
    def _pending(self) -> bool:
        return any(wheel.shift is None for wheel in self._wheels)

    def _start(self, remembered: dict[MainGear, float]) -> None:
        """The present numbering is the one to remember."""
        self._remembered, self._same_turn = remembered, True
        self._turns.clear()
        self._from_memory.clear()
        for wheel in self._wheels:
            wheel.shift, wheel.base = 0, 0

    def look(self, events: list[str]) -> None:
        """Takes what the wheels have found since the last step."""
        waiting = self._pending
        for wheel in self._wheels:
            found, wheel.teeth.found = wheel.teeth.found, None
            if found is None:
                continue
            events.append(f"{wheel.name} teeth found again: tooth 0 was {found.teeth}")
            if wheel.shift is None:
                wheel.shift = wheel.base + found.teeth
        if any(wheel.hopeless for wheel in self._wheels):
            self._start({})
        elif waiting and not self._pending:
            self._begin(events)

    def _begin(self, events: list[str]) -> None:
        """Both wheels are numbered as before, up to turns of the layshaft."""
        for gear in self._remembered:
            turns = range(1 if self._same_turn else turn_candidates(self._sheet, gear))
            self._turns[gear] = set(turns)
        for gear in list(self._references.offsets_rad):
            self.learned(gear, events)
        self._use(events)

    def learned(self, gear: MainGear, events: list[str]) -> None:
        """A gear's reference has just been learned: how many turns agree with it?"""
        if gear not in self._turns:
            return
        self._from_memory.discard(gear)
        dog, offset = self._sheet.dog, self._references.offsets_rad[gear]
        agreeing = {
            turn
            for turn in self._turns[gear]
            if abs(wrap_to_pitch(self._predicted(gear, turn) - offset, dog.pitch_rad))
            < AGREES_SHARE * dog.backlash_rad
        }
        if not agreeing:
            events.append("remembered phase references do not agree with the gearbox: forgotten")
            for other in self._from_memory:
                self._references.lose(other)
            self._start({})
            return
        self._turns[gear] = agreeing
        self._narrow()
        self._use(events)

    def _narrow(self) -> None:
        """What is left of one gear's turns leaves fewer to the others."""
        n = {gear: turn_candidates(self._sheet, gear) for gear in self._turns}
        for _ in MAIN_GEARS:
            for gear, turns in self._turns.items():
                for other, others in self._turns.items():
                    common = math.gcd(n[gear], n[other])
                    if not self._same_turn and common > 1:
                        turns &= {t for t in turns if any((t - s) % common == 0 for s in others)}

    def _use(self, events: list[str]) -> None:
        for gear, turns in self._turns.items():
            if len(turns) == 1 and not self._references.known(gear):
                self._references.adopt(gear, self._predicted(gear, next(iter(turns))))
                self._from_memory.add(gear)
                events.append(f"phase reference of {gear.name.lower()} found again")

    def _predicted(self, gear: MainGear, turn: int) -> float:
        layshaft, main = self._wheels
        ratio = self._sheet.main_mesh(gear).ratio
        moved = (layshaft.shift or 0) * layshaft.pitch_rad + turn * TURN
        return self._remembered[gear] - ratio * moved + (main.shift or 0) * main.pitch_rad

    def candidates(self, gear: MainGear) -> int:
        """How many phases of this gear are possible; 0 where nothing is remembered of it."""
        return 1 if self._references.known(gear) else len(self._turns.get(gear, ()))

    def kept(self) -> Kept:
        """What is worth keeping: the remembered numbering while it may still be found again, else
        the present one."""
        if not self._pending:
            both = all(wheel.teeth.learned for wheel in self._wheels)
            layshaft, main = (_now(wheel.teeth) for wheel in self._wheels)
            return Kept(layshaft, main, self._references.offsets_rad if both else {})
        layshaft, main = (wheel.kept() for wheel in self._wheels)
        whole = layshaft is not None and main is not None
        return Kept(layshaft, main, self._remembered if whole else {})


def _now(teeth: WheelTeeth) -> Memory | None:
    """A wheel's pattern in the present numbering; that of its memory where it has no other."""
    if teeth.learned:
        return Memory(teeth.error_rad, teeth.sd_rad, teeth.edges_seen)
    return teeth.memory
