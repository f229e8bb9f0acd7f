"""What is said of commands that came and were not right: lost on the way, or of another sender."""

from __future__ import annotations

from collections import Counter
from typing import Final

from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import FrameVerdict

TELL_US: Final = 1_000_000
"""The same is said no more often."""
NAMES: Final = {codec.spec.can_id: name for name, codec in CODECS.items()}
STRANGER: Final = "with a wrong CRC or counter: another node sends it too, or its sender is faulty"
GAP: Final = (
    "did not follow on the one before: frames were lost or overtaken on the way, or its sender "
    "began anew"
)


class Suspicions:
    """Counts frames that a node's receiver did not pass, by who may be to blame.

    A bus throws away what it damages, so a wrong CRC or a repeated counter is a sender's doing. A
    counter that leaps and then goes on is what losses leave; one that leaps twice running is of
    two senders in turn."""

    def __init__(self) -> None:
        self._found: dict[str, Counter[int]] = {STRANGER: Counter(), GAP: Counter()}
        self._reported_us: dict[str, int] = {}
        self._leapt: set[int] = set()
        """Identifiers whose newest frame leapt, after one that did not."""

    def judge(self, can_id: int, verdict: FrameVerdict) -> None:
        """One frame, as the receiver found it."""
        if verdict is FrameVerdict.OK:
            if can_id in self._leapt:
                self._leapt.discard(can_id)
                self._found[GAP][can_id] += 1
        elif verdict is FrameVerdict.WRONG_SEQUENCE and can_id not in self._leapt:
            self._leapt.add(can_id)
        elif verdict is FrameVerdict.WRONG_SEQUENCE:
            self._leapt.discard(can_id)
            self._found[STRANGER][can_id] += 2
        elif verdict in (FrameVerdict.E2E, FrameVerdict.REPEATED):
            self._found[STRANGER][can_id] += 1

    def take_lines(self, time_us: int) -> list[str]:
        """What is to be said, at once and then once a second."""
        lines = []
        for what, counts in self._found.items():
            reported_us = self._reported_us.get(what)
            if not counts or (reported_us is not None and time_us - reported_us < TELL_US):
                continue
            self._reported_us[what] = time_us
            lines += [
                f"{time_us / 1e6:.6f} s {count} x {NAMES[can_id]} (0x{can_id:08X}) {what}"
                for can_id, count in sorted(counts.items())
            ]
            counts.clear()
        return lines
