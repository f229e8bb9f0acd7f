"""Whether a log holds what the controller in it has consumed, by its own account: each status frame
says how many frames its step took, and their CRC. So a lost frame shows that has no counter."""

from __future__ import annotations

from typing import Final

from meshpoint.controller.core.core import OWN_ADDRESS
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import canonical
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import read_alone
from meshpoint.dbc.messages import ControllerStatus
from meshpoint.logs.consumed import CONSUMED_IDS, NotVerifiableError, WaitingFrames

STATUS: Final = CODECS[ControllerStatus.__name__]
MOST_STEPS: Final = 20
"""Steps after which a place that was lost is looked for anew, in later frames."""
MOST_SEARCHES: Final = 5
"""Of these without success: a log of another version, or two controllers on the bus."""


class Consumption:
    """Takes a log's frames in their order."""

    def __init__(self) -> None:
        self.missing = 0
        """Frames that the controller has consumed and the log does not hold."""
        self.changed = 0
        """Steps that have consumed other frames than the log holds."""
        self._waiting = WaitingFrames(exact=True)
        self._added = 0
        self._next_step = -1
        self._place: int | None = None
        """This many of the frames were consumed up to the last step that fitted; None: unknown."""
        self._expected = 0
        self._unmet = 0
        self._searches = 0

    def take(self, frame: Frame) -> None:
        """The log's next frame."""
        if not frame.is_extended or self._searches >= MOST_SEARCHES:
            return
        frame = canonical(frame)
        if frame.can_id & 0xFF != OWN_ADDRESS:
            if frame.can_id in CONSUMED_IDS:
                self._waiting.add(frame)
                self._added += 1
        elif frame.can_id == STATUS.spec.can_id:
            status: ControllerStatus | None = read_alone(STATUS, frame)
            if status is not None:
                self._step(status)

    def _step(self, status: ControllerStatus) -> None:
        if status.step_number != self._next_step:
            self._lose_place()  # another run, or steps of a link outage
        self._next_step = status.step_number + 1
        self._expected += status.consumed_count
        try:
            self._waiting.take(status.consumed_count, status.consumed_crc)
        except NotVerifiableError:
            self._unmet += 1
            self._waiting.lose_place()
            if self._unmet >= MOST_STEPS:
                self._searches += 1
                self._waiting = WaitingFrames(exact=True)
                self._lose_place()
            return
        if status.consumed_count == 0 and (self._unmet or self._place is None):
            return  # fits everywhere
        place = self._added - self._waiting.left
        if self._unmet and self._place is not None:
            missing = max(0, self._expected - (place - self._place))
            self.missing += missing
            self.changed += 0 if missing else self._unmet
        self._place, self._expected, self._unmet, self._searches = place, 0, 0, 0

    def _lose_place(self) -> None:
        self._waiting.lose_place()
        self._place, self._expected, self._unmet = None, 0, 0

    def words(self) -> list[str]:
        """What is amiss, a line each."""
        lines = []
        if self.missing:
            lines.append(
                f"{self.missing} frames lost that the controller has consumed, by its own account; "
                "TC1 and EEC1 have no counter by which it would show"
            )
        if self.changed:
            lines.append(f"{self.changed} steps have consumed other frames than the log holds")
        return lines
