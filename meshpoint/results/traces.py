"""Time series of a run, taken from the frames on the bus: what plots and reports draw."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from meshpoint.dbc.messages import (
    ControllerEstimates,
    GearboxSensors,
    Message,
    ReferenceEncoder,
    ReferencePhase,
    SleevesMain,
    ValveStatus,
)
from meshpoint.dbc.sensor_time import unwrap
from meshpoint.units import BAR, DEG, RPM

GEAR_FIELDS: Final = {
    "crawl": "phase_crawl_rad",
    "first": "phase_first_rad",
    "second": "phase_second_rad",
    "third": "phase_third_rad",
}
TRACED: Final = (
    ControllerEstimates, GearboxSensors, ReferenceEncoder, ReferencePhase, SleevesMain, ValveStatus,
)  # fmt: skip
"""The messages that traces are drawn from."""
ENCODER_STEP_US: Final = 2_000
SLEEVE_STEP_US: Final = 1_000


@dataclass
class Series:
    """One signal: sensor times in seconds and values."""

    time_s: list[float] = field(default_factory=list)
    value: list[float] = field(default_factory=list)

    def add(self, time_us: int, value: float) -> None:
        """One more point."""
        self.time_s.append(time_us * 1e-6)
        self.value.append(value)

    def between(self, start_s: float, end_s: float) -> tuple[list[float], list[float]]:
        """The points of a time window."""
        points = [
            (t, v) for t, v in zip(self.time_s, self.value, strict=True) if start_s <= t <= end_s
        ]
        return [t for t, _ in points], [v for _, v in points]


class Traces:
    """All series of a run, by name; unwrapped sensor time."""

    def __init__(self) -> None:
        self.series: dict[str, Series] = {}
        self._latest_us = 0

    def _add(self, name: str, time_us: int, value: float) -> None:
        self.series.setdefault(name, Series()).add(time_us, value)

    def time_s(self, stamp_us: int) -> float:
        """A 32-bit sensor time of this run in the traces' seconds."""
        return unwrap(stamp_us, self._latest_us) * 1e-6

    def _time_us(self, stamp: int) -> int:
        time_us = unwrap(stamp, self._latest_us) if self._latest_us else stamp
        self._latest_us = max(self._latest_us, time_us)
        return time_us

    def take(self, message: Message) -> None:
        """One message in bus order."""
        if isinstance(message, ReferenceEncoder):
            newest = self._time_us(message.sample_time_us)
            for k in range(len(message.speed_rad_s) - 1, -1, -1):
                speed = message.speed_rad_s[k] / RPM
                self._add("layshaft_rpm", newest - k * ENCODER_STEP_US, speed)
        elif isinstance(message, ReferencePhase):
            time_us = self._time_us(message.sample_time_us)
            self._add("main_rpm", time_us, message.main_speed_rad_s / RPM)
            for gear, name in GEAR_FIELDS.items():
                self._add(f"phase_{gear}_deg", time_us, getattr(message, name) / DEG)
        elif isinstance(message, ControllerEstimates):
            self._estimates(message)
        elif isinstance(message, GearboxSensors):
            time_us = self._time_us(message.sample_time_us)
            self._add("pressure_bar", time_us, message.brake_pressure_pa / BAR)
            self._add("clutch_percent", time_us, 100.0 * message.clutch_position_fraction)
        elif isinstance(message, SleevesMain):
            newest = self._time_us(message.sample_time_us)
            for k in range(len(message.sleeve_first_second_m) - 1, -1, -1):
                time_us = newest - k * SLEEVE_STEP_US
                self._add("sleeve_first_second_mm", time_us, message.sleeve_first_second_m[k] * 1e3)
                self._add("sleeve_crawl_third_mm", time_us, message.sleeve_crawl_third_m[k] * 1e3)
        elif isinstance(message, ValveStatus):
            time_us = self._time_us(message.sample_time_us)
            for name in ("brake", "main_first", "main_second", "main_crawl", "main_third"):
                self._add(f"valve_{name}", time_us, float(getattr(message, f"{name}_energised")))

    def _estimates(self, message: ControllerEstimates) -> None:
        time_us = self._time_us(message.estimate_time_us)
        if message.layshaft_valid:
            self._add("estimated_layshaft_rpm", time_us, message.layshaft_speed_rad_s / RPM)
        if message.phase_known:
            self._add("estimated_phase_deg", time_us, message.phase_rad / DEG)
