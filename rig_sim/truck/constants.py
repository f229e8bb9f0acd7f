"""The plant's parameters in SI, from the as-built data sheet and the as-built parameters."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from meshpoint.gearbox.gears import SIDE_OF
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.parts.disturbance import SAMPLE_S
from meshpoint.rig_sim.parts.drag import thickening
from meshpoint.rig_sim.parts.pneumatics import choked_rate
from meshpoint.rig_sim.parts.vehicle import GRAVITY_M_S2
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.as_built import AsBuilt
from meshpoint.rig_sim.truck.layout import PlantParameters
from meshpoint.units import BAR, RPM, TURN

CELSIUS: Final = 273.15
LITRE: Final = 1e-3
AIR_KG_M3: Final = 1.2
FADE_FROM_C: Final = 40.0
JUDDER_STREAM: Final = 0x10D
SHAKEN: Final = ("engine", "input", "layshaft", "main", "propeller", "road")
"""The sources of chance, in the order of `disturbance`."""


def load_parameters(p: PlantParameters, sheet: GearboxSheet, built: AsBuilt) -> None:
    """Fill in what the kernels take as built."""
    p.step_us = built["numerics.step_us"]
    p.dogs = len(sheet.dog_gears)
    p.pitch_rad[: p.dogs] = [
        sheet.teeth_of(SIDE_OF[gear].sleeve).pitch_rad for gear in sheet.dog_gears
    ]
    p.oil_k = built["oil.temperature_c"] + CELSIUS
    p.ratio[: p.dogs] = [sheet.dog_mesh(gear).ratio for gear in sheet.dog_gears]
    _load_shafts(p, sheet, built)
    _load_vehicle(p, built)
    _load_air(p, sheet, built)
    _load_brake(p, sheet, built)
    _load_engine(p, built)
    _load_disturbance(p, built)
    lag_ms = built["pressure.lag_ms"]
    p.feeling_rate = 1e3 / lag_ms if lag_ms > 0.0 else 0.0


def _load_shafts(p: PlantParameters, sheet: GearboxSheet, built: AsBuilt) -> None:
    p.inertia_kgm2[:] = (
        built["engine.inertia_kgm2"],
        sheet.shafts.input_inertia_kgm2,
        sheet.shafts.layshaft_inertia_kgm2,
        built["vehicle.main_inertia_kgm2"],
        built["vehicle.propeller_inertia_kgm2"],
    )
    thicker = thickening(p.oil_k, built["drag.thicker_per_k"])
    p.drag_input_nms = built["drag.input_nms"] * thicker
    p.drag_nms = sheet.shafts.friction_nms * thicker
    p.drag_nm = built["drag.constant_nm"] * thicker
    p.drag_main_nms = built["drag.main_nms"] * thicker
    p.drag_propeller_nm = built["drag.propeller_nm"] * thicker
    p.input_lash.half_rad = math.radians(built["lash.splitter_deg"]) / 2.0
    p.main_lash.half_rad = math.radians(built["lash.main_deg"]) / 2.0
    if sheet.has_dog_splitter:  # there the gear has it, as in the main box
        p.split_lash.half_rad, p.input_lash.half_rad = p.input_lash.half_rad, 0.0
    p.split_lash.rate = p.input_lash.rate = p.main_lash.rate = 1e3 / built["lash.settle_ms"]
    p.gear_inertia_kgm2 = built["lash.gear_inertia_kgm2"]
    p.gear_drag_nms = built["drag.gear_nms"]


def _load_vehicle(p: PlantParameters, built: AsBuilt) -> None:
    road, twisting = p.road, p.twisting
    weight_n = built["vehicle.mass_kg"] * GRAVITY_M_S2
    slope = math.atan(built["vehicle.slope_percent"] / 100.0)
    road.wheel_m = built["vehicle.wheel_radius_m"] / built["vehicle.axle_ratio"]
    road.rolling_n = weight_n * built["vehicle.rolling_resistance"] * math.cos(slope)
    road.grade_n = weight_n * math.sin(slope)
    road.air_ns2_m2 = 0.5 * AIR_KG_M3 * built["vehicle.drag_area_m2"]
    twisting.vehicle_kgm2 = built["vehicle.mass_kg"] * road.wheel_m**2
    twisting.wheels_kgm2 = built["driveline.wheels_kgm2"]
    twisting.stiff_nm_rad = built["driveline.stiffness_nm_rad"]
    twisting.damping_nms = built["driveline.damping_nms"]
    if twisting.stiff_nm_rad == 0.0:
        p.inertia_kgm2[at.PROPELLER] += twisting.wheels_kgm2 + twisting.vehicle_kgm2
        return
    twisting.half_lash_rad = math.radians(built["driveline.backlash_deg"]) / 2.0
    if built["driveline.tyre_nm_rad"] == 0.0 or twisting.wheels_kgm2 == 0.0:
        twisting.wheels_kgm2 += twisting.vehicle_kgm2
        return
    twisting.tyre_nm_rad = built["driveline.tyre_nm_rad"]
    twisting.tyre_nms = built["driveline.tyre_nms"]
    twisting.relaxation_m = built["driveline.tyre_relaxation_m"]


def _load_air(p: PlantParameters, sheet: GearboxSheet, built: AsBuilt) -> None:
    air = p.air
    volume_m3 = built["air.brake_volume_l"] * LITRE
    polytropic = built["air.polytropic"]
    air.model = built["air.brake_model"]
    air.rate = 1.0 / sheet.brake.time_constant_s
    air.fill = choked_rate(built["air.fill_m3_spa"], volume_m3, polytropic)
    air.exhaust = choked_rate(built["air.exhaust_m3_spa"], volume_m3, polytropic)
    air.critical = built["air.critical_ratio"]
    air.atmosphere_pa = sheet.air.atmosphere_pa
    air.droop = built["air.brake_volume_l"] / built["air.tank_l"]
    air.recovery = 1.0 / built["air.recovery_s"]


def _load_brake(p: PlantParameters, sheet: GearboxSheet, built: AsBuilt) -> None:
    brake = p.brake
    brake.gain_nm_pa = sheet.brake_nm_per_pa
    brake.touch_pa = built["air.touch_bar"] * BAR
    brake.fade_per_k = built["disc.fade_per_k"]
    brake.fade_per_rad_s = built["disc.fade_per_1000_rpm"] / (1000.0 * RPM)
    brake.reference_k = FADE_FROM_C + CELSIUS
    brake.reference_rad_s = built["disc.reference_rpm"] * RPM
    brake.heat_j_k = built["disc.heat_j_k"]
    brake.cooling_w_k = built["disc.cooling_w_k"]


def _load_engine(p: PlantParameters, built: AsBuilt) -> None:
    engine = p.engine
    engine.lag_rate = 1e3 / built["engine.lag_ms"]
    engine.limit_nm_s = built["engine.rate_nm_s"]
    engine.most_nm = built["engine.most_nm"]
    engine.least_nm = built["engine.least_nm"]
    engine.governor_nms = built["engine.governor_nms"]
    engine.idle_rad_s = built["engine.idle_rpm"] * RPM
    p.plates.most_nm = built["clutch.capacity_nm"]
    p.plates.kiss = built["clutch.kiss"]


def _load_disturbance(p: PlantParameters, built: AsBuilt) -> None:
    found = p.disturbance
    for k, name in enumerate(SHAKEN):
        tau_ms = built["disturbance.road_ms" if name == "road" else "disturbance.correlation_ms"]
        found.keep[k] = math.exp(-SAMPLE_S * 1e3 / tau_ms)
        # half of the variance of z is that of each of the two tables
        spread = math.sqrt(0.5 * (1.0 - found.keep[k] ** 2))
        found.spread_nm[k] = built[f"disturbance.{name}_nm"] * spread
    found.first_order = built["engine.first_order"]
    found.main_order = built["engine.main_order"]
    found.clutch_drag_nm = built["clutch.drag_nm"] if p.plates.kiss < 1.0 else 0.0
    found.judder_once = built["disc.judder_once"]
    found.judder_twice = built["disc.judder_twice"]
    rng = np.random.Generator(np.random.PCG64([built.teeth_seed, JUDDER_STREAM]))
    found.once_rad, found.twice_rad = rng.uniform(0.0, TURN, 2).tolist()
    amounts = (*found.spread_nm, found.first_order, found.main_order, found.clutch_drag_nm)
    amounts += (found.judder_once, found.judder_twice, built["hall.load_runout_mm"])
    found.is_on = int(any(amount > 0.0 for amount in amounts))
