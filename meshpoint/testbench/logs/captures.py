"""Captured edges of real sensors through the edge gate of the node: is a tooth ever lost, and how
well is the edge ten edges ahead predicted?
"""

from __future__ import annotations

import bisect
import itertools
from collections import deque
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from meshpoint.controller.sensing.chain_kernels import STAMPS
from meshpoint.controller.sensing.sensor_clock import SensorClockEstimate, wrap
from meshpoint.controller.sensing.wheel_edges import WheelEdges
from meshpoint.testbench.errors import CommandError
from meshpoint.testbench.logs.capture_files import (
    GAP,
    Capture,
    Floats,
    FoundWheel,
    Integers,
    find_wheel,
    local_ratio,
    read_capture,
)
from meshpoint.testbench.logs.cycle_pattern import CyclePattern

READ_US: Final = 10_000
LONG_US: Final = 65_535
EDGES_AHEAD: Final = 10
CYCLES: Final = (1, 2)
"""Turns after which a pattern may come back: of a wheel, of a four-stroke engine's crank."""
LEARNED_CYCLES: Final = 2
SCORE_SHARE: Final = 0.05
"""What the newest error counts for where predictors are compared."""
CRANK_RAD_S2: Final = 150.0
"""What the speed of a cranked or idling engine changes by."""
CAPTURE_DUTY_SHARE: Final = 0.5


class ReadFrame(NamedTuple):
    """What a capture unit sends of one polarity at a read
    (meshpoint.controller.sensing.wheel_edges.EdgeFrame)."""

    read_time_us: int
    newest_index: int
    valid_stamps: int
    long_interval: bool
    stopped: bool
    timestamp_low_us: tuple[int, ...]
    sensor_fault: bool = False
    """A capture says nothing of its sensor's supply."""


@dataclass(frozen=True)
class NumberedEdges:
    """What the gate made of a capture."""

    time_us: Integers
    tooth: Integers
    falling: Integers
    part: Integers
    """How often teeth were lost before each edge."""
    extra_us: list[int]
    lost: int
    stood: int
    """How often of `lost` the wheel was slow or stood."""
    doubts: int


@dataclass(frozen=True)
class CaptureRow:
    """One file's line in the table. RMS times are of the same edges; None: too few turns."""

    file: str
    wheel: str
    teeth: int
    edges: int
    numbered: int
    """Edges that got a tooth."""
    locked_after_ms: float
    lost: int
    stood: int
    doubts: int
    gaps: int
    """Turns' marks (gaps, or the second channel's edges) after lock, and how many disagree."""
    gaps_wrong: int
    extra_s: list[float]
    constant_speed_rms_us: float | None
    learned_rms_us: float | None

    @property
    def ratio(self) -> float | None:
        """Learned over constant speed."""
        if self.learned_rms_us is None or not self.constant_speed_rms_us:
            return None
        return self.learned_rms_us / self.constant_speed_rms_us

    def to_json(self) -> dict[str, Any]:
        """The row as plain values."""
        return asdict(self) | {"ratio": self.ratio}


def capture_rows(folder: Path) -> list[CaptureRow]:
    """One row a `.csv` file of the folder, in order of their names."""
    files = sorted(folder.glob("*.csv"))
    if not files:
        raise CommandError(f"{folder}: no .csv file in it")
    return [capture_row(read_capture(path)) for path in files]


def capture_row(capture: Capture) -> CaptureRow:
    """A capture through gate and predictor."""
    wheel = find_wheel(capture)
    numbered = number_edges(capture, wheel)
    if not numbered.time_us.size:
        raise CommandError(f"{capture.name}: no tooth of a {wheel} wheel could be numbered")
    marks, wrong = check_marks(capture, wheel, numbered)
    constant, pattern = predict(wheel, numbered)
    start_us = min(capture.rise_us[0], *capture.fall_us[:1], capture.rise_us[-1])
    return CaptureRow(
        capture.name,
        str(wheel),
        wheel.teeth,
        capture.rise_us.size + capture.fall_us.size,
        numbered.time_us.size,
        float(numbered.time_us[0] - start_us) * 1e-3,
        numbered.lost,
        numbered.stood,
        numbered.doubts,
        marks,
        wrong,
        [t * 1e-6 for t in numbered.extra_us],
        constant,
        pattern,
    )


def read_frame(edges_us: list[int], read_us: int) -> ReadFrame:
    """The newest edges at a read, as the capture unit sends them (thesis 2.5, figure 2.2)."""
    seen = bisect.bisect_right(edges_us, read_us)
    times = edges_us[max(0, seen - STAMPS) : seen][::-1]
    long = any(late - early > LONG_US for late, early in itertools.pairwise(times))
    stopped = bool(times) and read_us - times[0] > LONG_US
    low = tuple(t & 0xFFFF for t in times) + (0,) * (STAMPS - len(times))
    return ReadFrame(wrap(read_us), seen & 0xFFFF, len(times), long, stopped, low)


