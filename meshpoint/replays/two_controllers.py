"""Two controllers that differ in their settings, asked about the shifts of one log: for each shift
the first step at which they part, and what each knew there.

Both are put into the recorded state at each request and are fed the same frames (`open_loop`), so
whatever they send differently comes of the settings alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.header import RunHeader
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.messages import ControllerStatus
from meshpoint.replays.log_difference import differing_messages, known_in
from meshpoint.replays.open_loop import OpenLoop
from meshpoint.report.judged import Judged, Parting
from meshpoint.results.difference import Allowed

Change = Callable[[RunHeader], RunHeader]


@dataclass(frozen=True)
class JudgedTwice:
    """A recorded shift as both decide it."""

    judged: tuple[Judged, Judged]
    parting: Parting[dict[str, Any]] | None
    """By messages, with estimates, prediction and state of each; None: they send the same."""


class TwoControllers:
    """Watches while a log is repeated (`meshpoint.replays.replay.Onlooker`)."""

    def __init__(self, a: Change, b: Change, allowed: Allowed) -> None:
        self._loops = OpenLoop(a, draws=0), OpenLoop(b, draws=0)
        self._allowed = allowed
        self.shifts: list[JudgedTwice] = []

    @property
    def unfinished(self) -> int:
        """Shifts that have no outcome in the log, or an outage in them."""
        return self._loops[0].unfinished

    def start(self, header: RunHeader, errors: dict[str, int]) -> None:
        """As OpenLoop.start."""
        for loop in self._loops:
            loop.start(header, errors)

    def end(self) -> None:
        """As OpenLoop.end."""
        for loop in self._loops:
            loop.end()

    def before(
        self,
        core: ControllerCore,
        status: ControllerStatus,
        sent: list[Frame],
        consumed: list[Frame],
    ) -> None:
        """As OpenLoop.before."""
        for loop in self._loops:
            loop.before(core, status, sent, consumed)

    def unheard(self, core: ControllerCore, time_us: int, consumed: list[Frame]) -> None:
        """As OpenLoop.unheard."""
        for loop in self._loops:
            loop.unheard(core, time_us, consumed)

    def after(self, status: ControllerStatus, sent: list[Frame], made: list[Frame]) -> None:
        """As OpenLoop.after; a shift that has ended is compared."""
        known = len(self._loops[0].judged)
        steps = [loop.steps_sent for loop in self._loops]
        for loop in self._loops:
            loop.after(status, sent, made)
        if len(self._loops[0].judged) > known:
            a, b = (list(loop.judged.values())[-1] for loop in self._loops)
            self.shifts.append(JudgedTwice((a, b), self._parting(a, *steps)))

    def _parting(
        self, judged: Judged, a: list[tuple[float, list[Frame]]], b: list[tuple[float, list[Frame]]]
    ) -> Parting[dict[str, Any]] | None:
        """Up to the recorded contact: no later decision counts."""
        for (at_ms, of_a), (_, of_b) in zip(a, b, strict=True):
            if judged.judged_to_ms is not None and at_ms >= judged.judged_to_ms:
                return None
            sent_a, sent_b = _by_id(of_a), _by_id(of_b)
            messages = differing_messages(sent_a, sent_b, self._allowed)
            if messages:
                return Parting(at_ms, messages, (known_in(sent_a), known_in(sent_b)))
        return None


def _by_id(frames: list[Frame]) -> dict[int, bytes]:
    return {frame.can_id: frame.data for frame in frames}
