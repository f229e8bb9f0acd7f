"""One output driven once: which sleeve moved, which way, and when; or what the brake's air did."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

from meshpoint.controller.settings.valve_name import ValveName, energised
from meshpoint.dbc.messages import GearboxSensors, Message, SleevesAux, SleevesMain, ValveStatus
from meshpoint.gearbox.gears import Sleeve
from meshpoint.results.road_speed import span_us
from meshpoint.units import MM

SAMPLE_US: Final = 1_000
MOVED_M: Final = 2.0 * MM
"""Less is backlash, noise, or a sleeve pushed further onto its stop."""
BEGUN_M: Final = 0.3 * MM
PRESSURE_PA: Final = 1.0e5
"""The brake's air has come when its pressure has risen by so much."""
EXPECTED: Final = {
    ValveName.SPLIT_LOW: (Sleeve.SPLITTER, -1),
    ValveName.SPLIT_HIGH: (Sleeve.SPLITTER, +1),
    ValveName.MAIN_FIRST: (Sleeve.FIRST_SECOND, -1),
    ValveName.MAIN_SECOND: (Sleeve.FIRST_SECOND, +1),
    ValveName.MAIN_CRAWL: (Sleeve.CRAWL_THIRD, -1),
    ValveName.MAIN_THIRD: (Sleeve.CRAWL_THIRD, +1),
    ValveName.RANGE_LOW: (Sleeve.RANGE, -1),
    ValveName.RANGE_HIGH: (Sleeve.RANGE, +1),
}
"""What a valve of that name moves, and which way."""


@dataclass
class Trial:
    """What was seen from the activation of one valve on. Times are the sensor clock's, us."""

    valve: ValveName
    activation_us: int
    before_m: dict[Sleeve, float]
    before_pa: float
    ways_m: dict[Sleeve, float] = field(default_factory=dict)
    """The greatest way of each sleeve from where it stood, with its sign."""
    begun_us: dict[Sleeve, int] = field(default_factory=dict)
    """When a sleeve first left its place, after the activation."""
    path: dict[Sleeve, list[tuple[int, float]]] = field(default_factory=dict)
    """Samples of each sleeve: after the activation (us), position (m)."""
    pressure: list[tuple[int, float]] = field(default_factory=list)
    """Samples of the brake's pressure rise: after the activation (us), Pa."""
    driven: set[ValveName] = field(default_factory=set)
    """Valves that the valve side said were driven."""
    cut_short: str = ""
    """Why the valve was switched off before its time; empty if it was not."""

    def take(self, message: Message) -> None:
        """A message of sensor or valve side."""
        if isinstance(message, SleevesMain):
            self._samples(
                Sleeve.FIRST_SECOND, message.sample_time_us, message.sleeve_first_second_m
            )
            self._samples(Sleeve.CRAWL_THIRD, message.sample_time_us, message.sleeve_crawl_third_m)
        elif isinstance(message, SleevesAux):
            self._samples(Sleeve.SPLITTER, message.sample_time_us, message.sleeve_splitter_m)
            self._samples(Sleeve.RANGE, message.sample_time_us, message.sleeve_range_m)
        elif isinstance(message, GearboxSensors):
            after_us = span_us(message.sample_time_us, self.activation_us)
            self.pressure.append((after_us, message.brake_pressure_pa - self.before_pa))
        elif isinstance(message, ValveStatus):
            self.driven.update(energised(message))

    def _samples(self, sleeve: Sleeve, newest_us: int, samples_m: tuple[float, ...]) -> None:
        before_m = self.before_m[sleeve]
        for age in range(len(samples_m) - 1, -1, -1):
            after_us = span_us(newest_us, self.activation_us) - age * SAMPLE_US
            way_m = samples_m[age] - before_m
            if abs(way_m) > abs(self.ways_m.get(sleeve, 0.0)):
                self.ways_m[sleeve] = way_m
            if after_us < 0:
                continue
            self.path.setdefault(sleeve, []).append((after_us, samples_m[age]))
            if abs(way_m) > BEGUN_M and sleeve not in self.begun_us:
                self.begun_us[sleeve] = after_us

    @property
    def moved(self) -> list[tuple[Sleeve, int]]:
        """Sleeves that moved, and their direction."""
        return [
            (sleeve, 1 if way_m > 0.0 else -1)
            for sleeve, way_m in sorted(self.ways_m.items())
            if abs(way_m) > MOVED_M
        ]

    @property
    def has_braked(self) -> bool:
        """Whether the brake's air came."""
        return any(rise_pa > PRESSURE_PA for _, rise_pa in self.pressure)

    @property
    def is_conclusive(self) -> bool:
        """Whether anything came of it."""
        return bool(self.moved) or self.has_braked

    def reaches_us(self, sleeve: Sleeve, way_m: float) -> float | None:
        """When a sleeve, pushed out of neutral, had come so far; None where it had not, or did not
        begin there."""
        if abs(self.before_m[sleeve]) > 1.0 * MM:
            return None
        path = self.path.get(sleeve, [])
        for (t0, x0), (t1, x1) in pairwise(path):
            a_m, b_m = abs(x0), abs(x1)
            if a_m < way_m <= b_m:
                return t0 + (way_m - a_m) / (b_m - a_m) * (t1 - t0)
        return None
