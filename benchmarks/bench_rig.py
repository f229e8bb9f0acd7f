"""The truck rig alone: simulated seconds a second of processor time, beside SciPy and sampling.

    rig     preset truck, profile clean, in gear, layshaft at 1,000 rpm, 40-tooth wheels on four
            shafts, both edges in their capture rings; stops at every 10 ms read, puts none into
            messages; warm
    reads   the same, and reads the eight edge channels every 10 ms
    scipy   `solve_ivp` (DOP853, rtol 1e-9) of the same right-hand side, compiled, with an event
            function for every channel
    analog  thesis 4.5 for the same gearbox: the same equations and method, compiled, in steps of
            1 us, and after each the sine of every wheel against the threshold
    sine    of that the sensors alone, at a speed that never changes: sin(n theta) of four shafts at
            1 MHz, vectorised by numpy. No gearbox is simulated
    steps   sensors and one shaft with drag sample by sample, in plain Python

And for each profile the milliseconds a simulated second: driving, clutch closed, under the load of
the road; and idling along as in `rig`, where with backlash the unloaded teeth rattle.

Rounds alternate; of each the best round counts, as others may use the machine. --hours runs on, in
a process of its own, and reports its memory and whether an hour takes the same time at the end.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numba
import numpy as np

from meshpoint.gearbox import GearboxSheet, load_sheet
from meshpoint.gearbox.wheels import Wheels
from meshpoint.kernels.jit import BARE
from meshpoint.kernels.structures import RecordArray
from meshpoint.rig_sim.settings import Preset, Profile, RigSettings
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.motion import rates
from meshpoint.rig_sim.truck.step import step
from meshpoint.rig_sim.truck.world import TruckWorld
from meshpoint.units import RPM

TEETH = 40
LAYSHAFT_RPM = 1000.0
FIXED = {"vehicle.slope_percent": 0.0, "clutch.kiss": 1.0}


def with_teeth(teeth: int) -> GearboxSheet:
    """The sheet with this many teeth on every sensor wheel."""
    sheet = load_sheet("thesis")
    wheels = (replace(wheel, teeth=teeth) for wheel in sheet.wheels.rows.values())
    return replace(sheet, wheels=Wheels(*wheels))


def truck(teeth: int = TEETH, profile: Profile = Profile.CLEAN) -> TruckWorld:
    """In gear, clutch open, at 1,000 rpm."""
    sheet = with_teeth(teeth)
    main_rpm = LAYSHAFT_RPM * sheet.main.first.ratio
    settings = RigSettings(
        preset=Preset.TRUCK, seed=1, main_speed_rpm=main_rpm, profile=profile,
        as_built=FIXED | {"vehicle.mass_kg": 80000.0, "vehicle.rolling_resistance": 0.0},
    )  # fmt: skip
    return TruckWorld(sheet, settings)


def rig(world: TruckWorld, seconds: float) -> None:
    """The world goes on, read by read."""
    until_us = world.next_read_us + round(seconds * 1e6)
    while world.next_read_us < until_us:
        world.run_to(world.next_read_us)


def loaded(profile: Profile) -> TruckWorld:
    """In gear, clutch closed, at 1,000 rpm, the driver carrying the road's load."""
    sheet = with_teeth(TEETH)
    speed_rpm = LAYSHAFT_RPM * sheet.main.first.ratio
    fixed = {"vehicle.slope_percent": 0.5, "oil.temperature_c": 80.0}
    return TruckWorld(
        sheet, RigSettings(seed=1, main_speed_rpm=speed_rpm, profile=profile, as_built=fixed)
    )


def drive(world: TruckWorld, seconds: float) -> None:
    """The world goes on, read by read, its clutch kept closed."""
    until_us = world.next_read_us + round(seconds * 1e6)
    while (now_us := world.next_read_us) < until_us:
        world.run_to(now_us)
        world.command_clutch(True, now_us)


