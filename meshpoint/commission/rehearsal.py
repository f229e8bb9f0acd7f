"""Commissioning rehearsed on drawn gearboxes in virtual time, some of them miswired."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from meshpoint.bench.virtual_time import VirtualTime
from meshpoint.bus.core import AroundCore, Core, Step
from meshpoint.commission.core import CommissionCore
from meshpoint.commission.drawn import withheld
from meshpoint.commission.finding import Finding, Verdict
from meshpoint.commission.roles import GROUP as TURNING
from meshpoint.commission.roles import judge_turning
from meshpoint.commission.shafts import EDGES, Shaft, ShaftCounts
from meshpoint.commission.trial import EXPECTED
from meshpoint.commission.verdict import judge_outputs, judge_wheels
from meshpoint.commission.whole import WholeCommission, wires_of
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Receiver, Transmitter
from meshpoint.dbc.messages import (
    Message,
    SleevesAux,
    SleevesMain,
    ValveAction,
    ValveCommand,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import Sleeve
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import DEFAULT_PROFILE, Preset, Profile, RigSettings
from meshpoint.rig_sim.truck.stand import STAND

MISWIRED_SHARE: Final = 0.1
TURN_US: Final = 3_000_000
LIMIT_US: Final = 120_000_000
TURNED_LIMIT_US: Final = 400_000_000
MAIN_RPM: Final = 600.0
EDGES_OF: Final = {place: message for message, place in EDGES.items()}
POSITION_PAIRS: Final = (
    (Sleeve.FIRST_SECOND, Sleeve.CRAWL_THIRD),
    (Sleeve.SPLITTER, Sleeve.RANGE),
)
POSITION_FIELDS: Final[dict[type[Message], dict[Sleeve, str]]] = {
    SleevesMain: {
        Sleeve.FIRST_SECOND: "sleeve_first_second_m",
        Sleeve.CRAWL_THIRD: "sleeve_crawl_third_m",
    },
    SleevesAux: {Sleeve.SPLITTER: "sleeve_splitter_m", Sleeve.RANGE: "sleeve_range_m"},
}
VALVES: Final = CODECS[ValveCommand.__name__]


@dataclass(frozen=True)
class Miswiring:
    """What is wrong with a drawn box's wires; all None: nothing."""

    valves: tuple[ValveName, ValveName] | None = None
    """These two outputs are exchanged."""
    dead: ValveName | None = None
    """This output is not connected."""
    sensors: tuple[Shaft, Shaft] | None = None
    """These two wheels' sensors are exchanged."""
    positions: tuple[Sleeve, Sleeve] | None = None
    """These two sleeves' position sensors are exchanged: of both main sleeves, or of splitter and
    range."""
    mirrored: Sleeve | None = None
    """This sleeve's position sensor is mounted the other way round."""

    @property
    def is_any(self) -> bool:
        """Whether anything is wrong."""
        return self != Miswiring()

    def is_named_by(self, findings: list[Finding]) -> bool:
        """Whether the findings name it: the outputs or wheels concerned, and no others."""
        bad = {f.subject: f.text for f in findings if f.verdict is Verdict.BAD}
        if self.dead is not None:
            return set(bad) == {self.dead.name.lower()} and "nothing" in bad[self.dead.name.lower()]
        if self.valves is not None:
            a, b = (valve.name.lower() for valve in self.valves)
            places = {a: b, b: a}
            return set(bad) == set(places) and all(
                f"in place of {there}" in bad[name] for name, there in places.items()
            )
        if self.sensors is not None:
            a, b = self.sensors
            return f"sensors of {a} and {b} are exchanged" in bad.get("explanation", "")
        return not bad

    def is_reported_by(self, findings: list[Finding]) -> bool:
        """The same of a box that was turned, where it can be distinguished from all else."""
        turned = {f.subject: f.text for f in findings if f.group == TURNING and f.verdict == "bad"}
        others = [f for f in findings if f.group != TURNING]
        if self.sensors is not None:
            a, b = self.sensors
            text = "the sensors of {} and {} are exchanged"
            reported = {
                f"{a} sensor turned": text.format(a, b),
                f"{b} sensor turned": text.format(b, a),
            }
            return turned == reported and Miswiring().is_named_by(others)
        sleeves: dict[Sleeve, str] = {}
        if self.mirrored is not None:
            sleeves = {self.mirrored: "mounted the other way round"}
        elif self.positions is not None:
            one, other = self.positions
            sleeves = {
                one: f"exchanged with that of {other.name.lower()}",
                other: f"exchanged with that of {one.name.lower()}",
            }
        elif self.valves is not None and ValveName.BRAKE not in self.valves:
            sleeves = {EXPECTED[valve][0]: "its valves are exchanged" for valve in self.valves}
        named = {f"{sleeve.name.lower()} sleeve turned": text for sleeve, text in sleeves.items()}
        if set(named) != set(turned) or any(named[key] not in turned[key] for key in named):
            return False
        return bool(self.positions or self.mirrored is not None) or self.is_named_by(others)

    def __str__(self) -> str:
        if self.valves is not None:
            return "exchanged: " + " and ".join(v.name.lower() for v in self.valves)
        if self.dead is not None:
            return f"not connected: {self.dead.name.lower()}"
        if self.sensors is not None:
            return "sensors exchanged: " + " and ".join(self.sensors)
        if self.positions is not None:
            names = " and ".join(sleeve.name.lower() for sleeve in self.positions)
            return f"position sensors exchanged: {names}"
        if self.mirrored is not None:
            return f"position sensor the other way round: {self.mirrored.name.lower()}"
        return "as named"


