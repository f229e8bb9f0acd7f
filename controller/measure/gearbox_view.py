"""What the gearbox's sensors show besides edges: sleeves, gears in mesh, clutch, brake pressure.

Clutch: the actuator moves on at the rate of its newest two samples, which says what it will do in
some hundredths of a second. Further ahead nothing is said.

Brake pressure: a sensor with its filter is a first-order lag, tau m' = p - m, so with Taylor's
series

    m(t) = m(t - tau) + tau m'(t - tau) + tau^2 / 2 m'' + ... = p(t - tau) + tau^2 / 2 m'' + ...

A sample is therefore the pressure one lag earlier, but for its curvature, which is known from the
two samples before. For 5 ms, samples each 10 ms and a chamber that empties within 60 ms it is 0.04
bar, and its noise adds 5 % to a sample's. The sensor's offset is learned while the chamber is
empty: with the valve off for long enough it is at the pressure of the air around, so whatever the
sensor shows above that is its offset. Every shift ends with seconds of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from meshpoint.dbc.messages import SleevesAux, SleevesMain
from meshpoint.gearbox import GearboxSheet, MainGear, Range, Sleeve, Split
from meshpoint.gearbox.gears import DRIVE_GEAR_WITH, MAIN_SLEEVES, SLEEVE_OF_MAIN
from meshpoint.kernels.records import Vector
from meshpoint.units import SECOND_US, US

LONGEST_US: Final = 30_000
"""Longest time between two pressure samples; beyond that nothing is said of the way there."""

REST_TIME_CONSTANTS: Final = 8.0
"""A chamber has emptied this many time constants after its valve went off: to 1 / 3000 of its
pressure."""
FORGET: Final = 0.998
"""Weight of the past with each new sample: 5 s at 10 ms, in which an offset changes little."""
LEAST_SAMPLES: Final = 10.0
MOST_PA: Final = 1.5e5
"""No sensor is off by more than this: more is pressure, of a valve that is stuck."""

GAP_US: Final = 25_000
"""Samples further apart than this say nothing of how fast the clutch moves."""
AHEAD_US: Final = 100_000
"""Nothing is said of where the clutch will be after longer than this."""
STILL_PER_S: Final = 0.5
"""Slower than this, an end in 2 s, the clutch counts as standing still."""

VIEW_NEUTRAL_M: Final = 1.5e-3
"""A sleeve within this of the middle is in neutral, or its detent brings it there."""
ENGAGED_SHORT_M: Final = 1.0e-3
"""A sleeve within this of its stroke is in mesh."""
ENTERED_M: Final = 0.3e-3
"""A sleeve this far past contact has entered its gear; at contact it may rest on a tooth."""
RESTS_M: Final = 0.4e-3
"""A sleeve that has moved less than this within a frame stands: some times the sensors' noise."""
MEAN_SAMPLES: Final = 5
"""Single samples would not do to see whether a sleeve moves: a sensor's noise may be 0.1 mm."""
STILL_MEANS: Final = 3
STILL_M: Final = 1.2e-4
"""A sleeve stands where three means, one after the other, are this close to each other: it moves by
no more than 12 mm/s, and does not turn round just then."""
SAMPLE_US: Final = 1000
SAMPLES: Final = 10
"""Of a sleeve in a frame."""
SLEEVE_COUNT: Final = len(Sleeve)
_new: Final = tuple.__new__  # a NamedTuple without its constructor's argument handling
_GEAR_AT: Final = {(side.sleeve, side.direction): g for g, side in SLEEVE_OF_MAIN.items()}
_SPLIT_AT: Final = {-1: Split.LOW, 0: None, 1: Split.HIGH}
_RANGE_AT: Final = {-1: Range.LOW, 0: None, 1: Range.HIGH}
RESTING_M: Final = 1e-3
"""A sleeve this close to the middle rests: what its sensor reads there is its offset."""
REST_SHARE: Final = 0.05
SHORT_M: Final = 4e-4
"""This far before its nominal position a tooth may stop or rub on a sleeve."""


class PressureSamples(NamedTuple):
    """Samples of a pressure, rising in time."""

    time_us: Vector
    pressure_pa: Vector
    """As measured, gauge."""
    curvature_pa_s2: Vector
    """Second derivative, by the two samples before; 0 where there are none."""

    def before_the_lag(self, lag_s: float) -> tuple[Vector, Vector]:
        """Times (us) and pressures (Pa) in front of a sensor's lag."""
        bent_pa = 0.5 * lag_s * lag_s * self.curvature_pa_s2
        return self.time_us - lag_s * SECOND_US, self.pressure_pa - bent_pa


