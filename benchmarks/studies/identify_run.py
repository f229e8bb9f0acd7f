"""A job of study `identify`: one drawn gearbox, a log of its shifts, and what the log shows of it
beside what it is."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from meshpoint.bench.bench import plan_shifts
from meshpoint.campaigns.draw import LAYSHAFT_RPM, draw, upshifts
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import GearboxSheet, Split
from meshpoint.gearbox.gears import DRIVE_GEAR_WITH, DRIVE_GEARS, SIDE_OF, DogGear
from meshpoint.gearbox.wheels import Wheel
from meshpoint.identify.identified import Identified
from meshpoint.identify.identify import identify
from meshpoint.identify.log_reader import LogContent, LogReader
from meshpoint.identify.sleeve_fit import sleeve_fit
from meshpoint.identify.tooth_fit import ToothFit, wheel_figures
from meshpoint.kernels.records import Vector
from meshpoint.rig_sim.parts.drag import thickening
from meshpoint.rig_sim.parts.pneumatics import choked_rate, flow_share
from meshpoint.rig_sim.settings import Preset, Profile
from meshpoint.rig_sim.shared.engagement import VALVE_OF_DOG
from meshpoint.rig_sim.truck.as_built import AsBuilt, as_built_sheet, draw_as_built
from meshpoint.rig_sim.truck.constants import CELSIUS, FADE_FROM_C
from meshpoint.rig_sim.truck.delays import TruckDelays
from meshpoint.rig_sim.truck.edges import WheelAsMade
from meshpoint.rig_sim.truck.sleeve_valves import SleeveValves
from meshpoint.units import DEG, MS, RPM, US

SHIFTS_STREAM: Final = 0x1D
START_US: Final = 10_000_000
STEP_S: Final = 1e-5


class Reported(NamedTuple):
    """One figure of one gearbox."""

    name: str
    unit: str
    value: float | None
    low: float
    high: float
    sheet: float | None
    truth: float

    @property
    def covered(self) -> bool:
        """Whether the interval holds the truth."""
        return bool(self.low <= self.truth <= self.high)


class Gearbox(NamedTuple):
    """What the log of one gearbox reported."""

    reported: tuple[Reported, ...]
    teeth: tuple[tuple[str, int, int], ...]
    """Of each wheel: edges, and how many of their places lie in their own intervals."""
    held_out: tuple[tuple[str, str, float, float], ...]
    """Name, unit, and RMS error: identified, and by the data sheet."""


@dataclass(frozen=True)
class IdentifyRun:
    """The job."""

    sheet: GearboxSheet
    seed: int
    shifts: int
    profile: Profile

    def run(self) -> Gearbox:
        """Records, identifies and compares."""
        drawn = draw(
            self.seed, self.sheet, Preset.TRUCK, upshifts(), self.shifts + 1, {}, self.profile
        )
        rng = np.random.Generator(np.random.PCG64([self.seed, SHIFTS_STREAM]))
        pairs = _pairs(self.sheet)
        rounds = math.ceil((self.shifts + 1) / len(pairs))
        order = [pairs[k] for _ in range(rounds) for k in rng.permutation(len(pairs))]
        speeds = rng.uniform(*LAYSHAFT_RPM, self.shifts + 1) * RPM
        plan = tuple(
            plan_shifts(self.sheet, [pair], 1, float(speed))[0]
            for pair, speed in zip(order, speeds, strict=False)
        )
        drawn = replace(drawn, plan=plan)
        loop = ClosedLoop(self.sheet, ControllerSettings(), Preset.TRUCK, drawn, log=[])
        discs = []
        for _ in range(self.shifts):
            loop.shift()
            discs.append(loop.rig_truth.plant.y.disc_k)
        loop.prepare()
        reader = LogReader(self.sheet)
        for time_us, frame in loop.log or []:
            reader.take(START_US + time_us, frame)
        content = reader.finish()
        found = identify(content, self.sheet)
        built = draw_as_built(self.seed, drawn.as_built, self.profile)
        truth = _Truth(self.sheet, built, found, content, float(np.mean(discs)))
        return Gearbox(
            tuple(truth.reported()),
            tuple(truth.edges(name, fitted) for name, fitted in found.teeth.items()),
            tuple((one.name, one.unit, one.identified, one.by_sheet) for one in found.held_out),
        )


def _pairs(sheet: GearboxSheet) -> list[tuple[int, int]]:
    """Upshifts of the main box; of a splitter with dog teeth both steps, too."""
    pairs = list(upshifts())
    if sheet.has_dog_splitter:
        pairs += [
            (old.number, DRIVE_GEAR_WITH[old.main, Split(1 - old.split), old.range_].number)
            for old in DRIVE_GEARS.values()
        ]
    return pairs


class _Truth:
    """The figures as built, by the rig's own laws."""

    def __init__(
        self,
        sheet: GearboxSheet,
        built: AsBuilt,
        found: Identified,
        content: LogContent,
        disc_k: float,
    ) -> None:
        self._sheet, self._built, self._found = sheet, built, found
        self._real = as_built_sheet(sheet, built)
        self._content = content
        self._disc_k = disc_k
        delays = TruckDelays(np.random.Generator(np.random.PCG64(0)), self._real, built)
        self._valves = SleeveValves(delays, self._real, built)
        rng = np.random.Generator(np.random.PCG64(built.teeth_seed))
        self._wheels = {
            name: WheelAsMade(rng, wheel, built) for name, wheel in sheet.wheels.rows.items()
        }

    def reported(self) -> list[Reported]:
        """Every figure that has a truth. ValueError where one is printed that has none: its
        interval would be held against nothing."""
        truths = {**self._brake(), **self._sleeves(), **self._valves_ms(), **self._of_wheels()}
        truths["clutch kiss point"] = 100.0 * self._built["clutch.kiss"]
        for one in self._found.figures:
            if one.value is not None and one.name not in truths:
                raise ValueError(f"{one.name}: is printed, and the study knows no truth of it")
        return [
            Reported(
                one.name,
                one.unit,
                one.value,
                math.nan if one.low is None else one.low,
                math.nan if one.high is None else one.high,
                one.sheet,
                truths[one.name],
            )
            for one in self._found.figures
            if one.name in truths
        ]

    def _brake(self) -> dict[str, float]:
        sheet, real, built = self._sheet, self._real, self._built
        omega = self._found.omega_ref_rad_s
        warmer_k = self._disc_k - CELSIUS - FADE_FROM_C
        faster = built["disc.fade_per_1000_rpm"]
        by_speed = 1.0 + faster * (omega / RPM - built["disc.reference_rpm"]) / 1000.0
        share = (1.0 - built["disc.fade_per_k"] * warmer_k) * by_speed
        thicker = thickening(built["oil.temperature_c"] + CELSIUS, built["drag.thicker_per_k"])
        inertia = real.shafts.layshaft_inertia_kgm2 / sheet.shafts.layshaft_inertia_kgm2
        i2 = sheet.split_mesh(Split.HIGH).ratio ** -2
        viscous = real.shafts.friction_nms + built["drag.input_nms"] * i2
        volume, polytropic = built["air.brake_volume_l"] * 1e-3, built["air.polytropic"]
        rates = [
            choked_rate(built[f"air.{way}_m3_spa"], volume, polytropic)
            for way in ("fill", "exhaust")
        ]
        return {
            "brake torque": real.brake.max_torque_nm * share / inertia,
            "brake torque by speed": 100.0 * faster / by_speed,
            "brake valve on delay": real.brake.valve_delay_s / MS,
            "brake valve off delay": real.brake.valve_delay_s / MS,
            "brake filling time": self._filling_s(rates[0]) / MS,
            "brake emptying time": self._emptying_s(rates[1]) / MS,
            "brake touch pressure": built["air.touch_bar"],
            "drag": thicker * (built["drag.constant_nm"] + viscous * omega) / inertia,
            "inertia ratio": real.shafts.input_inertia_kgm2 / real.shafts.layshaft_inertia_kgm2,
            "open clutch drag": built["clutch.drag_nm"] / inertia,
        }

    def _filling_s(self, rate: float) -> float:
        air, critical = self._sheet.air, self._built["air.critical_ratio"]
        supply = air.supply_gauge_pa + air.atmosphere_pa
        pressure, steps = air.atmosphere_pa, 0
        while pressure - air.atmosphere_pa < (1.0 - math.exp(-1.0)) * air.supply_gauge_pa:
            pressure += STEP_S * rate * supply * flow_share(supply, pressure, critical)
            steps += 1
        return steps * STEP_S

    def _emptying_s(self, rate: float) -> float:
        air, critical = self._sheet.air, self._built["air.critical_ratio"]
        pressure, steps = air.supply_gauge_pa + air.atmosphere_pa, 0
        while pressure - air.atmosphere_pa > math.exp(-1.0) * air.supply_gauge_pa:
            pressure -= STEP_S * rate * pressure * flow_share(pressure, air.atmosphere_pa, critical)
            steps += 1
        return steps * STEP_S

    def _sleeves(self) -> dict[str, float]:
        """Means at the data sheet's supply pressure, after the rests that the log shows."""
        built, valves = self._built, self._valves
        fitted = sleeve_fit(self._content)
        if fitted is None:
            return {}
        supply_pa = self._sheet.air.supply_gauge_pa + self._sheet.air.atmosphere_pa
        found, variances = {}, []
        for gear in fitted.delays_s:
            late = np.array(self._stuck_s(gear))
            mean_s = valves.mean_s(VALVE_OF_DOG[gear], on=True)
            mean_s += valves.stroke_s(gear, supply_pa)
            found[f"sleeve delay {gear.name.lower()}"] = (mean_s + float(late.mean())) / MS
            variances += [float(late.var())] * late.size
        noise, limit = built["sleeve.noise_sd_ms"], built["sleeve.noise_limit_ms"]
        spread = _cut_sd(noise, limit) ** 2 + float(np.mean(variances)) / MS**2
        return found | {"sleeve delay spread": math.sqrt(spread)}

    def _valves_ms(self) -> dict[str, float]:
        """From a coil to its spool, without chance and without what a long rest adds."""
        return {
            f"sleeve valve {gear.name.lower()} {name} delay": self._valves.mean_s(
                VALVE_OF_DOG[gear], on
            )
            / MS
            for gear in self._sheet.dog_gears
            for on, name in ((True, "on"), (False, "off"))
        }

    def _stuck_s(self, gear: DogGear) -> list[float]:
        """What the rest of its valve before each stroke into a gear added; the log shows the
        sleeve's, which is taken for it."""
        most_s, tau_s = self._built["sleeve.stiction_ms"] * MS, self._built["sleeve.stiction_s"]
        sleeve = SIDE_OF[gear].sleeve
        fired: list[tuple[DogGear, int]] = [
            (at, one.fired_us) for at, one in self._content.contacts if SIDE_OF[at].sleeve is sleeve
        ]
        before_us = [None, *(fired_us for _, fired_us in fired)]
        rests = [
            None if before is None else (fired_us - before) * US
            for before, (at, fired_us) in zip(before_us, fired, strict=False)
            if at is gear
        ]
        return [most_s if rest is None else -most_s * math.expm1(-rest / tau_s) for rest in rests]

    def _of_wheels(self) -> dict[str, float]:
        found = {}
        for name in ("layshaft", "main"):
            wheel: Wheel = getattr(self._sheet.wheels, name)
            figures = wheel_figures(self._errors(name), wheel.duty_share)
            found[f"{name} wheel duty"] = 100.0 * figures.duty_share
            found[f"{name} wheel eccentricity"] = figures.eccentricity_rad / DEG
            found[f"{name} wheel pitch error RMS"] = figures.pitch_rms_rad / DEG
        return found

    def _errors(self, name: str) -> Vector:
        wheel: Wheel = getattr(self._sheet.wheels, name)
        rise, fall = self._wheels[name].edges_rad()
        pitches = wheel.pitch_rad * np.arange(wheel.teeth)
        errors = np.empty(2 * wheel.teeth)
        errors[::2] = rise - pitches
        errors[1::2] = fall - pitches - wheel.duty_share * wheel.pitch_rad
        return np.asarray(errors - errors.mean())

    def edges(self, name: str, fitted: ToothFit) -> tuple[str, int, int]:
        """Edges of a wheel, and how many lie in their intervals; which tooth is the first one is
        found by the best fit, since nobody numbers them."""
        true = self._errors(name)
        turned = min(
            (np.roll(true, shift) for shift in range(0, true.size, 2)),
            key=lambda errors: float(np.sum((fitted.error_rad - errors) ** 2)),
        )
        inside = np.abs(fitted.error_rad - turned) <= fitted.half_rad
        return name, int(inside.size), int(inside.sum())


def _cut_sd(sd: float, limit: float) -> float:
    """Standard deviation of a normal law that is cut at +- limit."""
    if sd <= 0.0 or limit <= 0.0:
        return 0.0
    a = limit / sd
    density = math.exp(-0.5 * a * a) / math.sqrt(2.0 * math.pi)
    return sd * math.sqrt(1.0 - 2.0 * a * density / math.erf(a / math.sqrt(2.0)))