def draw_miswiring(seed: int, share: float = MISWIRED_SHARE) -> Miswiring:
    """One box in this many has one thing wrong."""
    rng = np.random.Generator(np.random.PCG64([seed, 0x3139]))
    if rng.random() >= share:
        return Miswiring()
    kind = int(rng.integers(5))
    if kind == 0:
        a, b = sorted(rng.choice(len(ValveName), 2, replace=False))
        return Miswiring(valves=(ValveName(int(a)), ValveName(int(b))))
    if kind == 1:
        return Miswiring(dead=ValveName(int(rng.integers(len(ValveName)))))
    if kind == 2:
        return Miswiring(positions=POSITION_PAIRS[int(rng.integers(2))])
    if kind == 3:
        return Miswiring(mirrored=Sleeve(int(rng.integers(len(Sleeve)))))
    shafts = list(Shaft)
    a, b = sorted(rng.choice(len(shafts), 2, replace=False))
    return Miswiring(sensors=(shafts[int(a)], shafts[int(b)]))


class MiswiredRig(AroundCore[RigCore]):
    """A rig whose wires are crossed behind the valve drivers' names and before the sensors'."""

    def __init__(self, rig: RigCore, wrong: Miswiring) -> None:
        super().__init__(rig)
        self._wrong = wrong
        self._commands = Receiver(Node.GEARBOX_IO)
        self._inner = Transmitter(Node.TRANSMISSION_CONTROL)
        self._said = Receiver(*Node)
        self._outer = Transmitter(Node.GEARBOX_IO)
        self._swap: dict[type[Message], type[Message]] = {}
        if wrong.sensors is not None:
            a, b = wrong.sensors
            for falling in (0, 1):
                one, other = EDGES_OF[a, falling], EDGES_OF[b, falling]
                self._swap |= {one: other, other: one}

    def receive(self, frame: Frame) -> None:
        """Valve commands reach the wires that they are connected to."""
        if frame.can_id != VALVES.spec.can_id:
            self._core.receive(frame)
            return
        command = self._commands.receive(frame).message
        if isinstance(command, ValveCommand):
            self._core.receive(self._inner.encode(self._crossed(command)))

    def _crossed(self, command: ValveCommand) -> ValveCommand:
        values: dict[str, Any] = command._asdict()
        if self._wrong.dead is not None:
            values[f"{self._wrong.dead.name.lower()}_action"] = ValveAction.OFF_NOW
        if self._wrong.valves is not None:
            a, b = (valve.name.lower() for valve in self._wrong.valves)
            for part in ("action", "time_us"):
                one, other = f"{a}_{part}", f"{b}_{part}"
                values[one], values[other] = values[other], values[one]
        return ValveCommand(**values)

    def step(self, now_us: int) -> Step:
        """The rig's frames, of exchanged sensors under each other's name. The valve side reports
        which outputs it drives by the names that it was commanded."""
        step = self._core.step(now_us)
        if not self._wrong.is_any:
            return step
        return Step([self._renamed(frame) for frame in step.frames], step.events)

    def _renamed(self, frame: Frame) -> Frame:
        message = self._said.receive(frame).message
        values: Any = message
        if isinstance(message, ValveStatus):
            return self._outer.encode(self._reported(message))
        if isinstance(message, (SleevesMain, SleevesAux)):
            return self._outer.encode(self._placed(message))
        other = None if message is None else self._swap.get(type(message))
        return frame if other is None else self._outer.encode(other(*values))

    def _placed(self, message: SleevesMain | SleevesAux) -> Message:
        """Positions as the sensors tell them where they sit."""
        names = POSITION_FIELDS[type(message)]
        values: Any = message
        samples = {sleeve: getattr(values, field) for sleeve, field in names.items()}
        if self._wrong.mirrored in samples:
            sleeve = self._wrong.mirrored
            samples[sleeve] = tuple(-position for position in samples[sleeve])
        if self._wrong.positions is not None and self._wrong.positions[0] in samples:
            a, b = self._wrong.positions
            samples[a], samples[b] = samples[b], samples[a]
        changed: Message = values._replace(**{names[sleeve]: samples[sleeve] for sleeve in names})
        return changed

    def _reported(self, status: ValveStatus) -> ValveStatus:
        if self._wrong.valves is None:
            return status
        values: dict[str, Any] = status._asdict()
        a, b = (valve.name.lower() for valve in self._wrong.valves)
        for part in ("energised", "pending"):
            one, other = f"{a}_{part}", f"{b}_{part}"
            values[one], values[other] = values[other], values[one]
        return ValveStatus(**values)


