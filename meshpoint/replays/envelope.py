"""A signal of any length in a bounded number of points: least and greatest value of each span."""

from __future__ import annotations

from typing import Final

MOST_SPANS: Final = 2000
FIRST_SPAN_S: Final = 0.01
BREAK_S: Final = 0.1
"""A line is broken where nothing came for longer, and for at least a span."""


class Envelope:
    """Takes values in order of time, in s from 0 on. Where they would come to more than
    `MOST_SPANS` spans, two of these become one, twice as long: peaks stay, memory is bounded."""

    def __init__(self) -> None:
        self.span_s = FIRST_SPAN_S
        self._spans: dict[int, tuple[float, float]] = {}

    def take(self, at_s: float, value: float) -> None:
        """A value of now."""
        while at_s >= MOST_SPANS * self.span_s:
            self._halve()
        self._widen(int(at_s / self.span_s), value, value)

    def _widen(self, span: int, least: float, most: float) -> None:
        was = self._spans.get(span, (least, most))
        self._spans[span] = min(was[0], least), max(was[1], most)

    def _halve(self) -> None:
        was, self._spans = self._spans, {}
        self.span_s *= 2.0
        for span, (least, most) in was.items():
            self._widen(span // 2, least, most)

    def points(self) -> tuple[list[float], list[float | None]]:
        """Times in s and values to draw a line by: least and greatest of each span in turn, and
        None where it was silent."""
        times: list[float] = []
        values: list[float | None] = []
        last: int | None = None
        for span, (least, most) in self._spans.items():
            at_s = span * self.span_s
            if last is not None and (span - last - 1) * self.span_s >= BREAK_S:
                times.append(round(at_s - 0.5 * self.span_s, 4))
                values.append(None)
            times.append(round(at_s, 4))
            values.append(round(least, 2))
            if most > least:
                times.append(round(at_s + 0.5 * self.span_s, 4))
                values.append(round(most, 2))
            last = span
        return times, values