def reads(world: TruckWorld, seconds: float) -> None:
    """The same, with the edges read."""
    until_us = world.next_read_us + round(seconds * 1e6)
    while (now_us := world.next_read_us) < until_us:
        world.run_to(now_us)
        world.edge_reads(now_us)


def scipy_peer(world: TruckWorld, seconds: float) -> None:
    """The same equations by SciPy, with events."""
    from scipy.integrate import solve_ivp

    memory = RecordArray(world.plant.rig)
    angle = at.RigState.angle_rad.offset // 8  # type: ignore[attr-defined]

    def slope(_: float, y: Any) -> Any:
        rate = np.empty_like(y)
        _slope(memory.array, y, rate)
        return rate

    events: list[Callable[[float, Any], float]] = [
        lambda _, y, b=body, d=duty: np.sin(TEETH * (y[angle + b] - np.pi * d / TEETH))
        for body in (at.INPUT, at.LAYSHAFT, at.MAIN, at.PROPELLER)
        for duty in (0.0, 0.5)
    ]
    pitch_s = 2.0 * np.pi / TEETH / (LAYSHAFT_RPM * RPM)
    solve_ivp(
        slope, (0.0, seconds), world.plant.y.vector.copy(), "DOP853", rtol=1e-9, atol=1e-9,
        events=events, max_step=pitch_s / 4.0,
    )  # fmt: skip


@numba.njit(**BARE)
def _slope(rigs: Any, y: Any, rate: Any) -> None:
    rig = rigs[0]
    for i in range(len(y)):
        rig.y.vector[i] = y[i]
    rates(rig.y, rig.ahead, rig)
    for i in range(len(y)):
        rate[i] = rig.ahead.vector[i]


@numba.njit(**BARE)
def _sampled(samples: int, rigs: Any, above: Any) -> int:
    rig = rigs[0]
    y, after = rig.y.vector, rig.after.vector
    stamps = 0
    for _ in range(samples):
        rates(rig.y, rig.stages[0], rig)
        step(rig, 1e-6)
        for i in range(len(y)):
            y[i] = after[i]
        for wheel in range(4):
            now = math.sin(TEETH * rig.y.angle_rad[at.INPUT + wheel]) > 0.0
            if now != above[wheel]:
                above[wheel] = now
                stamps += 1
    return stamps


def analog_peer(world: TruckWorld, seconds: float) -> None:
    """The thesis's route for the same gearbox."""
    above = np.zeros(4, dtype=np.bool_)
    _sampled(round(seconds * 1e6), RecordArray(world.plant.rig).array, above)


def sine_peer(world: TruckWorld, seconds: float) -> None:
    """The thesis's route at 1 MHz, at constant speed."""
    t = np.arange(round(seconds * 1e6)) * 1e-6
    for body in (at.INPUT, at.LAYSHAFT, at.MAIN, at.PROPELLER):
        u = np.sin(TEETH * (world.plant.y.speed_rad_s[body] * t)) > 0.0
        np.flatnonzero(u[1:] != u[:-1])


def steps_peer(world: TruckWorld, seconds: float) -> None:
    """The thesis's route sample by sample: 4.13 by Euler at 1 us, four sines, four comparisons."""
    speeds, p = world.plant.y.speed_rad_s, world.plant.p
    omega = speeds[at.LAYSHAFT]
    ratios = [speeds[body] / omega for body in range(at.INPUT, at.BODIES)]
    drag = p.drag_nms / (p.inertia_kgm2[at.LAYSHAFT] + p.inertia_kgm2[at.INPUT])
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


def long_run(hours: float) -> dict[str, float]:
    """Memory and time of a long run, in this process."""
    world = truck()
    rig(world, 60.0)
    early_mb, times = resident_mb(), []
    part_s = hours * 360.0
    for _ in range(10):
        begin = time.process_time()
        rig(world, part_s)
        times.append(time.process_time() - begin)
    return {
        "hours": hours,
        "memory_mb": round(resident_mb(), 1),
        "memory_growth_mb": round(resident_mb() - early_mb, 2),
        "last_tenth_over_first": round(times[-1] / times[0], 2),
    }


