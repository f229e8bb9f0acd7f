"""What a check hears of a bus: every frame of it, and all that is judged later."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import can

from meshpoint.bus.frames import frame_of
from meshpoint.commission.expected import (
    CLASSIC_EXPECTED,
    EXPECTED,
    BusSpan,
    judge_messages,
)
from meshpoint.commission.finding import Finding, Verdict
from meshpoint.commission.sensors import judge_sensors
from meshpoint.commission.shafts import Shaft, ShaftCounts
from meshpoint.commission.stamps import StampTrack
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.messages import GearboxSensors
from meshpoint.gearbox import GearboxSheet
from meshpoint.logs.heard import Heard


class Listener:
    """Takes messages in the order of arrival. It never sends.

    sheet: of the gearbox, for tooth counts, strokes and pressures. unpack: of a bus of the classic
    profile, makes frames of meshpoint.dbc of its own.
    """

    def __init__(
        self, sheet: GearboxSheet, unpack: Callable[[Frame], Iterable[Frame]] | None = None
    ) -> None:
        self._sheet, self._unpack = sheet, unpack
        self.heard = Heard()
        self.span = BusSpan(self.heard)
        self.shafts = ShaftCounts(sheet)
        self.stamps = StampTrack()
        self.frames = 0
        """Of data, whoever sent them."""
        self.error_frames = 0

    def take(self, now_s: float, message: can.Message) -> None:
        """One message, at a time of a steady clock of this machine."""
        if message.is_error_frame:
            self.error_frames += 1
            return
        if message.is_remote_frame:
            return
        self.frames += 1
        self.stamps.frame(message.timestamp)
        frame = frame_of(message)
        for inner in (frame,) if self._unpack is None else self._unpack(frame):
            self._hear(now_s, message.timestamp, inner)

    def _hear(self, now_s: float, stamp_s: float, frame: Frame) -> None:
        decoded = self.heard.receive(now_s, frame)
        self.span.begin()
        if decoded is None:
            return
        if isinstance(decoded, GearboxSensors):
            self.stamps.sample(stamp_s, decoded.sample_time_us)
        self.shafts.take(decoded)

    def edges(self) -> dict[Shaft, int]:
        """Edges of either polarity counted so far."""
        return {shaft: sum(wheel.edges) for shaft, wheel in self.shafts.wheels.items()}

    def findings(self, where: str = "the bus") -> Iterator[Finding]:
        """All that was heard, judged. where: what was listened to and for how long, in words."""
        if self.error_frames:
            yield Finding(
                "interface", "error frames", Verdict.BAD,
                f"{self.error_frames} while listening: wiring, termination or bit rates",
            )  # fmt: skip
        if not self.frames:
            yield Finding(
                "messages", "bus", Verdict.BAD,
                f"nothing at all is sent: no frame on {where}; are the other nodes on, and on this "
                "bus?",
            )  # fmt: skip
            return
        is_classic = self._unpack is not None
        expected = CLASSIC_EXPECTED if is_classic else EXPECTED
        yield from judge_messages(self.heard, self.span.seconds, expected)
        yield from self.stamps.findings()
        yield from judge_sensors(self.heard, self._sheet)
        yield from self.shafts.findings(is_classic)
