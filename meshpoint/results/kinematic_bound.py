"""The least time that physics leaves to an upshift of the main box: the kinematic bound.

Plates parted as fast as the clutch's actuator goes, then the brake's full torque, there at once,
over the whole fall of the layshaft's speed, then the sleeve's way from contact to its stroke at the
sheet's speed. No valve, no air, no sensor, no bus takes any time in it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS

AsBuiltGroups = Mapping[str, Mapping[str, float]]


def kinematic_bound_ms(
    sheet: GearboxSheet, as_built: AsBuiltGroups, gears: tuple[int, int], main_rad_s: float
) -> float | None:
    """The bound (ms) of a shift between two drive gears at this speed of the main shaft (rad/s).

    as_built: the rig's parameters by group, empty in the preset thesis, whose clutch takes no time.
    None where the bound says nothing: downshifts, and shifts that move splitter or range."""
    old, new = DRIVE_GEARS[gears[0]], DRIVE_GEARS[gears[1]]
    before = main_rad_s / sheet.main_mesh(old.main).ratio
    after = main_rad_s / sheet.main_mesh(new.main).ratio
    if (old.split, old.range_) != (new.split, new.range_) or after >= before:
        return None
    factors = as_built.get("sheet", {})
    ratio = sheet.split_mesh(new.split).ratio
    shafts = sheet.shafts
    inertia = shafts.layshaft_inertia_kgm2 * factors.get("layshaft_inertia_factor", 1.0)
    inertia += (
        shafts.input_inertia_kgm2 * factors.get("input_inertia_factor", 1.0) / (ratio * ratio)
    )
    gauge_pa = sheet.air.supply_gauge_pa
    supply_pa = gauge_pa + 1e5 * as_built.get("air", {}).get("supply_offset_bar", 0.0)
    full_nm = sheet.brake.max_torque_nm * factors.get("brake_torque_factor", 1.0)
    full_nm *= supply_pa / gauge_pa
    full_nm += as_built.get("drag", {}).get("constant_nm", 0.0)
    rate_nms = shafts.friction_nms * factors.get("friction_factor", 1.0)
    braking_s = inertia * (before - after) / full_nm
    if rate_nms > 0.0:
        braking_s = (inertia / rate_nms) * math.log(
            (full_nm + rate_nms * before) / (full_nm + rate_nms * after)
        )
    parting_s = 0.0
    if "clutch" in as_built:
        opening_s = sheet.clutch.open_delay_s * factors.get("clutch_open_factor", 1.0)
        parting_s = opening_s * max(0.0, 1.0 - as_built["clutch"]["kiss"])
    sleeve = sheet.sleeve
    entry_s = (sleeve.stroke_m - sleeve.to_contact_m) / sleeve.speed_m_s
    return 1e3 * (parting_s + braking_s + entry_s)