class Hearing:
    """A node that only listens."""

    def __init__(self, take: Callable[[Frame], None]) -> None:
        self._take = take
        self.next_step_us = 1 << 62

    def receive(self, frame: Frame) -> None:
        """A frame of the bus."""
        self._take(frame)

    def step(self, now_us: int) -> Step:  # noqa: ARG002
        """Nothing is sent."""
        return Step([], [])

    def shutdown(self, now_us: int) -> Step:
        """As `step`."""
        return self.step(now_us)


@dataclass(frozen=True)
class Rehearsed:
    """What came of one drawn box."""

    seed: int
    wrong: Miswiring
    findings: list[Finding]
    core: CommissionCore
    simulated_s: float

    @property
    def is_right(self) -> bool:
        """Whether what is wrong, and nothing else, was named."""
        return self.wrong.is_named_by(self.findings)


@dataclass(frozen=True)
class Turned:
    """What came of one drawn box that was also turned."""

    seed: int
    wrong: Miswiring
    findings: list[Finding]
    core: WholeCommission
    simulated_s: float

    @property
    def is_right(self) -> bool:
        """Whether what is wrong, and nothing else, was reported."""
        return self.wrong.is_reported_by(self.findings)


def rehearse(
    sheet: GearboxSheet,
    seed: int,
    wrong: Miswiring,
    preset: Preset = Preset.TRUCK,
    profile: Profile = DEFAULT_PROFILE,
) -> Rehearsed:
    """One box: its shafts turn in gear, then it stands and each output is driven."""
    counts = _turn(sheet, seed, wrong, preset, profile)
    settings = RigSettings(
        preset=preset, seed=seed, main_speed_rpm=0.0, profile=profile, as_built=STAND
    )
    rig = MiswiredRig(RigCore(sheet, settings), wrong)
    core = CommissionCore(sheet, consents=True)
    nodes: list[Core] = [core, rig]
    time = VirtualTime(nodes, [3_000, 1_000])
    time.run(lambda: core.done, LIMIT_US)
    findings = [*judge_wheels(counts), *judge_outputs(core)]
    return Rehearsed(seed, wrong, findings, core, time.now_us / 1e6)


def rehearse_turned(
    sheet: GearboxSheet, seed: int, wrong: Miswiring, profile: Profile = DEFAULT_PROFILE
) -> Turned:
    """One box of this sheet, which commissioning does not know, on a stand: both parts."""
    settings = RigSettings(seed=seed, main_speed_rpm=0.0, profile=profile, as_built=STAND)
    rig = RigCore(sheet, settings)
    core = WholeCommission(withheld(sheet), consents=True, turns=True)
    time = VirtualTime([core, MiswiredRig(rig, wrong)], [3_000, 1_000])
    time.run(lambda: core.done, TURNED_LIMIT_US)
    return Turned(seed, wrong, list(findings_of(core)), core, time.now_us / 1e6)


def findings_of(core: WholeCommission) -> Iterator[Finding]:
    """Of both parts."""
    yield from judge_outputs(core.standing)
    running, wires = core.running, wires_of(core.standing)
    if running is not None and wires is not None:
        yield from judge_turning(running.log, wires)
        if running.stopped:
            yield Finding(TURNING, "box turned", Verdict.BAD, f"given up: {running.stopped}")


def _turn(
    sheet: GearboxSheet, seed: int, wrong: Miswiring, preset: Preset, profile: Profile
) -> ShaftCounts:
    counts, receiver = ShaftCounts(sheet), Receiver(*Node)

    def take(frame: Frame) -> None:
        message = receiver.receive(frame).message
        if message is not None:
            counts.take(message)

    settings = RigSettings(preset=preset, seed=seed, main_speed_rpm=MAIN_RPM, profile=profile)
    nodes: list[Core] = [MiswiredRig(RigCore(sheet, settings), wrong), Hearing(take)]
    VirtualTime(nodes, [1_000, 1 << 62]).run(lambda: False, TURN_US)
    return counts
