"""The shadow: a controller on a live bus that sends nothing at all.

Between requests it estimates and learns, as `replay --sensors` does with a log. At each request
(TC1) a copy of it is asked, and is fed the same frames until its shift has ended. Nothing that
either of them makes is handed to the bus: this core returns no frame, whatever happens.
"""

from __future__ import annotations

from typing import Final

from meshpoint.bus.core import Step
from meshpoint.controller.settings.header import RunHeader
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.node import Node
from meshpoint.logs.seen_shift import SeenShift
from meshpoint.logs.sleeve_contacts import ShiftWatch
from meshpoint.replays.sensor_replay import SensorReplay
from meshpoint.results.road_speed import span_us
from meshpoint.units import SECOND_US

TICK_US: Final = 10_000


class ShadowCore:
    """Of the call shape of controller and rig, for the live driver."""

    def __init__(self, header: RunHeader) -> None:
        self._lines: list[str] = []
        self._replay = SensorReplay(header, None, lambda _at_s, line: self._lines.append(line))
        self._watch = ShiftWatch(header.sheet)
        self._heard = Receiver(*Node)
        self._inbox: list[Frame] = []
        self._due_us = 0
        self._reported = 0
        self.frames = 0
        """Frames of any node that were heard."""

    @property
    def shifts(self) -> list[SeenShift]:
        """What the production controller did, by the sleeves."""
        return self._watch.shifts

    def receive(self, frame: Frame) -> None:
        """Keeps a frame for the next step."""
        self._inbox.append(frame)

    @property
    def next_step_us(self) -> int:
        """Every 10 ms."""
        return self._due_us

    def step(self, now_us: int) -> Step:
        """Takes in what was heard; returns lines and never a frame."""
        inbox, self._inbox = self._inbox, []
        self._due_us = now_us + TICK_US
        self._heard.tick(now_us)
        for frame in inbox:
            self.frames += 1
            self._replay.take(now_us / SECOND_US, frame)
            message = self._heard.receive(frame).message
            seen = None if message is None else self._watch.take(message)
            if seen is not None:
                self._lines.append(self._beside(seen))
        self._tell_decided()
        lines, self._lines = self._lines, []
        return Step([], lines)

    def shutdown(self, now_us: int) -> Step:
        """What has happened, in a line. There is nothing to switch off."""
        self._lines.append(self.summary)
        return self.step(now_us)

    @property
    def summary(self) -> str:
        """Both controllers, counted."""
        seen = [shift.contact for shift in self.shifts if shift.contact is not None]
        asked = self._replay.outcomes
        fired = sum(outcome.attempts > 0 for _, outcome in asked)
        return (
            f"shadow: sent nothing; {self.frames} frames heard; the production controller met the "
            f"gap in {seen.count('gap')} of {len(seen)} shifts, as the sleeves show; asked "
            f"{len(asked)} times, the shadow would have fired {fired} times (`meshpoint replay "
            "LOG --gap-rate` says more)"
        )

    def _tell_decided(self) -> None:
        """Each request's decision, once it has been made."""
        decided = self._replay.decided()
        for row in decided[self._reported :]:
            after = "" if row["fired_ms"] is None else f" after {row['fired_ms']} ms"
            phase = row["predicted_phase_deg"]
            reported = "" if phase is None else f", expecting {phase:+.2f} deg"
            why = "" if row["fault"] == "none" else f" ({row['fault']})"
            self._lines.append(
                f"shadow {row['from']} -> {row['to']}: {row['status']}{after}{reported}{why}"
            )
        self._reported = len(decided)

    def _beside(self, seen: SeenShift) -> str:
        """A shift of the production controller, as the sensors show it."""
        driven = ""
        if seen.driven_us is not None:
            after_ms = span_us(seen.driven_us, seen.left_us) / 1000
            driven = f", valve driven {after_ms:.0f} ms after the old gear was left"
        return (
            f"production {seen.from_gear} -> {seen.to_gear}: first contact "
            f"{seen.contact or 'not seen'}{driven}"
        )