NO_SAMPLES: Final = PressureSamples(*(np.empty(0) for _ in PressureSamples._fields))


def together(parts: Sequence[PressureSamples]) -> PressureSamples:
    """Samples that follow one another."""
    return PressureSamples(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


class PressureSampler:
    """Keeps the newest samples, for the curvature at the next."""

    def __init__(self) -> None:
        self._newest: tuple[int, float] | None = None
        self._newest_slope: tuple[int, float] | None = None
        """Over how long, and the slope (Pa/s)."""

    def take(self, samples: Sequence[tuple[int, float]]) -> PressureSamples:
        """One step's samples: time (us) and pressure (Pa)."""
        times_us = [time_us for time_us, _ in samples]
        pressures_pa = [pressure_pa for _, pressure_pa in samples]
        curvatures = [self._curvature(*sample) for sample in samples]
        return PressureSamples(*np.array((times_us, pressures_pa, curvatures), dtype=np.float64))

    def _curvature(self, time_us: int, pressure_pa: float) -> float:
        before, self._newest = self._newest, (time_us, pressure_pa)
        slope_before, self._newest_slope = self._newest_slope, None
        if before is None or not 0 < time_us - before[0] <= LONGEST_US:
            return 0.0
        since_us = time_us - before[0]
        slope = (pressure_pa - before[1]) / (since_us * US)
        self._newest_slope = since_us, slope
        if slope_before is None:
            return 0.0
        return 2.0 * (slope - slope_before[1]) / ((since_us + slope_before[0]) * US)


class PressureZero:
    """What the sensor shows of an empty chamber."""

    def __init__(self, time_constant_s: float) -> None:
        self._wait_us = 1e6 * REST_TIME_CONSTANTS * time_constant_s
        self._driven_us = -math.inf
        self._weight = self._mean_pa = 0.0

    def take(self, time_us: float, gauge_pa: float, driven: bool) -> float:
        """One sample, gauge; driven: the valve is on, or will be. Returns the pressure with the
        offset taken out."""
        if driven:
            self._driven_us = time_us
        elif time_us - self._driven_us > self._wait_us and abs(gauge_pa) <= MOST_PA:
            self._weight = FORGET * self._weight + 1.0
            self._mean_pa += (gauge_pa - self._mean_pa) / self._weight
        return gauge_pa - self.offset_pa

    @property
    def offset_pa(self) -> float:
        """The sensor's offset; 0 before some samples have shown it."""
        return self._mean_pa if self._weight >= LEAST_SAMPLES else 0.0


class ClutchTrack:
    """Position of the clutch, 0 open to 1 closed, by time."""

    def __init__(self) -> None:
        self.closed: float | None = None
        """Its newest position; None before the first sample."""
        self.newest_us = 0
        self.rate_per_s = 0.0
        """How fast it closes; negative: opens."""
        self.before: tuple[int, float] | None = None
        """The sample before the newest, where it is not long ago."""

    def take(self, time_us: int, closed: float) -> None:
        """A sample at a sensor time (us)."""
        since_us = time_us - self.newest_us
        known = self.closed is not None and 0 < since_us <= GAP_US
        self.before = (self.newest_us, self.closed or 0.0) if known else None
        self.rate_per_s = 0.0
        if self.before is not None:
            rate = (closed - self.before[1]) / since_us * 1e6
            self.rate_per_s = rate if abs(rate) >= STILL_PER_S else 0.0
        self.closed, self.newest_us = closed, time_us

    def falls_to_us(self, level: float) -> float | None:
        """When the opening clutch passes, or has passed, a level; None where it does not get there
        at its present rate."""
        if self.closed is None:
            return None
        if self.closed <= level:
            return float(self.newest_us)
        if self.rate_per_s >= 0.0:
            return None
        ahead_us = (level - self.closed) / self.rate_per_s * 1e6
        return self.newest_us + ahead_us if ahead_us <= AHEAD_US else None


class SleeveTrack(NamedTuple):
    """Samples of one sleeve, newest first, 1 ms apart: the ten of a frame, and before them eleven
    earlier ones where the frame before came 10 ms earlier."""

    newest_us: int
    samples_m: tuple[float, ...]

    @property
    def position_m(self) -> float:
        """The sleeve's newest position (m)."""
        return self.samples_m[0]

    def mean_m(self, before: int) -> float:
        """Mean of the newest `MEAN_SAMPLES` (0), or of those that came before (1, 2, ...)."""
        first = before * MEAN_SAMPLES
        return math.fsum(self.samples_m[first : first + MEAN_SAMPLES]) / MEAN_SAMPLES

    @property
    def outward_m_s(self) -> float:
        """How fast the sleeve moves away from neutral (m/s), by its two newest means."""
        return (abs(self.mean_m(0)) - abs(self.mean_m(1))) / (MEAN_SAMPLES * SAMPLE_US * US)

    @property
    def is_still(self) -> bool:
        """Whether the sleeve stands, as far as these samples show."""
        count = min(STILL_MEANS, len(self.samples_m) // MEAN_SAMPLES)
        means_m = [self.mean_m(before) for before in range(count)]
        return max(means_m) - min(means_m) < STILL_M

    def crossing_us(self, level_m: float, direction: int) -> float | None:
        """When the sleeve passed `level_m` toward `direction` within these samples; interpolated.

        None when it did not, or had before the oldest sample."""
        for i in range(len(self.samples_m) - 1):
            after, before = self.samples_m[i] * direction, self.samples_m[i + 1] * direction
            if before < level_m <= after:
                return self.newest_us - (i + (after - level_m) / (after - before)) * SAMPLE_US
        return None


class GearboxView:
    """The mechanical state as the sensors show it."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._stroke_m = sheet.sleeve.stroke_m
        self._clear_m = sheet.sleeve.to_contact_m - SHORT_M
        """Nearer to the middle than this a sleeve is clear of a gear's teeth."""
        self._rest_m = dict.fromkeys(Sleeve, 0.0)
        """Offset of each sensor: its reading in neutral (m)."""
        self.tracks: dict[Sleeve, SleeveTrack] = {}
        self._faulty = {"main": 0, "aux": 0}
        """`SensorFault` of the newest frames, a bit a sensor."""
        self.clutch = ClutchTrack()
        self._clutch_open_share = sheet.clutch.surely_open_share
        self._clutch_kiss_share = sheet.clutch.kiss_share
        self.supply_pa = math.inf
        """Absolute supply pressure; infinite before it was first seen."""
        self.brake_gauge_pa = 0.0
        """The brake's pressure as its sensor says, gauge; its offset is not taken out."""
        self.main_gear: MainGear | None = None
        """The main gear in mesh, NEUTRAL with both sleeves in the middle, None in between."""
        self.split: Split | None = None
        """The splitter step in mesh."""
        self.range_: Range | None = None
        """The range step in mesh."""

    @property
    def clutch_closed(self) -> float | None:
        """0 open .. 1 closed; None before it was first seen."""
        return self.clutch.closed

    @property
    def clutch_parted(self) -> bool:
        """Whether the clutch is measured so far open that its plates are surely apart."""
        return (self.clutch.closed or 0.0) <= self._clutch_open_share

    @property
    def clutch_carries(self) -> bool:
        """Whether the clutch is measured so far closed that its plates touch."""
        return (self.clutch.closed or 0.0) > self._clutch_kiss_share

    def sleeves_main(self, message: SleevesMain, time_us: int) -> None:
        """Takes the positions of the main box. Samples flagged faulty by their sensor are
        discarded."""
        self._faulty["main"] = message.sensor_fault
        self._take(Sleeve.FIRST_SECOND, time_us, message.sleeve_first_second_m)
        self._take(Sleeve.CRAWL_THIRD, time_us, message.sleeve_crawl_third_m)

    def sleeves_aux(self, message: SleevesAux, time_us: int) -> None:
        """Takes the positions of splitter and range."""
        self._faulty["aux"] = message.sensor_fault
        self._take(Sleeve.SPLITTER, time_us, message.sleeve_splitter_m)
        self._take(Sleeve.RANGE, time_us, message.sleeve_range_m)

    def _take(self, sleeve: Sleeve, time_us: int, samples_m: tuple[float, ...]) -> None:
        before = self.tracks.get(sleeve)
        if before is not None and time_us - before.newest_us == len(samples_m) * SAMPLE_US:
            # A late step takes two reads at once: what the first one showed is looked at, too.
            samples_m += before.samples_m[: len(samples_m) + 1]
        self.tracks[sleeve] = _new(SleeveTrack, (time_us, samples_m))
        position_m = samples_m[0]
        if abs(position_m) < RESTING_M:
            self._rest_m[sleeve] += REST_SHARE * (position_m - self._rest_m[sleeve])

    def engaged_us(self, sleeve: Sleeve, direction: int) -> int | None:
        """When a sleeve came within the last millimetre of its stroke; None where it did not within
        the newest samples."""
        level_m = self._stroke_m - ENGAGED_SHORT_M
        passed_us = self.tracks[sleeve].crossing_us(level_m, direction)
        return None if passed_us is None else round(passed_us)

    @property
    def complete(self) -> bool:
        """Whether all positions and the clutch have been received at least once, and no sensor
        reports itself out of range."""
        seen = len(self.tracks) == SLEEVE_COUNT and self.clutch_closed is not None
        return seen and not any(self._faulty.values())

    @property
    def oldest_us(self) -> int:
        """The oldest of the sleeves' newest sample times (us); 0 before any."""
        return min([track.newest_us for track in self.tracks.values()], default=0)

    def position_m(self, sleeve: Sleeve) -> float:
        """Where a sleeve is; KeyError before its first frame."""
        return self.tracks[sleeve].position_m

    def in_neutral(self, sleeve: Sleeve) -> bool:
        """Whether a sleeve stands in the middle."""
        return abs(self.position_m(sleeve)) < VIEW_NEUTRAL_M

    def rests(self, sleeve: Sleeve) -> bool:
        """Whether a sleeve stands, as far as the samples of a frame show."""
        samples_m = self.tracks[sleeve].samples_m
        return abs(samples_m[0] - samples_m[SAMPLES - 1]) < RESTS_M

    def side(self, sleeve: Sleeve) -> int:
        """-1 or +1 where the sleeve is in mesh, 0 elsewhere."""
        position = self.position_m(sleeve)
        if abs(position) < self._stroke_m - ENGAGED_SHORT_M:
            return 0
        return 1 if position > 0.0 else -1

    def work_out(self) -> None:
        """Which gears are in mesh, from the positions taken."""
        if len(self.tracks) < SLEEVE_COUNT:
            return
        if any(self._faulty.values()):
            self.main_gear = self.split = self.range_ = None
            return
        self.main_gear = self._main_gear()
        self.split = _SPLIT_AT[self.side(Sleeve.SPLITTER)]
        self.range_ = _RANGE_AT[self.side(Sleeve.RANGE)]

    def _main_gear(self) -> MainGear | None:
        if all(map(self.in_neutral, MAIN_SLEEVES)):
            return MainGear.NEUTRAL
        for sleeve in MAIN_SLEEVES:
            gear = _GEAR_AT.get((sleeve, self.side(sleeve)))
            if gear is not None:
                return gear
        return None

    @property
    def gear_number(self) -> int:
        """The gear in mesh: 1..14, 0 neutral, -1 between gears or not known."""
        return self.number_with(self.split)

    def number_with(self, split: Split | None) -> int:
        """The same, were the splitter in this step."""
        main, range_ = self.main_gear, self.range_
        if main is MainGear.NEUTRAL:
            return 0
        if main is None or split is None or range_ is None:
            return -1
        gear = DRIVE_GEAR_WITH.get((main, split, range_))
        return -1 if gear is None else gear.number

    @property
    def free_since_us(self) -> float:
        """Since when, in the newest samples of a free main box and a parted clutch, they have been
        so: as soon as a sleeve had left its gear's teeth."""
        return max(self._parted_since_us, *map(self._clear_since_us, MAIN_SLEEVES))

    def _clear_since_us(self, sleeve: Sleeve) -> float:
        """When a sleeve left a gear's teeth; its oldest sample's time where that was before."""
        track, rest_m, limit_m = self.tracks[sleeve], self._rest_m[sleeve], self._clear_m
        for level_m, direction in ((-limit_m - rest_m, -1), (rest_m - limit_m, 1)):
            left_us = track.crossing_us(level_m, direction)
            if left_us is not None:
                return left_us
        return track.newest_us - (len(track.samples_m) - 1) * SAMPLE_US

    @property
    def _parted_since_us(self) -> float:
        """The newest sample of the clutch, or the one before where it was parted already."""
        before = self.clutch.before
        if before is not None and before[1] <= self._clutch_open_share:
            return before[0]
        return self.clutch.newest_us

    @property
    def main_box_free(self) -> bool:
        """Whether no main sleeve is at a gear's teeth, where it rubs on them or is in mesh."""
        limit_m = self._clear_m
        return all(abs(self.position_m(s) - self._rest_m[s]) < limit_m for s in MAIN_SLEEVES)