def number_edges(capture: Capture, wheel: FoundWheel) -> NumberedEdges:
    """The capture's edges through the node's own conditioning, read every 10 ms."""
    edges = WheelEdges(wheel.teeth, CAPTURE_DUTY_SHARE, wheel.missing, CRANK_RAD_S2)
    clock = SensorClockEstimate()
    rise, fall = capture.rise_us.tolist(), capture.fall_us.tolist()
    ends = [*rise[:1], *fall[:1], *rise[-1:], *fall[-1:]]
    batches, parts, extra = [], [], []
    for read_us in range(min(ends), max(ends) + 2 * READ_US, READ_US):
        fallen = [read_frame(fall, read_us)] if fall else []
        batch = edges.read([read_frame(rise, read_us)], fallen, clock, read_us)
        batches.append(batch)
        parts.append(np.full(batch.time_us.size, edges.broken))
        extra += edges.extra_us.tolist()
    health = edges.health
    return NumberedEdges(
        np.concatenate([b.time_us for b in batches]).astype(np.int64),
        np.concatenate([b.tooth for b in batches]),
        np.concatenate([b.falling for b in batches]),
        np.concatenate(parts),
        extra,
        edges.broken,
        health.stops,
        health.doubts,
    )


def check_marks(capture: Capture, wheel: FoundWheel, edges: NumberedEdges) -> tuple[int, int]:
    """Marks that come once a turn against the tooth numbers: how many, and how many disagree.

    A gap is one by its length alone; the wheel's edges after a gap must be the teeth after one.
    Without gaps, the second channel's edges must find the same tooth each time."""
    rises = edges.falling == 0
    time_us, tooth = edges.time_us[rises], edges.tooth[rises] % wheel.teeth
    if not wheel.missing:
        at = np.searchsorted(time_us, capture.second_us, "right") - 1
        teeth = tooth[at[at >= 0]]
        return teeth.size, int((teeth != teeth[:1]).sum())
    clean_us = np.setdiff1d(capture.rise_us, edges.extra_us)
    ratio = dict(zip(clean_us[1:].tolist(), local_ratio(clean_us), strict=True))
    behind = {(m + 1) % wheel.teeth for m in wheel.missing} - set(wheel.missing)
    seen = np.array([ratio.get(t, 1.0) for t in time_us.tolist()])
    said = np.isin(tooth, list(behind))
    wrong = (said & (seen < GAP)) | (~said & (seen > GAP + 1.0))
    return int(said.sum()), int(wrong.sum())


class Contest:
    """Predictors side by side; each time the one speaks whose errors were least so far."""

    def __init__(self, count: int) -> None:
        self._square_us2 = np.zeros(count)
        self._pending: deque[list[float]] = deque()

    def said(self, predictions: list[float], time_us: float) -> float:
        """Takes what all say of the edge AHEAD edges ahead, and the edge that has just come."""
        if len(self._pending) == EDGES_AHEAD:
            square = (np.array(self._pending.popleft()) - time_us) ** 2
            self._square_us2 += SCORE_SHARE * (square - self._square_us2)
        self._pending.append(predictions)
        return predictions[int(np.argmin(self._square_us2))]

    def restart(self) -> None:
        """Edges were lost: predictions of before say nothing."""
        self._pending.clear()


def predict(wheel: FoundWheel, edges: NumberedEdges) -> tuple[float | None, float | None]:
    """RMS of the time of the tooth edge AHEAD edges ahead, by constant speed over the last AHEAD
    edges, and by what has been best so far of that and the patterns of one turn and of two; over
    the same edges, from when LEARNED_CYCLES cycles of two turns are learned."""
    rises = edges.falling == 0
    time_us, tooth, part = edges.time_us[rises], edges.tooth[rises], edges.part[rises]
    present = np.array([k for k in range(wheel.teeth) if k not in wheel.missing])
    place = np.searchsorted(present, tooth % wheel.teeth)
    follows = np.r_[False, (np.diff(part) == 0) & (np.diff(place) % present.size == 1)]
    unbroken = np.cumsum(~follows)
    patterns = [CyclePattern(_places(present, wheel.teeth, turns)) for turns in CYCLES]
    slots = [place + present.size * (tooth // wheel.teeth % turns) for turns in CYCLES]
    contest, constant, learned = Contest(1 + len(CYCLES)), [], []
    for k in range(tooth.size):
        for pattern, slot in zip(patterns, slots, strict=True):
            if not follows[k]:
                pattern.restart()
            pattern.edge(int(slot[k]), float(time_us[k]))
        if (
            k < EDGES_AHEAD
            or k + EDGES_AHEAD >= tooth.size
            or unbroken[k - EDGES_AHEAD] != unbroken[k + EDGES_AHEAD]
        ):
            contest.restart()
            continue
        us_a_pitch = (time_us[k] - time_us[k - EDGES_AHEAD]) / (tooth[k] - tooth[k - EDGES_AHEAD])
        straight = float(time_us[k] + us_a_pitch * (tooth[k + EDGES_AHEAD] - tooth[k]))
        best = contest.said(
            [straight, *(p.ahead_us(EDGES_AHEAD) for p in patterns)], float(time_us[k])
        )
        if patterns[-1].cycles >= LEARNED_CYCLES:
            constant.append(straight - float(time_us[k + EDGES_AHEAD]))
            learned.append(best - float(time_us[k + EDGES_AHEAD]))
    return _rms(constant), _rms(learned)


def _places(present: Integers, teeth: int, turns: int) -> Floats:
    """Where in a cycle of so many turns the edges of the drawing lie, as shares."""
    return np.concatenate([present + turn * teeth for turn in range(turns)]) / (turns * teeth)


def _rms(errors: list[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else None
