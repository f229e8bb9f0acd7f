"""The rows of a replay's shifts, and what its page draws."""

from __future__ import annotations

from meshpoint.controller.settings.header import RunHeader
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import Message, ReferenceEngagement, ShiftOutcome, ShiftResult
from meshpoint.dbc.node import Node
from meshpoint.replays.open_loop import OpenLoop
from meshpoint.report.beliefs import Beliefs
from meshpoint.report.collect import MADE, ReportCollector
from meshpoint.report.judged_rows import JudgedRow
from meshpoint.report.write import aim_rad
from meshpoint.results.rows import RowCollector, ShiftRow


class ReplayRows:
    """Rows of the shifts: as recorded, from the repeated controller's outcomes and the logged
    truth; in open loop from the log alone, with the other strategy's decisions beside each."""

    def __init__(self, for_report: bool, open_loop: OpenLoop | None, asked: str) -> None:
        """asked: what the other controller is, in words."""
        self.asked = asked
        self._for_report = for_report
        self.open_loop = open_loop
        self._logged = Receiver(*Node)
        self._made = Receiver(Node.BENCH)
        self._collector: RowCollector | None = None
        self._truth: list[ReferenceEngagement] = []
        self._session = -1
        self._keys: list[tuple[int, int]] = []
        """Of each row in open loop: session and time of request."""
        self.beliefs = Beliefs()
        """Of the repeated controller, as recorded."""
        self.report: ReportCollector | None = None
        self.header: RunHeader | None = None
        """Of the first session, which rows and report are made with."""

    def logged(self, frame: Frame) -> None:
        """A frame of the log: as recorded, rows use the truth of it and a report all but the
        controller's; in open loop both use all of it."""
        message = self._logged.receive(frame).message
        if message is None:
            return
        if self.open_loop is not None:
            self._take(message)
        elif isinstance(message, ReferenceEngagement):
            self._truth.append(message)
            self._take_truth()
        if self.report is not None and (self.open_loop or not isinstance(message, MADE)):
            self.report.take(message)

    def start(self, header: RunHeader) -> None:
        """A session's data sheet is known, and the settings that it is repeated with."""
        self._session += 1
        if self.report is not None:
            self.report.restart()
        if self._collector is None:
            self.header = header
            self._collector = RowCollector(header.sheet, aim_rad(header), header.settings)
            self._take_truth()
            if self._for_report:
                self.report = ReportCollector(
                    header.sheet, aim_rad(header), header.settings, self.beliefs
                )

    def made(self, frame: Frame) -> None:
        """A frame the repeated controller sent."""
        if self.open_loop is not None:
            return
        message = self._made.receive(frame).message
        if isinstance(message, ShiftOutcome):
            self._take(message)
        if self.report is not None and isinstance(message, MADE):
            self.report.take(message)

    def _take_truth(self) -> None:
        """What the log has said of the rig's truth, as soon as there are rows to put it in."""
        while self._truth and self._collector is not None:
            self._collector.take(self._truth.pop(0))

    def _take(self, message: Message) -> None:
        if self._collector is None:
            return
        self._collector.take(message)
        if isinstance(message, ShiftOutcome) and message.result is not ShiftResult.REFUSED:
            self._keys.append((self._session, message.request_time_us))

    @property
    def rows(self) -> list[ShiftRow]:
        """The shifts so far."""
        return self._collector.rows if self._collector else []

    @property
    def judged(self) -> list[JudgedRow]:
        """The same in open loop."""
        found = self.open_loop.judged if self.open_loop else {}
        return [
            JudgedRow(row, found.get(key)) for key, row in zip(self._keys, self.rows, strict=True)
        ]
