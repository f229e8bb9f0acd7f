"""The plant's constants in SI, from the as-built data sheet and the as-built parameters."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.gearbox.sheet import BAR, RPM, GearboxSheet
from meshpoint.rig_sim.parts.drag import thickening
from meshpoint.rig_sim.parts.pneumatics import choked_rate
from meshpoint.rig_sim.parts.vehicle import GRAVITY_M_S2
from meshpoint.rig_sim.shared.angle_kernels import Floats
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.as_built import AsBuilt

CELSIUS: Final = 273.15
LITRE: Final = 1e-3
AIR_KG_M3: Final = 1.2
FADE_FROM_C: Final = 40.0


def constants(sheet: GearboxSheet, built: AsBuilt) -> Floats:
    """The vector p of the kernels."""
    p = np.zeros(at.CONSTANTS)
    p[at.STEP_US] = built["numerics.step_us"]
    for index, gear in enumerate(MAIN_GEARS):
        p[at.RATIO + index] = sheet.main_mesh(gear).ratio
    _shafts(p, sheet, built)
    _vehicle(p, built)
    _air(p, sheet, built)
    _disc(p, sheet, built)
    _engine(p, built)
    return p


def _shafts(p: Floats, sheet: GearboxSheet, built: AsBuilt) -> None:
    metres = built["vehicle.wheel_radius_m"] / built["vehicle.axle_ratio"]
    p[at.WHEEL_M] = metres
    p[at.INERTIA : at.INERTIA + at.BODIES] = (
        built["engine.inertia_kgm2"],
        sheet.shafts.input_inertia_kgm2,
        sheet.shafts.layshaft_inertia_kgm2,
        built["vehicle.main_inertia_kgm2"],
        built["vehicle.propeller_inertia_kgm2"],
    )
    p[at.VEHICLE_KGM2] = built["vehicle.mass_kg"] * metres**2
    p[at.STIFF_NM_RAD] = built["driveline.stiffness_nm_rad"]
    p[at.TWIST_NMS] = built["driveline.damping_nms"]
    if p[at.STIFF_NM_RAD] == 0.0:
        p[at.INERTIA + at.PROPELLER] += p[at.VEHICLE_KGM2]
    p[at.OIL_K] = built["oil.temperature_c"] + CELSIUS
    thicker = thickening(p[at.OIL_K], built["drag.thicker_per_k"])
    p[at.DRAG_INPUT_NMS] = built["drag.input_nms"] * thicker
    p[at.DRAG_NMS] = sheet.shafts.friction_nms * thicker
    p[at.DRAG_NM] = built["drag.constant_nm"] * thicker
    p[at.DRAG_MAIN_NMS] = built["drag.main_nms"] * thicker
    p[at.LASH_INPUT_RAD] = math.radians(built["lash.splitter_deg"]) / 2.0
    p[at.LASH_MAIN_RAD] = math.radians(built["lash.main_deg"]) / 2.0
    p[at.LASH_RATE] = 1e3 / built["lash.settle_ms"]
    p[at.GEAR_INERTIA] = built["lash.gear_inertia_kgm2"]
    p[at.GEAR_DRAG_NMS] = built["drag.gear_nms"]


def _vehicle(p: Floats, built: AsBuilt) -> None:
    weight_n = built["vehicle.mass_kg"] * GRAVITY_M_S2
    slope = math.atan(built["vehicle.slope_percent"] / 100.0)
    p[at.MASS_KG] = built["vehicle.mass_kg"]
    p[at.ROLLING_N] = weight_n * built["vehicle.rolling_resistance"] * math.cos(slope)
    p[at.GRADE_N] = weight_n * math.sin(slope)
    p[at.AIR_NS2_M2] = 0.5 * AIR_KG_M3 * built["vehicle.drag_area_m2"]


def _air(p: Floats, sheet: GearboxSheet, built: AsBuilt) -> None:
    volume_m3 = built["air.brake_volume_l"] * LITRE
    polytropic = built["air.polytropic"]
    p[at.BRAKE_MODEL] = built["air.brake_model"]
    p[at.BRAKE_RATE] = 1.0 / sheet.brake.time_constant_s
    p[at.FILL] = choked_rate(built["air.fill_m3_spa"], volume_m3, polytropic)
    p[at.EXHAUST] = choked_rate(built["air.exhaust_m3_spa"], volume_m3, polytropic)
    p[at.CRITICAL] = built["air.critical_ratio"]
    p[at.ATMOSPHERE_PA] = sheet.air.atmosphere_pa
    p[at.DROOP] = built["air.brake_volume_l"] / built["air.tank_l"]
    p[at.RECOVERY] = 1.0 / built["air.recovery_s"]
    p[at.TOUCH_PA] = built["air.touch_bar"] * BAR


def _disc(p: Floats, sheet: GearboxSheet, built: AsBuilt) -> None:
    p[at.BRAKE_GAIN] = sheet.brake_nm_per_pa
    p[at.FADE_PER_K] = built["disc.fade_per_k"]
    p[at.FADE_PER_RAD_S] = built["disc.fade_per_1000_rpm"] / (1000.0 * RPM)
    p[at.DISC_REFERENCE_K] = FADE_FROM_C + CELSIUS
    p[at.DISC_REFERENCE_RAD_S] = built["disc.reference_rpm"] * RPM
    p[at.HEAT_J_K] = built["disc.heat_j_k"]
    p[at.COOLING_W_K] = built["disc.cooling_w_k"]


def _engine(p: Floats, built: AsBuilt) -> None:
    p[at.ENGINE_LAG_RATE] = 1e3 / built["engine.lag_ms"]
    p[at.ENGINE_NM_S] = built["engine.rate_nm_s"]
    p[at.ENGINE_MAX_NM] = built["engine.most_nm"]
    p[at.ENGINE_MIN_NM] = built["engine.least_nm"]
    p[at.GOVERNOR_NMS] = built["engine.governor_nms"]
    p[at.IDLE_RAD_S] = built["engine.idle_rpm"] * RPM
    p[at.CLUTCH_NM] = built["clutch.capacity_nm"]
    p[at.KISS] = built["clutch.kiss"]
