"""How good the time stamps of an interface are, judged against the sensor clock in the frames.

The sensor side stamps its samples, and sends them every 10 ms. What is left of arrival times when
a steady clock is fitted to those stamps is the delay's scatter: of the bus, the adapter, the
driver and the machine. Our edges carry their own times, so this scatter matters to the mapping of
sensor time to the controller's clock alone.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Final

import numpy as np

from meshpoint.commission.finding import Finding, Verdict
from meshpoint.results.road_speed import span_us

GROUP: Final = "stamps"
LEAST_SAMPLES: Final = 100
BUNDLE_US: Final = 20.0
"""Less than the shortest frame of ours takes on the bus: stamps so close were made together."""
MOST_SCATTER_US: Final = 2_000.0
"""A command may come 2 ms late (docs/wire.md)."""
MOST_DRIFT_PPM: Final = 200.0
"""That much does no harm (docs/wire.md)."""
NO_CRYSTAL_PPM: Final = 10_000.0
"""So far apart are no two clocks that both count time: one waits, or counts something else."""
LONG_ENOUGH_S: Final = 3.0
EPOCH_S: Final = 86_400.0


class StampTrack:
    """Time stamps of the interface beside those of the sensor clock."""

    def __init__(self) -> None:
        self._first: tuple[float, int] | None = None
        self._last_us = 0
        self._total_us = 0
        self._points: list[tuple[float, float]] = []
        self._newest_s: float | None = None
        self.frames = 0
        self.bundled = 0
        """Frames whose stamp is all but that of the frame before."""
        self.back = 0
        """Frames whose stamp is earlier than that of the frame before."""
        self.epoch_s: float | None = None
        """The first stamp less the machine's clock at that moment."""

    def frame(self, stamp_s: float) -> None:
        """The stamp of any frame, in the order of arrival."""
        if self.epoch_s is None:
            self.epoch_s = stamp_s - time.time()
        if self._newest_s is not None:
            ahead_us = (stamp_s - self._newest_s) * 1e6
            self.back += ahead_us < 0.0
            self.bundled += 0.0 <= ahead_us < BUNDLE_US
        self._newest_s = stamp_s
        self.frames += 1

    def sample(self, stamp_s: float, sample_time_us: int) -> None:
        """A frame that says when its samples were taken: 32 bits of the sensor clock."""
        if self._first is None:
            self._first = (stamp_s, sample_time_us)
            self._last_us = sample_time_us
        self._total_us += span_us(sample_time_us, self._last_us)
        self._last_us = sample_time_us
        self._points.append(((stamp_s - self._first[0]) * 1e6, float(self._total_us)))

    def findings(self) -> Iterator[Finding]:
        """What is to be said of the stamps."""
        if len(self._points) < LEAST_SAMPLES:
            yield Finding(
                GROUP, "time stamps", Verdict.UNKNOWN,
                f"{len(self._points)} samples of the sensor side, {LEAST_SAMPLES} wanted",
            )  # fmt: skip
            return
        arrival_us, sensor_us = np.array(self._points).T
        slope, offset = np.polyfit(sensor_us, arrival_us, 1)
        rest_us = arrival_us - slope * sensor_us - offset
        yield self._judge_scatter(rest_us)
        yield _judge_drift((slope - 1.0) * 1e6, float(rest_us.std()), sensor_us)
        yield self._judge_order()

    def _judge_scatter(self, rest_us: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Finding:
        worst_us = float(np.abs(rest_us).max())
        text = (
            f"{float(rest_us.std()):.0f} us RMS, {worst_us:.0f} us at most against the sensor "
            f"clock; {100.0 * self.bundled / max(self.frames, 1):.0f} % of frames came in bundles"
        )
        if float(rest_us.std()) > MOST_SCATTER_US:
            text += "; a command may come 2 ms late at most, so valves would refuse some"
            return Finding(GROUP, "arrival", Verdict.BAD, text)
        if worst_us > MOST_SCATTER_US:
            text += "; some came more than 2 ms late: a busy machine, or the adapter's queue"
            return Finding(GROUP, "arrival", Verdict.NOTE, text)
        return Finding(GROUP, "arrival", Verdict.GOOD, text)

    def _judge_order(self) -> Finding:
        if self.back:
            return Finding(
                GROUP, "order", Verdict.NOTE,
                f"{self.back} stamps are earlier than the frame before: order in logs is arrival's",
            )  # fmt: skip
        if self.epoch_s is not None and abs(self.epoch_s) > EPOCH_S:
            return Finding(
                GROUP, "epoch", Verdict.NOTE,
                "stamps do not count from 1970: logs of two adapters cannot be laid side by side",
            )  # fmt: skip
        return Finding(GROUP, "order", Verdict.GOOD, f"{self.frames} stamps in order")


def _judge_drift(
    drift_ppm: float, scatter_us: float, sensor_us: np.ndarray[tuple[int], np.dtype[np.float64]]
) -> Finding:
    span_s = float(np.ptp(sensor_us)) * 1e-6
    # Standard error of a fitted slope over evenly spaced samples; neighbours are not independent,
    # so a tenth of them counts.
    sd_ppm = scatter_us / span_s * (12.0 / (len(sensor_us) / 10.0)) ** 0.5
    if abs(drift_ppm) - 2 * sd_ppm > NO_CRYSTAL_PPM:
        text = (
            f"the sensor clock runs {1.0 / (1.0 + drift_ppm * 1e-6):.2f} times as fast as this "
            "machine's: so it does on a bus time that waits for nodes (up, demo, pace) or has "
            "another --speed; of hardware, is it in microseconds?"
        )
        return Finding(GROUP, "drift", Verdict.BAD, text)
    text = f"{drift_ppm:+.0f} +- {2 * sd_ppm:.0f} ppm between this machine and the sensor clock"
    if span_s < LONG_ENOUGH_S or 2 * sd_ppm > MOST_DRIFT_PPM:
        why = "listen longer (--seconds)"
        return Finding(GROUP, "drift", Verdict.UNKNOWN, f"{text}: {why}")
    if abs(drift_ppm) - 2 * sd_ppm > MOST_DRIFT_PPM:
        return Finding(GROUP, "drift", Verdict.BAD, f"{text}, more than {MOST_DRIFT_PPM:g}")
    return Finding(GROUP, "drift", Verdict.GOOD, text)
