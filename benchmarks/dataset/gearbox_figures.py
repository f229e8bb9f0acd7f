"""gearbox.json: the data sheet's figures that a prediction needs, in SI units."""

from __future__ import annotations

import dataclasses
from typing import Any

from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.units import DEG


def gearbox_figures(sheet: GearboxSheet, settings: ControllerSettings) -> dict[str, Any]:
    """What the controller knows of every gearbox of the set: none of it was drawn."""
    return {
        "sheet": sheet.name,
        "sheet_sha256": sheet.sha256,
        "wheel_teeth": {name: wheel.teeth for name, wheel in sheet.wheels.rows.items()},
        "dog_teeth": sheet.dog.teeth,
        "pitch_deg": sheet.dog.pitch_rad / DEG,
        "half_gap_deg": sheet.dog.backlash_rad / DEG / 2,
        "friction_nms": sheet.shafts.friction_nms,
        "brake": {
            "valve_delay_s": sheet.brake.valve_delay_s,
            "time_constant_s": sheet.brake.time_constant_s,
            "torque_nm_per_pa": sheet.brake_nm_per_pa,
            "supply_gauge_pa": sheet.air.supply_gauge_pa,
        },
        "sleeve": {"delay_s": sheet.sleeve.delay_s, "delay_sd_s": sheet.sleeve.delay_sd_s},
        "gears": {
            str(number): {
                "main": gear.main.name.lower(),
                "splitter_ratio": sheet.split_mesh(gear.split).ratio,
                "gear_ratio": sheet.main_mesh(gear.main).ratio,
                "range_ratio": sheet.range_mesh(gear.range_).ratio,
                "inertia_kgm2": sheet.inertia_kgm2(gear.split),
            }
            for number, gear in DRIVE_GEARS.items()
        },
        "thesis_filter": dataclasses.asdict(settings.thesis_filter),
        "cruise_filter": {
            "acceleration_rad_s2": settings.cruise_filter.acceleration_rad_s2,
            "edge_time_s": settings.cruise_filter.edge_time_us * 1e-6,
        },
    }
