"""What a log would hold of gearboxes whose parameters are known: free runs of the layshaft."""

from __future__ import annotations

import numpy as np

from meshpoint.gearbox import Range, Split, load_sheet
from meshpoint.identify.log_reader import FreeRun, Wheel
from meshpoint.identify.valve_switches import Switch
from meshpoint.kernels.records import Vector
from meshpoint.units import RPM, TURN

SHEET = load_sheet("truck12")
TEETH = SHEET.wheels.layshaft.teeth
EDGES = 2 * TEETH
STEP_S = 2e-5
GAIN, DELAY_S, TAU_S, DRAG_NM, SENSOR_LAG_S = 0.9, 0.0135, 0.038, 6.0, 0.004


def crossings(theta: Vector, errors: Vector, start_us: int = 0) -> Wheel:
    """Every edge of a wheel whose angle is `theta` each `STEP_S`."""
    edges = np.arange(1, int(theta[-1] / TURN * EDGES))
    place, nominal = edges % EDGES, edges * TURN / EDGES
    seconds = np.interp(nominal + errors[place], theta, np.arange(theta.size) * STEP_S)
    return Wheel(start_us + seconds * 1e6, nominal, place)


def braked(start_us: int, rpm: float, on_s: float, split: Split) -> FreeRun:
    """A first-order brake on another layshaft than the sheet's: on at once, off after `on_s`."""
    steps = int(0.25 / STEP_S)
    theta, omega, pressure, felt, supply = np.zeros(steps), rpm * RPM, 0.0, 0.0, 8.2e5
    samples = []
    for k in range(steps - 1):
        since = k * STEP_S
        on = DELAY_S <= since < on_s + DELAY_S
        if k % 500 == 0:
            samples.append((start_us + since * 1e6, felt + SHEET.air.atmosphere_pa))
        felt += STEP_S / SENSOR_LAG_S * (pressure - felt)
        pressure += STEP_S / TAU_S * ((supply if on else 0.0) - pressure)
        torque = GAIN * SHEET.brake_nm_per_pa * pressure + DRAG_NM
        theta[k + 1] = theta[k] + STEP_S * omega
        omega -= STEP_S * torque / SHEET.inertia_kgm2(split)
    wheel = crossings(theta, np.zeros(EDGES), start_us)
    switches = (Switch(start_us, True, True), Switch(start_us + int(on_s * 1e6), False, True))
    return FreeRun(
        start_us, start_us + 250_000, split, Range.HIGH, wheel, wheel, switches,
        np.array(samples).T, supply + SHEET.air.atmosphere_pa, np.empty((2, 0)),
    )  # fmt: skip


def runs(count: int = 6) -> list[FreeRun]:
    """In both steps of the splitter, at different speeds, with the brake on for longer each."""
    return [
        braked(1_000_000 * (k + 1), 1100.0 + 40.0 * k, 0.09 + 0.01 * k, Split(k % 2))
        for k in range(count)
    ]
