"""What a report draws of each shift, gathered from the frames of a bus in their order.

Simulate, demo and replay hand over the same frames, so the same bus gives the same report. Series
are cut out a moment after a shift has ended and the rest is dropped: a run may be of any length.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import (
    ControllerEstimates,
    ControllerState,
    ControllerStatus,
    Message,
    ReferenceEngagement,
    ShiftDecision,
    ShiftOutcome,
    ShiftPrediction,
    ShiftResult,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.dbc.sensor_time import unwrap
from meshpoint.gearbox import GearboxSheet
from meshpoint.report.beliefs import Belief, Beliefs
from meshpoint.report.judged import Judged
from meshpoint.results.road_speed import span_us
from meshpoint.results.rows import RowCollector, ShiftRow
from meshpoint.results.traces import TRACED, Traces
from meshpoint.units import DEG, RPM

BEFORE_S: Final = 0.05
AFTER_S: Final = 0.15
LATE_S: Final = 0.05
"""Frames of a moment may come in this much later than one another."""
KEEP_S: Final = 30.0
"""How far back a shift may have begun when its outcome comes."""
MADE: Final = (ControllerEstimates, ControllerStatus, ShiftOutcome, ShiftPrediction)
"""What the controller says; a replay takes these from the controller that it runs."""
COLLECTED_IDS: Final = frozenset(
    CODECS[kind.__name__].spec.can_id for kind in (*TRACED, *MADE, ReferenceEngagement)
)
ABORTED: Final = "aborted"
AIMED_DECISIONS: Final = (ShiftDecision.FIRE, ShiftDecision.COMMITTED)
Points = tuple[list[float], list[float]]
"""Times in ms since the request, and values."""


class Firing(NamedTuple):
    """A sleeve that was fired, and what was predicted then; times in ms since the request."""

    decided_ms: float
    fire_ms: float
    contact_ms: float
    phase_deg: float
    sd_deg: float
    """0: the phase was not known."""
    slip_rpm: float
    belief: Belief | None = None
    """What it was predicted from; None where the controller was not asked."""


@dataclass(frozen=True)
class ReportShift:
    """One shift: its row, the controller's own account, and its series by name."""

    row: ShiftRow
    outcome: ShiftOutcome
    target_deg: float
    """Where in the gap was aimed at; the row's phase error counts from there."""
    series: dict[str, Points]
    firings: tuple[Firing, ...] = ()
    """Those withdrawn before their valve's time left out."""
    replayed: Judged | None = None
    """What another strategy decides on these frames; nothing else here is of its doing."""

    def ms(self, stamp_us: int) -> float:
        """A 32-bit sensor time in ms since the request."""
        return span_us(stamp_us, self.row.request_us) / 1000

    @property
    def aborted_ms(self) -> list[float]:
        """When the controller stopped a sleeve on its way, to within a step."""
        return self.points(ABORTED)[0]

    def aborts_on(self, name: str) -> Points:
        """Each abort as a point of a series; none where the bus did not carry it."""
        times_ms, values = self.points(name)
        if not times_ms:
            return [], []
        return self.aborted_ms, np.interp(self.aborted_ms, times_ms, values).tolist()

    @property
    def contact_ms(self) -> float | None:
        """First contact by the rig's truth."""
        return None if self.row.contact_us is None else self.ms(self.row.contact_us)

    def fired_before(self, at_ms: float) -> Firing | None:
        """The last firing before a contact: the one that made it."""
        return next((each for each in reversed(self.firings) if each.fire_ms < at_ms), None)

    @property
    def contact_phase_deg(self) -> float | None:
        """Phase at first contact by the rig's truth, from the middle of the gap."""
        error = self.row.phase_error_deg
        return None if error is None else error + self.target_deg

    def points(self, name: str) -> Points:
        """A series; empty where the bus did not carry it."""
        return self.series.get(name, ([], []))


