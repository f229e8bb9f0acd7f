"""Hostile frames against controller and rig in virtual time.

`fuzz_frames.py COUNT [SEED [EACH [EVERY]]]`: EACH of them with every EVERY-th frame of the bus.

Blocks of half a second with them and a second without. In the first an accident's frames go to a
loop as it is, in the second an attacker's to one whose commands are proven. Held in every block: no
exception, no forbidden state in the plant; after it, at the latest 100 ms later, the valve side
takes commands and the controller has all its inputs, and a shift that is asked for is made.
"""

from __future__ import annotations

import math
import random
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

from forged_commands import KEYS
from hostile import ACCIDENTS, ATTACKS, BENCH, COMMANDS, Hostile
from loop_bench import PHASES_US, Operator

from meshpoint.base.provenance import product_version
from meshpoint.bench.bench import plan_shifts
from meshpoint.bench.virtual_time import VirtualTime
from meshpoint.bus.authentication.cores import ProvingCore, VerifyingCore
from meshpoint.bus.core import Core, Step
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.header import new_header
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import (
    ClutchCommand,
    ControllerState,
    ControllerStatus,
    ShiftOutcome,
    ValveCommand,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import Preset, RigSettings

SETTLE_US = 600_000
HOSTILE_US = 500_000
QUIET_US = 3_000_000
SHIFT_US = 700_000
REST_US = 500_000
LAYSHAFT_RAD_S = 1_400.0 * math.pi / 30.0
AT_REST = (ControllerState.IN_GEAR, ControllerState.NEUTRAL)
BACK_LIMIT_MS = 100.0
GEARS = (10, 8)


class Flood(NamedTuple):
    """This many hostile frames with every so-many-th frame of the bus."""

    each: int = 64
    every: int = 16


SPARSE = Flood(1, 100)
"""One now and then, between which a shift goes on."""


class Flooded:
    """A node that hears hostile frames besides."""

    def __init__(self, core: Core, hostile: Hostile, flood: Flood) -> None:
        self.core = core
        self.is_flooded = False
        self.count = 0
        self._hostile = hostile
        self._flood = flood
        self._heard = 0

    @property
    def next_step_us(self) -> int:
        return self.core.next_step_us

    def receive(self, frame: Frame) -> None:
        self._hostile.hear(frame)
        self.core.receive(frame)
        self._heard += 1
        if self.is_flooded and self._heard % self._flood.every == 0:
            made = self._hostile.frames(self._flood.each)
            self.count += len(made)
            for other in made:
                self.core.receive(other)

    def step(self, now_us: int) -> Step:
        return self.core.step(now_us)

    def shutdown(self, now_us: int) -> Step:
        return self.core.shutdown(now_us)


@dataclass
class Found:
    """What came of it."""

    frames: int = 0
    violations: int = 0
    back_ms: list[float] = field(default_factory=list)
    results: Counter[str] = field(default_factory=Counter)
    """How the shifts ended that were asked for after the flood."""
    kinds: Counter[str] = field(default_factory=Counter)

    @property
    def is_good(self) -> bool:
        return (
            self.violations == 0
            and max(self.back_ms, default=0.0) <= BACK_LIMIT_MS
            and set(self.results) <= {"engaged"}
        )


class Fuzz:
    """One loop with its flood."""

    def __init__(self, seed: int, proven: bool, flood: Flood) -> None:
        sheet = load_sheet("thesis")
        header = new_header(product_version(), sheet, ControllerSettings())
        main_rpm = plan_shifts(sheet, [(8, 10)], 1, LAYSHAFT_RAD_S)[0].main_rpm
        settings = RigSettings(
            preset=Preset.TRUCK, seed=seed % 1000, start_gear=8, main_speed_rpm=main_rpm
        )
        self.rig = RigCore(sheet, settings)
        self.controller = ControllerCore(header)
        draw = self._draw = random.Random(seed)
        controller: Core = self.controller
        rig: Core = self.rig
        if proven:
            controller = ProvingCore(controller, KEYS)
            rig = VerifyingCore(rig, KEYS, lambda: draw.getrandbits(64))
        # Without proof E2E is no defence against somebody who knows it: accidents alone.
        kinds = ATTACKS if proven else ACCIDENTS
        spared = BENCH if proven else BENCH | COMMANDS
        hostile = [Hostile(seed + k, kinds, spared) for k in range(2)]
        self.nodes = [
            Flooded(core, h, flood) for core, h in zip((controller, rig), hostile, strict=True)
        ]
        self.hostile = hostile
        self.operator = Operator([])
        self.found = Found()
        self._decoder = Receiver(*Node)
        self.status: ControllerStatus | None = None
        self._outcome: ShiftOutcome | None = None
        self.time = VirtualTime([*self.nodes, self.operator], PHASES_US, self._take)

    def _take(self, _time_us: int, frame: Frame) -> None:
        message = self._decoder.receive(frame).message
        if type(message) is ControllerStatus:
            self.status = message
        elif type(message) is ShiftOutcome:
            self._outcome = message

    def is_back(self) -> bool:
        """The valve side takes commands, and the controller has all that a shift needs."""
        valve_side = self.rig.receiver
        return (
            valve_side.valid(ValveCommand)
            and valve_side.valid(ClutchCommand)
            and self.controller._receiver.invalid_channels == 0
        )

    def _is_at_rest(self) -> bool:
        status = self.status
        return status is not None and status.state in AT_REST

    def run(self, for_us: int) -> None:
        self.time.run(lambda: False, self.time.now_us + for_us)

    def blocks(self, frames: int) -> Found:
        """Until this many hostile frames were heard."""
        while self.found.frames < frames:
            self.block()
        return self.found

    def block(self) -> None:
        """One flood, and what comes of it."""
        if self.time.now_us == 0:
            self.run(SETTLE_US)
        self._block(GEARS[len(self.found.back_ms) % 2])
        self.found.kinds = sum((hostile.made for hostile in self.hostile), Counter())
        self.found.violations = sum(self.rig.truth.violations.values())

    def _block(self, gear: int) -> None:
        """A flood, sometimes into a shift; then a shift that is asked for once all is at rest."""
        if self._draw.random() < 0.5:
            self._ask(gear)
            self.run(self._draw.randrange(SHIFT_US))
        self._flood(HOSTILE_US)
        ended_us = self.time.now_us
        self.time.run(self.is_back, ended_us + QUIET_US)
        self.found.back_ms.append((self.time.now_us - ended_us) / 1e3)
        self.time.run(self._is_at_rest, self.time.now_us + REST_US)
        self.run(REST_US)
        status = self.status
        if status is None or status.state not in AT_REST:
            self.found.results["not at rest"] += 1
            return
        self._outcome = None
        self._ask(GEARS[0] if status.current_gear == GEARS[1] else GEARS[1])
        self.time.run(lambda: self._outcome is not None, self.time.now_us + QUIET_US)
        result = "none" if self._outcome is None else self._outcome.result.name.lower()
        self.found.results[result] += 1

    def shift_among(self, shifts: int) -> Found:
        """Shifts, one after the other, that hostile frames come into."""
        self.run(SETTLE_US)
        for k in range(shifts):
            self._ask(GEARS[k % 2])
            self.run(self._draw.randrange(SHIFT_US))
            self._flood(2 * SHIFT_US)
            self.run(REST_US)
        self.found.violations = sum(self.rig.truth.violations.values())
        return self.found

    def _flood(self, for_us: int) -> None:
        for node in self.nodes:
            node.is_flooded = True
        self.run(for_us)
        for node in self.nodes:
            node.is_flooded = False
            self.found.frames += node.count
            node.count = 0

    def _ask(self, gear: int) -> None:
        self.operator.ask(gear, self.time.now_us)


def main(argv: list[str]) -> int:
    """Half of the frames without proof, half with it, by turns; 1 where something is not as it must
    be. Interrupted, it says how far it came, and ends with 130."""
    count, seed = int(argv[0]), int(argv[1]) if len(argv) > 1 else 1
    flood = Flood(*map(int, argv[2:4]))
    began_s, ended = time.monotonic(), 0
    both = {proven: Fuzz(seed, proven, flood) for proven in (False, True)}
    try:
        while any(fuzz.found.frames < count // 2 for fuzz in both.values()):
            for fuzz in both.values():
                fuzz.block()
    except KeyboardInterrupt:
        ended = 130
    for proven, fuzz in both.items():
        found = fuzz.found
        print(
            f"{'proven commands, attacker' if proven else 'no proof, accidents'}: {found.frames} "
            f"hostile frames {dict(found.kinds)} in {len(found.back_ms)} floods, "
            f"{fuzz.time.now_us / 1e6:.0f} s of bus time; 0 crashes, {found.violations} forbidden "
            f"states, back after {max(found.back_ms, default=0.0):.1f} ms at most, shifts after it "
            f"{dict(found.results)}"
        )
    good = all(fuzz.found.is_good for fuzz in both.values())
    said = "interrupted, good so far" if ended and good else "good" if good else "NOT GOOD"
    print(f"{said}, {time.monotonic() - began_s:.0f} s")
    return ended if good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
