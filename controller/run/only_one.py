"""One controller on a bus: a newcomer leaves it to the one at work, and one that finds another
beside it switches its valves off and falls silent.

Both would send the same identifiers with counters of their own, so that the valve side could trust
neither. Whose frames are whose is known by what was sent from here: an interface may return them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final

from meshpoint.bus.core import AroundCore, Core, Step
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import read_alone

LISTEN_US: Final = 250_000
"""How long a newcomer listens: 25 cycles of a controller's status and of its valve command."""
LOOK_US: Final = 10_000
WITHIN_US: Final = 100_000
MOST_FRAMES: Final = 3
"""This many frames of another one within `WITHIN_US` are a controller: one alone is an accident."""
REMEMBERED: Final = 2_048
"""Own frames, of the last 10 s: longer than any interface keeps them."""
Signs = Mapping[int, Callable[[Frame], object]]
"""Frames that a controller sends all the time, and nobody else: by identifier, what makes a message
of one, or None where it is damaged."""
SIGNS: Final[Signs] = {
    CODECS[name].spec.can_id: partial(read_alone, CODECS[name])
    for name in ("ControllerStatus", "ValveCommand")
}
"""Those of CAN FD, one of each a step."""
NEWCOMER: Final = (
    "another controller is at work on this bus: this one leaves without having sent anything. "
    "End the other one first, or watch beside it with --shadow"
)
BESIDE: Final = (
    "another controller sends on this bus as well: this one has switched its valves off, is silent "
    "and ends. Start the one that is to stay again, alone"
)


class OtherControllerError(Exception):
    """There is another controller on the bus; the message is for the user."""


class OnlyController(AroundCore[Core]):
    """A controller that shares its bus with no other one."""

    def __init__(
        self,
        core: Core,
        leave: Callable[[], None],
        signs: Signs = SIGNS,
        *,
        is_proven: bool = False,
    ) -> None:
        """leave: called once, when this controller is to end. signs: those of this bus. is_proven:
        its commands are (`--keys`). The gearbox takes no others then, and whoever forges frames
        without the keys is not to silence it: at work it goes on."""
        super().__init__(core)
        self._leave, self._is_proven = leave, is_proven
        self._signs = signs
        self._sent: dict[tuple[int, bytes], None] = {}
        self._listens_until_us: int | None = None
        self._look_us = 0
        """When the next look is due while it listens."""
        self._is_at_work = False
        self._foreign = 0
        """Frames of another one since the last step."""
        self._seen_us: list[int] = []
        self.conflict = ""
        """Why this controller ends; empty as long as it is the only one."""

    def receive(self, frame: Frame) -> None:
        """As the core inside, once it is at work; what came before is not of its time."""
        if self._is_at_work:
            self._core.receive(frame)

    def receive_own(self, frame: Frame) -> None:
        """A frame under this controller's own address: one that it has sent, or another's."""
        message_of = self._signs.get(frame.can_id)
        if message_of is None or (frame.can_id, frame.data) in self._sent:
            return
        self._foreign += message_of(frame) is not None

    @property
    def next_step_us(self) -> int:
        """The next look while it listens, then as the core inside."""
        return self._core.next_step_us if self._is_at_work else self._look_us

    def step(self, now_us: int) -> Step:
        """As the core inside, unless there is another controller: then its last frames, once."""
        if self.conflict:
            return Step([], [])
        seen_us = [each for each in self._seen_us if now_us - each <= WITHIN_US]
        self._seen_us = seen_us + [now_us] * min(self._foreign, MOST_FRAMES)
        self._foreign = 0
        if self._listens_until_us is None:
            self._listens_until_us = now_us + LISTEN_US
        if not self._is_at_work:
            return self._listen(now_us)
        if self._has_company and not self._is_proven:
            return self._end(BESIDE, now_us)
        step = self._core.step(now_us)
        self._remember(step.frames)
        return step

    def _listen(self, now_us: int) -> Step:
        if self._has_company:
            return self._end(NEWCOMER, now_us)
        self._look_us = now_us + LOOK_US
        if now_us < (self._listens_until_us or 0):
            return Step([], [])
        self._is_at_work = True
        return self.step(now_us)

    @property
    def _has_company(self) -> bool:
        return len(self._seen_us) >= MOST_FRAMES

    def _end(self, why: str, now_us: int) -> Step:
        last = self._core.shutdown(now_us) if self._is_at_work else Step([], [])
        self.conflict = why
        self._leave()
        return last

    def _remember(self, frames: list[Frame]) -> None:
        for frame in frames:
            if frame.can_id in self._signs:
                self._sent.pop((frame.can_id, frame.data), None)
                self._sent[frame.can_id, frame.data] = None
        while len(self._sent) > REMEMBERED:
            del self._sent[next(iter(self._sent))]

    def shutdown(self, now_us: int) -> Step:
        """As the core inside; nothing where it has sent its last frames, or none at all."""
        if self.conflict or not self._is_at_work:
            return Step([], [])
        return self._core.shutdown(now_us)
