"""Gearboxes of other data sheets than ours, and what is left of a sheet when it is withheld."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.wheels import Mesh, Wheel
from meshpoint.units import BAR, MS

STREAM: Final = 0x3139
RATIO_SHARE: Final = 0.04
"""A drawn ratio differs by at most so much from that of the sheet that it is drawn around."""
FACTORS: Final = 0.3
"""And torques, inertias and times of brake and clutch by so much."""


def draw_sheet(around: GearboxSheet, seed: int) -> GearboxSheet:
    """A gearbox of the same build with other wheels, brake, sleeves and clutch."""
    rng = np.random.Generator(np.random.PCG64([seed, STREAM]))

    def times(value: float, unit: float = 1.0) -> float:
        drawn = value / unit * float(np.exp(rng.uniform(-FACTORS, FACTORS)))
        return float(f"{drawn:.4g}") * unit

    def mesh(near: Mesh) -> Mesh:
        return near if near.driving == near.driven else _mesh(rng, near.ratio)

    splitter, main, wheels = around.splitter, around.main, around.wheels
    brake, sleeve, clutch = around.brake, around.sleeve, around.clutch
    delay_s = float(f"{rng.uniform(38.0, 55.0):.4g}") * MS
    supply_pa = float(f"{rng.uniform(7.5, 9.5):.4g}") * BAR
    return replace(
        around,
        name=f"drawn {seed}",
        splitter=replace(splitter, low=mesh(splitter.low), high=mesh(splitter.high)),
        main=replace(
            main,
            crawl=mesh(main.crawl),
            first=mesh(main.first),
            second=mesh(main.second),
            third=mesh(main.third),
        ),
        range_=replace(around.range_, low=mesh(around.range_.low)),
        wheels=replace(
            wheels,
            input_=_wheel(rng),
            layshaft=_wheel(rng),
            main=_wheel(rng),
            propeller=_wheel(rng),
        ),
        shafts=replace(
            around.shafts,
            input_inertia_kgm2=times(around.shafts.input_inertia_kgm2),
            friction_nms=times(around.shafts.friction_nms),
        ),
        brake=replace(
            brake,
            max_torque_nm=times(brake.max_torque_nm),
            valve_delay_s=times(brake.valve_delay_s, MS),
            time_constant_s=times(brake.time_constant_s, MS),
        ),
        air=replace(around.air, supply_gauge_pa=supply_pa),
        sleeve=replace(sleeve, delay_s=delay_s, valve_delay_s=times(sleeve.valve_delay_s, MS)),
        clutch=replace(
            clutch,
            open_delay_s=times(clutch.open_delay_s, MS),
            close_delay_s=times(clutch.close_delay_s, MS),
        ),
    )


def _wheel(rng: np.random.Generator) -> Wheel:
    return Wheel(int(rng.integers(36, 61)), float(f"{rng.uniform(42.0, 58.0):.3g}") * 0.01)


def _mesh(rng: np.random.Generator, near: float) -> Mesh:
    """A pair of wheels without a common factor, near a ratio: of 17 to 61 teeth, of up to 95 in a
    set of planets."""
    most = 61 if near > 0.28 else 95
    pairs = [
        (a, b)
        for a in range(17, most + 1)
        for b in range(17, most + 1)
        if math.gcd(a, b) == 1 and a != b and abs(a / b / near - 1.0) < RATIO_SHARE
    ]
    return Mesh(*pairs[int(rng.integers(len(pairs)))])


def withheld(like: GearboxSheet) -> GearboxSheet:
    """A sheet with what nobody can measure from the bus, dog teeth and strokes, and with values of
    no gearbox in place of all else that commissioning measures."""
    wheel = Wheel(60, 0.5)
    brake, sleeve, clutch = like.brake, like.sleeve, like.clutch
    return replace(
        like,
        name="withheld",
        splitter=replace(like.splitter, low=Mesh(20, 30), high=Mesh(30, 30)),
        main=replace(
            like.main,
            crawl=Mesh(10, 40),
            first=Mesh(20, 40),
            second=Mesh(30, 40),
            third=Mesh(40, 40),
        ),
        range_=replace(like.range_, low=Mesh(10, 30), high=Mesh(30, 30)),
        wheels=replace(like.wheels, input_=wheel, layshaft=wheel, main=wheel, propeller=wheel),
        shafts=replace(like.shafts, input_inertia_kgm2=0.12, friction_nms=0.1),
        brake=replace(
            brake, max_torque_nm=110.0, valve_delay_s=15.0 * MS, time_constant_s=40.0 * MS
        ),
        air=replace(like.air, supply_gauge_pa=8.0 * BAR),
        sleeve=replace(sleeve, delay_s=50.0 * MS, valve_delay_s=15.0 * MS),
        clutch=replace(
            clutch,
            open_delay_s=150.0 * MS,
            close_delay_s=250.0 * MS,
            kiss_share=0.4,
            kiss_tolerance=0.2,
        ),
    )