class _ReportTraces(Traces):
    """The traces of a run with what only a report draws: bounds, predictions, every valve."""

    def __init__(self) -> None:
        super().__init__()
        self._state: ControllerState | None = None

    def take(self, message: Message) -> None:
        """One message in bus order."""
        super().take(message)
        if isinstance(message, ControllerEstimates):
            self._bounds(message)
        elif isinstance(message, ControllerStatus):
            self._status(message)
        elif isinstance(message, ValveStatus):
            time_us = self._time_us(message.sample_time_us)
            for name in ("split_low", "split_high", "range_low", "range_high"):
                self._add(f"valve_{name}", time_us, float(getattr(message, f"{name}_energised")))
        elif isinstance(message, ShiftPrediction) and message.decision in AIMED_DECISIONS:
            time_us = self._time_us(message.decision_time_us)
            self._add("predicted_phase_deg", time_us, message.phase_rad / DEG)
            self._add("predicted_phase_sd_deg", time_us, message.phase_sd_rad / DEG)

    def _status(self, message: ControllerStatus) -> None:
        """A step says no sensor time: an abort counts as of the newest measurement before it."""
        if message.state is ControllerState.HALTED is not self._state:
            self._add(ABORTED, self._latest_us, 1.0)
        self._state = message.state

    def _bounds(self, message: ControllerEstimates) -> None:
        time_us = self._time_us(message.estimate_time_us)
        if message.layshaft_valid:
            self._add("estimated_layshaft_sd_rpm", time_us, message.layshaft_speed_sd_rad_s / RPM)
        if message.main_valid:
            self._add("estimated_main_rpm", time_us, message.main_speed_rad_s / RPM)
            self._add("estimated_main_sd_rpm", time_us, message.main_speed_sd_rad_s / RPM)
        if message.phase_known:
            self._add("estimated_phase_sd_deg", time_us, message.phase_sd_rad / DEG)

    @property
    def latest_s(self) -> float:
        """The newest sensor time seen."""
        return self._latest_us * 1e-6

    def unwrapped_s(self, stamp_us: int) -> float:
        """A 32-bit sensor time near the newest one, in the series' seconds."""
        return unwrap(stamp_us, self._latest_us) * 1e-6

    def forget(self, before_s: float) -> None:
        """Drops the points before a time."""
        for series in self.series.values():
            count = bisect_left(series.time_s, before_s)
            del series.time_s[:count], series.value[:count]


class ReportCollector:
    """Makes a `ReportShift` of every shift on a bus."""

    def __init__(
        self,
        sheet: GearboxSheet,
        target_rad: float = 0.0,
        settings: ControllerSettings | None = None,
        beliefs: Beliefs | None = None,
    ) -> None:
        """`settings`: of the controller, which name a user's own strategy; `beliefs`: what it
        believed at each firing, there by the end of the shift."""
        self._target_rad = target_rad
        self._beliefs = {} if beliefs is None else beliefs.of
        self._fired: list[ShiftPrediction] = []
        self._rows = RowCollector(sheet, target_rad, settings)
        self._receiver = Receiver(*Node)
        self._traces = _ReportTraces()
        self._ended: list[tuple[ShiftRow, ShiftOutcome, float, list[ShiftPrediction]]] = []
        self._forgot_s = 0.0
        self._shifts: list[ReportShift] = []

    def receive(self, frame: Frame) -> None:
        """One frame in bus order."""
        if frame.can_id not in COLLECTED_IDS:
            return
        message = self._receiver.receive(frame).message
        if message is not None:
            self.take(message)

    def take(self, message: Message) -> None:
        """One message in bus order."""
        self._traces.take(message)
        self._rows.take(message)
        if isinstance(message, ShiftOutcome):
            if message.result is not ShiftResult.REFUSED:
                request_s = self._traces.unwrapped_s(message.request_time_us)
                self._ended.append((self._rows.rows[-1], message, request_s, self._fired))
                self._fired = []
            return
        if isinstance(message, ShiftPrediction) and message.decision is ShiftDecision.COMMITTED:
            self._fired.append(message)
        latest_s = self._traces.latest_s
        if self._ended and latest_s > self._cut_end_s() + LATE_S:
            self._cut()
        elif latest_s - self._forgot_s > 2 * KEEP_S:
            self._traces.forget(latest_s - KEEP_S)
            self._forgot_s = latest_s

    def restart(self) -> None:
        """Another run begins on this bus, perhaps with another sensor clock."""
        self._cut_all()
        self._traces, self._forgot_s = _ReportTraces(), 0.0

    def finish(self) -> list[ReportShift]:
        """All shifts, at the end of the bus, with what their rows have got after their ends."""
        self._cut_all()
        rows = zip(self._shifts, self._rows.rows, strict=True)
        return [replace(shift, row=row) for shift, row in rows]

    def _cut_all(self) -> None:
        while self._ended:
            self._cut()

    def _cut_end_s(self) -> float:
        row, _, request_s, _ = self._ended[0]
        return request_s + row.duration_ms / 1000 + AFTER_S

    def _cut(self) -> None:
        end_s = self._cut_end_s()
        row, outcome, request_s, fired = self._ended.pop(0)
        series: dict[str, Points] = {}
        for name, points in self._traces.series.items():
            times_s, values = points.between(request_s - BEFORE_S, end_s)
            if times_s:
                series[name] = ([1e3 * (t - request_s) for t in times_s], values)
        firings = tuple(self._firing(row, each) for each in fired)
        self._shifts.append(ReportShift(row, outcome, self._target_rad / DEG, series, firings))
        self._traces.forget(end_s - AFTER_S)

    def _firing(self, row: ShiftRow, message: ShiftPrediction) -> Firing:
        def ms(stamp_us: int) -> float:
            return span_us(stamp_us, row.request_us) / 1000

        return Firing(
            decided_ms=ms(message.decision_time_us),
            fire_ms=ms(message.fire_time_us),
            contact_ms=ms(message.contact_time_us),
            phase_deg=message.phase_rad / DEG,
            sd_deg=message.phase_sd_rad / DEG,
            slip_rpm=message.slip_rad_s / RPM,
            belief=self._beliefs.get(message.contact_time_us),
        )
