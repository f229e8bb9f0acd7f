"""The truck rig alone: simulated seconds a wall second, beside SciPy and the thesis's sampled sine.

    rig     preset truck in gear, layshaft at 1,000 rpm, 40-tooth wheels on four shafts, both edges
            in their capture rings; stops at every 10 ms read, puts none into messages; warm
    scipy   `solve_ivp` (DOP853, rtol 1e-9) of the same right-hand side, compiled, with an event
            function for every channel
    sine    thesis 4.5: sin(n theta) of four shafts sampled at 1 MHz, threshold crossings,
            vectorised by numpy at constant speed
    steps   the same sample by sample, speed integrated on the way, as a simulation at 1 MHz has to;
            plain Python

Rounds alternate and medians are reported. Memory is the growth of the process over the run.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from gearbox import GearboxSheet, load_sheet
from rig_sim import truck_layout as at
from rig_sim.settings import Preset, RigSettings
from rig_sim.truck_motion import rates
from rig_sim.truck_world import TruckWorld

RPM = np.pi / 30.0
TEETH = 40
LAYSHAFT_RPM = 1000.0
FIXED = {"vehicle.slope_percent": 0.0, "clutch.kiss": 1.0}


def forty_teeth() -> GearboxSheet:
    """The sheet with 40 teeth on every sensor wheel."""
    sheet = load_sheet("thesis")
    wheels = sheet.wheels
    named = {
        name: replace(getattr(wheels, name), teeth=TEETH)
        for name in ("input_", "layshaft", "main", "propeller")
    }
    return replace(sheet, wheels=replace(wheels, **named))


def truck() -> TruckWorld:
    """In gear, clutch open, at 1,000 rpm."""
    sheet = forty_teeth()
    main_rpm = LAYSHAFT_RPM * sheet.main.first.ratio
    settings = RigSettings(
        preset=Preset.TRUCK, seed=1, main_speed_rpm=main_rpm,
        as_built=FIXED | {"vehicle.mass_kg": 80000.0, "vehicle.rolling_resistance": 0.0},
    )  # fmt: skip
    return TruckWorld(sheet, settings)


def rig(world: TruckWorld, seconds: float) -> None:
    """The world goes on, read by read."""
    until_us = world.next_read_us + round(seconds * 1e6)
    while world.next_read_us < until_us:
        world.run_to(world.next_read_us)


def scipy_peer(world: TruckWorld, seconds: float) -> None:
    """The same equations by SciPy, with events."""
    plant = world.plant
    p, g, slots = plant.p, plant.g, plant._slots
    rate, aux = np.zeros(at.STATES), np.zeros(at.AUX)

    def slope(_: float, y: Any) -> Any:
        rates(y, p, g, slots, rate, aux)
        return rate.copy()

    events: list[Callable[[float, Any], float]] = [
        lambda _, y, b=body, d=duty: np.sin(TEETH * (y[at.ANGLE + b] - np.pi * d / TEETH))
        for body in (at.INPUT, at.LAYSHAFT, at.MAIN, at.PROPELLER)
        for duty in (0.0, 0.5)
    ]
    pitch_s = 2.0 * np.pi / TEETH / (LAYSHAFT_RPM * RPM)
    solve_ivp(
        slope, (0.0, seconds), plant.y.copy(), "DOP853", rtol=1e-9, atol=1e-9, events=events,
        max_step=pitch_s / 4.0,
    )  # fmt: skip


def sine_peer(world: TruckWorld, seconds: float) -> None:
    """The thesis's route at 1 MHz, at constant speed."""
    t = np.arange(round(seconds * 1e6)) * 1e-6
    for body in (at.INPUT, at.LAYSHAFT, at.MAIN, at.PROPELLER):
        u = np.sin(TEETH * (float(world.plant.y[at.SPEED + body]) * t)) > 0.0
        np.flatnonzero(u[1:] != u[:-1])


def steps_peer(world: TruckWorld, seconds: float) -> None:
    """The thesis's route sample by sample: 4.13 by Euler at 1 us, four sines, four comparisons."""
    y, p = world.plant.y, world.plant.p
    omega = float(y[at.SPEED + at.LAYSHAFT])
    ratios = [float(y[at.SPEED + body]) / omega for body in range(at.INPUT, at.BODIES)]
    drag = float(p[at.DRAG_NMS] / (p[at.INERTIA + at.LAYSHAFT] + p[at.INERTIA + at.INPUT]))
    theta, was, stamps = 0.0, [False] * 4, 0
    for _ in range(round(seconds * 1e6)):
        omega -= drag * omega * 1e-6
        theta += omega * 1e-6
        for wheel, ratio in enumerate(ratios):
            above = math.sin(TEETH * ratio * theta) > 0.0
            if above is not was[wheel]:
                was[wheel] = above
                stamps += 1


def speed(run: Callable[[TruckWorld, float], None], world: TruckWorld, seconds: float) -> float:
    """Simulated seconds a second of this process's time."""
    begin = time.process_time()
    run(world, seconds)
    return seconds / (time.process_time() - begin)


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--hours", type=float, default=0.0, help="also a long run, for memory")
    namespace = parser.parse_args(argv)
    world = truck()
    rig(world, 0.2)
    scipy_peer(world, 0.001)
    found: dict[str, list[float]] = {"rig": [], "scipy": [], "sine": [], "steps": []}
    for _ in range(namespace.repeats):
        world = truck()
        found["rig"].append(speed(rig, world, 3.0))
        found["scipy"].append(speed(scipy_peer, world, 0.05))
        found["sine"].append(speed(sine_peer, world, 0.2))
        found["steps"].append(speed(steps_peer, world, 0.2))
    rates_ = {name: statistics.median(values) for name, values in found.items()}
    figures = {f"{name}_times_real_time": round(rate, 3) for name, rate in rates_.items()}
    figures["rig_over_scipy"] = round(rates_["rig"] / rates_["scipy"], 1)
    figures["rig_over_sine"] = round(rates_["rig"] / rates_["sine"], 1)
    figures["rig_over_steps"] = round(rates_["rig"] / rates_["steps"], 1)
    if namespace.hours:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        rig(truck(), namespace.hours * 3600.0)
        after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        figures["memory_mb"] = round(after / 1024, 1)
        figures["memory_growth_mb"] = round((after - before) / 1024, 2)
    if namespace.json:
        print(json.dumps(figures))
    else:
        print(
            f"rig alone: {figures['rig_times_real_time']} x real time; "
            f"{figures['rig_over_scipy']} x scipy solve_ivp with events, "
            f"{figures['rig_over_sine']} x the vectorised sine sampled at 1 MHz, "
            f"{figures['rig_over_steps']} x the same step by step"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
