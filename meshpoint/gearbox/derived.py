"""Figures that follow from a data sheet alone: what one works out before the first shift."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from meshpoint.gearbox.gears import DRIVE_GEARS, MAIN_GEARS, DriveGear, Range, Split
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.gearbox.wheels import Mesh
from meshpoint.units import RPM


@dataclass(frozen=True)
class GearFigures:
    """One gear."""

    gear: DriveGear
    ratio: float
    """Input speed over propeller speed."""
    step: float | None
    """The next lower gear's ratio over this one's; None for the lowest."""


@dataclass(frozen=True)
class SheetFigures:
    """What the sheet comes to; SI."""

    gears: tuple[GearFigures, ...]
    """From the lowest gear to the highest."""
    spread: float
    """Highest ratio over lowest."""
    shared_factors: dict[str, int]
    """Wheel pairs whose tooth counts share a factor, so that a tooth does not meet every other."""
    pitch_rad: float
    gap_rad: float
    gap_m: float
    """The gap along the circle on which the dog teeth stand."""
    delay_slip_rad_s: float
    """Slip above which the sleeve's delay alone, within its limits, carries a tooth out of a gap
    whose middle was aimed at: b / (2 x delay limit). Infinite for a delay that does not vary."""
    inertia_kgm2: tuple[float, float]
    """At the layshaft in low and high split (thesis 4.13)."""
    braking_rad_s2: tuple[float, float]
    """Deceleration of the layshaft by the full brake in low and high split."""

    def to_json(self) -> dict[str, Any]:
        """In the units people use, by name."""
        low, high = (value / RPM for value in self.braking_rad_s2)
        slip_rpm = self.delay_slip_rad_s / RPM
        return {
            "steps": {figures.gear.name: figures.step for figures in self.gears},
            "spread": self.spread,
            "shared_factors": self.shared_factors,
            "dog_pitch_deg": math.degrees(self.pitch_rad),
            "gap_deg": math.degrees(self.gap_rad),
            "gap_mm": 1e3 * self.gap_m,
            "gap_by_luck": self.gap_rad / self.pitch_rad,
            "delay_slip_rpm": slip_rpm if math.isfinite(slip_rpm) else None,
            "layshaft_inertia_kgm2": dict(zip(("low", "high"), self.inertia_kgm2, strict=True)),
            "braking_rpm_s": {"low": low, "high": high},
        }


def sheet_figures(sheet: GearboxSheet) -> SheetFigures:
    """Works out the figures of a sheet."""
    dog, sleeve = sheet.dog, sheet.sleeve
    limit_s = sleeve.delay_limit_s
    inertia = (sheet.inertia_kgm2(Split.LOW), sheet.inertia_kgm2(Split.HIGH))
    gears = _gears(sheet)
    return SheetFigures(
        gears=gears,
        spread=gears[0].ratio / gears[-1].ratio,
        shared_factors=_shared_factors(sheet),
        pitch_rad=dog.pitch_rad,
        gap_rad=dog.backlash_rad,
        gap_m=dog.backlash_rad * dog.radius_m,
        delay_slip_rad_s=dog.backlash_rad / (2.0 * limit_s) if limit_s else math.inf,
        inertia_kgm2=inertia,
        braking_rad_s2=(
            sheet.brake.max_torque_nm / inertia[0],
            sheet.brake.max_torque_nm / inertia[1],
        ),
    )


def _gears(sheet: GearboxSheet) -> tuple[GearFigures, ...]:
    figures: list[GearFigures] = []
    for gear in sorted(DRIVE_GEARS.values(), key=lambda gear: -sheet.overall_ratio(gear)):
        ratio = sheet.overall_ratio(gear)
        figures.append(GearFigures(gear, ratio, figures[-1].ratio / ratio if figures else None))
    return tuple(figures)


def _shared_factors(sheet: GearboxSheet) -> dict[str, int]:
    """A locked pair, one wheel against itself, is none."""
    meshes: dict[str, Mesh] = {
        **{f"split {split.name.lower()}": sheet.split_mesh(split) for split in Split},
        **{f"main {gear.name.lower()}": sheet.main_mesh(gear) for gear in MAIN_GEARS},
        **{f"range {range_.name.lower()}": sheet.range_mesh(range_) for range_ in Range},
    }
    factors = {name: math.gcd(mesh.driving, mesh.driven) for name, mesh in meshes.items()}
    return {
        name: factor
        for name, factor in factors.items()
        if factor > 1 and meshes[name].driving != meshes[name].driven
    }
