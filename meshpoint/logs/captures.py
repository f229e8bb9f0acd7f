"""Captured edges of real sensors through the edge gate of the node: is a tooth ever lost, and how
well is the edge ten edges ahead predicted?
"""

from __future__ import annotations

import bisect
import itertools
from dataclasses import asdict, dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from meshpoint.controller.measure.clock import SensorClockEstimate
from meshpoint.controller.measure.inputs import STAMPS
from meshpoint.controller.measure.wheel_edges import WheelEdges
from meshpoint.dbc.sensor_time import wrap
from meshpoint.kernels.records import Integers
from meshpoint.logs.capture_files import (
    GAP,
    Capture,
    FoundWheel,
    local_ratio,
)
from meshpoint.logs.capture_prediction import predict
from meshpoint.logs.capture_truth import true_teeth, wrong_teeth

READ_US: Final = 10_000
LONG_US: Final = 65_535
CRANK_RAD_S2: Final = 150.0
"""What the speed of a cranked or idling engine changes by."""
CAPTURE_DUTY_SHARE: Final = 0.5


class ReadFrame(NamedTuple):
    """What a capture unit sends of one polarity at a read
    (meshpoint.controller.measure.inputs.EdgeFrame)."""

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
    lead: int
    """The polarity that teeth begin with: 0 rising, 1 falling."""


@dataclass(frozen=True)
class CaptureRow:
    """One file's line in the table. RMS times are of the same edges; None: too few turns."""

    file: str
    wheel: str
    teeth: int
    channel: str
    polarity: str
    """Which channel was used, and which of its edges."""
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
    checked: int
    """Numbered edges whose tooth the whole file shows as well, and how many disagree."""
    wrong: int
    extra_s: list[float]
    constant_speed_rms_us: float | None
    turn_ago_rms_us: float | None
    learned_rms_us: float | None
    tried: list[str]
    """What came of each channel and polarity that was tried."""

    @property
    def ratio(self) -> float | None:
        """Learned over constant speed."""
        if self.learned_rms_us is None or not self.constant_speed_rms_us:
            return None
        return self.learned_rms_us / self.constant_speed_rms_us

    def to_json(self) -> dict[str, Any]:
        """The row as plain values."""
        return asdict(self) | {"ratio": self.ratio}


def capture_row(
    capture: Capture,
    wheel: FoundWheel,
    numbered: NumberedEdges,
    channel: str = "",
    polarity: str = "",
    tried: list[str] | None = None,
) -> CaptureRow:
    """A numbered capture, checked and predicted."""
    marks, marks_wrong = check_marks(capture, wheel, numbered)
    checked, wrong = check_teeth(capture, wheel, numbered)
    first = numbered.falling == numbered.lead
    predicted = predict(wheel, numbered.tooth[first], numbered.time_us[first], numbered.part[first])
    start_us = min(*capture.rise_us[:1], *capture.fall_us[:1], capture.lead_us[-1])
    return CaptureRow(
        capture.name,
        str(wheel),
        wheel.teeth,
        channel,
        polarity,
        capture.edges,
        numbered.time_us.size,
        float(numbered.time_us[0] - start_us) * 1e-3,
        numbered.lost,
        numbered.stood,
        numbered.doubts,
        marks,
        marks_wrong,
        checked,
        wrong,
        [t * 1e-6 for t in numbered.extra_us],
        predicted.constant_us,
        predicted.turn_ago_us,
        predicted.in_use_us,
        tried or [],
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
        int(edges.begins_falling),
    )


def check_marks(capture: Capture, wheel: FoundWheel, edges: NumberedEdges) -> tuple[int, int]:
    """Marks that come once a turn against the tooth numbers: how many, and how many disagree.

    A gap is one by its length alone; the wheel's edges after a gap must be the teeth after one.
    Without gaps, the second channel's edges must find the same tooth each time."""
    first = edges.falling == edges.lead
    time_us, tooth = edges.time_us[first], edges.tooth[first] % wheel.teeth
    if not wheel.missing:
        at = np.searchsorted(time_us, capture.second_us, "right") - 1
        teeth = tooth[at[at >= 0]]
        return teeth.size, int((teeth != teeth[:1]).sum())
    clean_us = np.setdiff1d(_lead_us(capture, edges), edges.extra_us)
    ratio = dict(zip(clean_us[1:].tolist(), local_ratio(clean_us), strict=True))
    behind = {(m + 1) % wheel.teeth for m in wheel.missing} - set(wheel.missing)
    seen = np.array([ratio.get(t, 1.0) for t in time_us.tolist()])
    said = np.isin(tooth, list(behind))
    wrong = (said & (seen < GAP)) | (~said & (seen > GAP + 1.0))
    return int(said.sum()), int(wrong.sum())


def check_teeth(capture: Capture, wheel: FoundWheel, edges: NumberedEdges) -> tuple[int, int]:
    """Each tooth number against the one that the whole file shows (`capture_truth`): how many can
    be checked, and how many are wrong. An edge that a tooth ends with is that of the tooth whose
    beginning is the last before it."""
    lead_us = _lead_us(capture, edges)
    true = true_teeth(lead_us, wheel, capture.second_us)
    at = np.searchsorted(lead_us, edges.time_us, "right") - 1
    # Where teeth begin with the falling edge, the rising one behind it belongs to the next number.
    said = edges.tooth - np.where(edges.falling != edges.lead, edges.lead, 0)
    found = np.where(at >= 0, true[np.maximum(at, 0)], -1)
    parts = [edges.part == part for part in np.unique(edges.part)]
    counts = [wrong_teeth(said[p], found[p], wheel.teeth, bool(wheel.missing)) for p in parts]
    return sum(n for n, _ in counts), sum(wrong for _, wrong in counts)


def _lead_us(capture: Capture, edges: NumberedEdges) -> Integers:
    return capture.fall_us if edges.lead else capture.rise_us
