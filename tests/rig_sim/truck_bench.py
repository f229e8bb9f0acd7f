"""A truck gearbox on its own: chosen as-built values, no frames, trials one after the other."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from meshpoint.gearbox.gears import MainGear
from meshpoint.gearbox.sheet import GearboxSheet, load_sheet
from meshpoint.rig_sim.settings import Preset, Profile, RigSettings
from meshpoint.rig_sim.shared.valve_drivers import Valve
from meshpoint.rig_sim.truck.as_built import linear
from meshpoint.rig_sim.truck.world import TruckWorld

SHEET: Final = load_sheet("thesis")
GEAR: Final = MainGear.SECOND
TRIALS: Final = int(os.environ.get("MESHPOINT_TRIALS", "500"))
"""Random trials a figure; MESHPOINT_TRIALS=20000 for the full campaign."""


def world(
    fixed: Mapping[str, float] | None = None,
    sheet: GearboxSheet = SHEET,
    seed: int = 1,
    **settings: Any,
) -> TruckWorld:
    """A truck; what is not fixed is drawn, from the profile clean where none is named."""
    settings = {"profile": Profile.CLEAN} | settings
    chosen = RigSettings(preset=Preset.TRUCK, seed=seed, as_built=fixed or {}, **settings)
    return TruckWorld(sheet, chosen)


def run(truck: TruckWorld, until_us: int) -> None:
    """Go on, reads included, without looking at them."""
    while truck.run_to(until_us):
        pass


def switch(truck: TruckWorld, valve: Valve, on: bool, at_us: float) -> None:
    """A valve is driven, or not, from this time on."""
    truck._at(at_us, lambda: truck.switch(valve, on))


def limit_sheet(teeth: int = 24, backlash_share: float = 0.2) -> GearboxSheet:
    """The data sheet of the limits: z = 24, r = 75 mm, J_eq = 1 at the gear, sleeve 0.25 m/s, no
    friction of the shafts."""
    ratio = SHEET.main_mesh(GEAR).ratio
    return replace(
        SHEET,
        dog=replace(SHEET.dog, teeth=teeth, backlash_share=backlash_share, radius_m=0.075),
        shafts=replace(
            SHEET.shafts,
            layshaft_inertia_kgm2=ratio**2 - 1e-3,
            input_inertia_kgm2=1e-3 * SHEET.splitter.high.ratio**2,
            friction_nms=0.0,
        ),
        sleeve=replace(SHEET.sleeve, speed_m_s=0.25, delay_sd_s=0.0),
    )


def limit_values(**changed: float) -> dict[str, float]:
    """Everything off but what is named, as `dog__face_friction=0.1`; force 1 kN on 3 kg."""
    values = linear() | {
        "sleeve.noise_sd_ms": 0.0,
        "sleeve.force_n": 1000.0,
        "sleeve.friction_n": 0.0,
        "sleeve.mass_kg": 3.0,
        "dog.static_factor": 1.0,
    }
    return values | {name.replace("__", "."): value for name, value in changed.items()}


def share(hits: int, trials: int, expected: float) -> float:
    """How many standard errors a counted share is from the expected one."""
    error = math.sqrt(max(expected * (1.0 - expected), 1.0 / trials) / trials)
    return (hits / trials - expected) / error
