"""A bench around one rig core: sends commands, decodes frames, puts edges back together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import FrameVerdict, Receiver, Transmitter
from meshpoint.dbc.messages import (
    BenchAction,
    BenchCommand,
    BenchFault,
    ClutchAction,
    ClutchCommand,
    EngagementEvent,
    ReferenceEngagement,
    ValveAction,
    ValveCommand,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox.sheet import GearboxSheet, load_sheet
from meshpoint.rig_sim import Preset, RigCore, RigSettings
from meshpoint.units import RPM

CYCLE_US = 10_000
thesis_rig = partial(RigSettings, preset=Preset.THESIS)
"""Settings of the preset `thesis`, whose equations have closed forms to hold it against."""
DEFAULTS = thesis_rig()
SHEET = load_sheet("thesis")


@dataclass
class RigBench:
    """One rig and all it has said. Time is microseconds since power-up."""

    settings: RigSettings = DEFAULTS
    sheet: GearboxSheet = SHEET
    frames: list[Frame] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)
    now_us: int = 0

    def __post_init__(self) -> None:
        self.core = RigCore(self.sheet, self.settings)
        self.control = Transmitter(Node.TRANSMISSION_CONTROL)
        self._bench = Transmitter(Node.BENCH)
        self.ears = Receiver(Node.TRANSMISSION_CONTROL, Node.BENCH)
        self.messages: list[Any] = []

    @property
    def world(self) -> Any:
        """The gearbox itself, with what the bus does not carry."""
        return self.core._world

    def clock(self, time_us: int) -> int:
        """The 32-bit sensor clock at a time since power-up."""
        return (self.core.truth.clock_start_us + time_us) % (1 << 32)

    def step(self, now_us: int) -> None:
        """Step once and take in what the rig says."""
        self.now_us = now_us
        frames, lines = self.core.step(now_us)
        self.lines.extend(lines)
        for frame in frames:
            self.frames.append(frame)
            received = self.ears.receive(frame)
            assert received.verdict is FrameVerdict.OK, frame
            self.messages.append(received.message)

    def send(self, message: Any) -> None:
        """Hand the rig a message, as the node that sends it would."""
        sender = self._bench if isinstance(message, BenchCommand | BenchFault) else self.control
        self.core.receive(sender.encode(message))

    def run(
        self,
        until_us: int,
        valves: Callable[[int], ValveCommand] = lambda now_us: ValveCommand(),
        step_us: int = CYCLE_US,
    ) -> None:
        """Step on, with a valve and an open-clutch command every 10 ms."""
        while self.now_us < until_us:
            if self.now_us % CYCLE_US == 0:
                self.send(valves(self.now_us))
                self.send(ClutchCommand(action=ClutchAction.OPEN))
                self.step(self.now_us)
            self.step(min(self.now_us + step_us, until_us))

    def return_to_gear(self, gear: int, sequence: int, main_rpm: float = 644.0) -> None:
        """Have the script started at the next step."""
        self.send(
            BenchCommand(
                action=BenchAction.RETURN_TO_GEAR,
                gear=gear,
                sequence=sequence,
                main_speed_rad_s=main_rpm * RPM,
            )
        )

    def of(self, kind: type[Any]) -> list[Any]:
        """All messages of one type so far."""
        return [message for message in self.messages if isinstance(message, kind)]

    def events(self, event: EngagementEvent) -> list[Any]:
        """All engagement events of one kind so far."""
        return [message for message in self.of(ReferenceEngagement) if message.event is event]


def release_first(now_us: int) -> ValveCommand:
    """Take gear FIRST out, from 0.3 s on: its sleeve's other valve, until it is in neutral."""
    on = 300_000 <= now_us < 360_000
    return ValveCommand(main_second_action=ValveAction.ON_NOW if on else ValveAction.OFF_NOW)


def upshift(now_us: int) -> ValveCommand:
    """An open-loop shift 8 -> 10: out of FIRST, brake, into SECOND."""
    brake = ValveAction.ON_NOW if 400_000 <= now_us < 600_000 else ValveAction.OFF_NOW
    if 650_000 <= now_us < 900_000:
        return ValveCommand(main_second_action=ValveAction.ON_NOW)
    return release_first(now_us)._replace(brake_action=brake)


def edges_of(messages: list[Any]) -> dict[int, int]:
    """All edges of one channel by index since power-up, in microseconds of the unwrapped sensor
    clock, put together from its edge frames; frames may be missing."""
    edges: dict[int, int] = {}
    index = read_us = 0
    for message in messages:
        read_us += (message.read_time_us - read_us) % (1 << 32)
        index += (message.newest_index - index) % (1 << 16)
        time_us = read_us
        if message.stopped:
            continue
        for back, low in enumerate(message.timestamp_low_us[: message.valid_stamps]):
            time_us -= (time_us - low) % (1 << 16)
            known = edges.setdefault(index - back, time_us)
            assert known == time_us, "two frames disagree about an edge"
    return edges
