"""What a log holds, frame by frame: what can be used, and what is foreign, damaged, doubled, late,
lost or of another contract. A replay says it, so that nothing is left out in silence.
"""

from __future__ import annotations

from collections import Counter
from typing import Any, Final

from meshpoint.bus.authentication.frames import CHALLENGE, PROOF
from meshpoint.dbc.e2e import check_crc
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import XCP_COMMAND_ID, XCP_RESPONSE_ID
from meshpoint.dbc.layout import CODECS
from meshpoint.logs.consumption import Consumption

SPECS: Final = {codec.spec.can_id: codec.spec for codec in CODECS.values()}
COUNTER_BYTE: Final = 2
HALF: Final = 128
"""A counter that has gone on by more than this has gone back."""
LONG_S: Final = 1.0
BACK_S: Final = 0.01
MOST_NAMED: Final = 8


OURS: Final = (CHALLENGE.can_id, PROOF.can_id, XCP_COMMAND_ID, XCP_RESPONSE_ID)
"""Ours, but not of the DBC: proofs have one of their own, XCP's packets have no fixed signals."""


class Account:
    """Takes a log's frames in their order."""

    def __init__(self) -> None:
        self.frames = 0
        self.good: Counter[str] = Counter()
        """Undamaged frames of the DBC, by message."""
        self.damaged: Counter[str] = Counter()
        """Frames of the DBC whose CRC is wrong."""
        self.other_form: Counter[str] = Counter()
        """Frames under an identifier of the DBC with another length or kind: another DBC made
        them."""
        self.foreign: Counter[str] = Counter()
        """Frames that are not of the DBC, by identifier."""
        self.doubled = 0
        self.out_of_order = 0
        self.lost = 0
        """By the counters of the protected messages."""
        self.restarts = 0
        """Counters that began anew where a frame was far off: a node has started again."""
        self.set_back: list[tuple[float, float]] = []
        self.silent: list[tuple[float, float]] = []
        """Where the log's clock goes back, or nothing comes for over 1 s: since its first frame,
        and for how long, s."""
        self.consumption = Consumption()
        self._counters: dict[int, int] = {}
        self._last: dict[int, bytes] = {}
        self._first_s: float | None = None
        self._last_s = 0.0

    def take(self, time_s: float, frame: Frame) -> None:
        """A frame of the log."""
        self.frames += 1
        self._take_time(time_s)
        self.consumption.take(frame)
        spec = SPECS.get(frame.can_id) if frame.is_extended else None
        if spec is None:
            digits = 8 if frame.is_extended else 3
            if frame.can_id not in OURS:
                self.foreign[f"{frame.can_id:0{digits}X}"] += 1
        elif len(frame.data) != spec.length or frame.is_fd != spec.is_fd:
            self.other_form[spec.name] += 1
        elif spec.data_id is not None and not check_crc(frame.data, spec.data_id):
            self.damaged[spec.name] += 1
        else:
            self.good[spec.name] += 1
            if spec.data_id is not None:
                self._count(frame)

    def _take_time(self, time_s: float) -> None:
        if self._first_s is None:
            self._first_s = self._last_s = time_s
        passed_s, since_s = time_s - self._last_s, self._last_s - self._first_s
        if passed_s < -BACK_S:
            self.set_back.append((round(since_s, 6), round(-passed_s, 6)))
        elif passed_s > LONG_S:
            self.silent.append((round(since_s, 6), round(passed_s, 6)))
        self._last_s = time_s

    def _count(self, frame: Frame) -> None:
        can_id, counter = frame.can_id, frame.data[COUNTER_BYTE]
        before = self._counters.get(can_id)
        step = 1 if before is None else (counter - before) & 0xFF
        if step == 0 and self._last[can_id] == frame.data:
            self.doubled += 1
            return
        if step > HALF:
            if 256 - step <= HALF // 4:
                self.out_of_order += 1
                return
            self.restarts += 1
        elif counter == 0 and step > 1:
            self.restarts += 1
        else:
            self.lost += max(step - 1, 0)
        self._counters[can_id], self._last[can_id] = counter, frame.data

    def to_json(self) -> dict[str, Any]:
        """Everything as plain values."""
        return {
            "frames": self.frames,
            "good": sum(self.good.values()),
            "damaged": dict(sorted(self.damaged.items())),
            "other_form": dict(sorted(self.other_form.items())),
            "foreign": dict(sorted(self.foreign.items())),
            "doubled": self.doubled,
            "out_of_order": self.out_of_order,
            "lost": self.lost,
            "consumed_but_missing": self.consumption.missing,
            "steps_of_changed_frames": self.consumption.changed,
            "counters_restarted": self.restarts,
            "clock_set_back_s": self.set_back,
            "silent_s": self.silent,
        }

    def words(self) -> list[str]:
        """What is amiss, a line each; nothing where all is well."""
        lines = []
        for title, counts in (
            ("damaged (wrong CRC), not used", self.damaged),
            ("of another length or kind than our DBC has: another DBC made them", self.other_form),
            ("foreign", self.foreign),
        ):
            if counts:
                lines.append(f"{sum(counts.values())} frames {title}: {_named(counts)}")
        for title, count in (
            ("sent twice", self.doubled),
            ("out of order", self.out_of_order),
            ("lost, by the counters", self.lost),
        ):
            if count:
                lines.append(f"{count} frames {title}")
        lines += self.consumption.words()
        if self.restarts:
            lines.append(f"{self.restarts} messages began to count anew: their node has restarted")
        for since_s, for_s in self.set_back[:MOST_NAMED]:
            lines.append(f"at {since_s:.3f} s the log's clock is set back by {for_s:.3f} s")
        for since_s, for_s in self.silent[:MOST_NAMED]:
            lines.append(f"at {since_s:.3f} s the log is silent for {for_s:.3f} s")
        return lines


def _named(counts: Counter[str]) -> str:
    each = ", ".join(f"{name} ({n})" for name, n in counts.most_common(MOST_NAMED))
    more = len(counts) - MOST_NAMED
    return each + (f" and {more} more" if more > 0 else "")