def resident_mb() -> float:
    """What this process occupies now."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


PEERS: dict[str, tuple[Callable[[TruckWorld, float], None], float]] = {
    "rig": (rig, 6.0),
    "reads": (reads, 3.0),
    "scipy": (scipy_peer, 0.05),
    "analog": (analog_peer, 0.2),
    "sine": (sine_peer, 0.2),
    "steps": (steps_peer, 0.2),
}
"""What is timed, and the simulated seconds of a round."""


def figures_of(repeats: int) -> dict[str, float]:
    """All rates and ratios of one run."""
    for run, _ in PEERS.values():
        run(truck(), 0.002)
    found: dict[str, list[float]] = {name: [] for name in PEERS}
    by_teeth: dict[int, list[float]] = {teeth: [] for teeth in (20, 40, 80)}
    by_profile: dict[str, list[float]] = {}
    for _ in range(repeats):
        for profile in Profile:
            for name, run, world in (
                ("driving", drive, loaded(profile)),
                ("rattling", rig, truck(TEETH, profile)),
            ):
                run(world, 0.5)
                cost = 1e3 / speed(run, world, 3.0)
                by_profile.setdefault(f"ms_a_simulated_s_{name}_{profile}", []).append(cost)
        for name, (run, seconds) in PEERS.items():
            found[name].append(speed(run, truck(), seconds))
        for teeth, values in by_teeth.items():
            values.append(1e3 / speed(rig, truck(teeth), 3.0))
    best = {name: max(values) for name, values in found.items()}
    figures = {f"{name}_times_real_time": round(rate, 3) for name, rate in best.items()}
    for name in ("scipy", "analog", "sine", "steps"):
        figures[f"rig_over_{name}"] = round(best["rig"] / best[name], 1)
    for teeth, values in by_teeth.items():
        figures[f"ms_a_simulated_s_{teeth}_teeth"] = round(min(values), 3)
    figures |= {name: round(min(values), 3) for name, values in by_profile.items()}
    return figures


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--hours", type=float, default=10.0, help="of the long run, 0 for none")
    parser.add_argument("--only-long-run", action="store_true", help=argparse.SUPPRESS)
    namespace = parser.parse_args(argv)
    if namespace.only_long_run:
        print(json.dumps(long_run(namespace.hours)))
        return 0
    figures = figures_of(namespace.repeats)
    if namespace.hours:
        command = [sys.executable, "-m", "benchmarks.bench_rig", "--only-long-run"]
        command += ["--hours", str(namespace.hours)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603
        figures |= json.loads(done.stdout)
    if namespace.json:
        print(json.dumps(figures))
        return 0
    print(
        f"rig alone: {figures['rig_times_real_time']} x real time, "
        f"{figures['reads_times_real_time']} x with its edges read; "
        f"{figures['rig_over_scipy']} x scipy solve_ivp with events, "
        f"{figures['rig_over_analog']} x the same gearbox sampled at 1 MHz, "
        f"{figures['rig_over_sine']} x four sines at 1 MHz by numpy without a gearbox, "
        f"{figures['rig_over_steps']} x these with one shaft in plain Python; "
        f"{figures['ms_a_simulated_s_20_teeth']}, {figures['ms_a_simulated_s_40_teeth']} and "
        f"{figures['ms_a_simulated_s_80_teeth']} ms a simulated second with 20, 40 and 80 teeth"
    )
    for name in ("driving", "rattling"):
        costs = [f"{figures[f'ms_a_simulated_s_{name}_{p}']} ms {p}" for p in Profile]
        print(f"a simulated second, {name}: {', '.join(costs)}")
    if namespace.hours:
        print(
            f"{figures['hours']:g} simulated hours: {figures['memory_mb']} MB, grown by "
            f"{figures['memory_growth_mb']} MB since the first minute; the last tenth took "
            f"{figures['last_tenth_over_first']} x the time of the first"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
