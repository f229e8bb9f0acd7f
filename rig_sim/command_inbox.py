"""Frames that wait for a step, and whether one of them asks for that step at once."""

from __future__ import annotations

from typing import Final

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ClutchCommand, ValveCommand

VALVES: Final = CODECS[ValveCommand.__name__].spec.can_id
CLUTCH: Final = CODECS[ClutchCommand.__name__].spec.can_id
CLUTCH_ACTION: Final = 3
"""The byte of the clutch command that says what it is to do."""


class CommandInbox:
    """What a node with the valves has received since its last step."""

    def __init__(self, valves: int = VALVES) -> None:
        """valves: the identifier of a valve command."""
        self._valves = valves
        self._frames: list[Frame] = []
        self._last_clutch = b""
        self.is_urgent = False
        """A valve command waits, or a clutch command other than the one before."""

    def receive(self, frame: Frame) -> None:
        """Keeps a frame for the next step."""
        self._frames.append(frame)
        if frame.can_id == self._valves:
            self.is_urgent = True
        elif frame.can_id == CLUTCH:
            action = frame.data[CLUTCH_ACTION:]
            self.is_urgent |= action != self._last_clutch
            self._last_clutch = action

    def take(self) -> list[Frame]:
        """All of them, in order of arrival; none waits any more."""
        frames, self._frames, self.is_urgent = self._frames, [], False
        return frames
