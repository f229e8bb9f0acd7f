"""The thesis preset against the thesis: an independent integration, and limits in closed form."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from rig_bench import SHEET, RigBench, edges_of, release_first, thesis_rig
from scipy.integrate import solve_ivp

from meshpoint.dbc.messages import (
    EdgesInputFall,
    EdgesInputRise,
    EdgesLayshaftFall,
    EdgesLayshaftRise,
    EdgesMainRise,
    EngagementEvent,
    GearboxSensors,
    ReferenceEncoder,
    ValveAction,
    ValveCommand,
)
from meshpoint.kernels.structures import RecordArray
from meshpoint.rig_sim.thesis.closed_form import FREE, Motion, free_motion
from meshpoint.units import RPM

RELEASE_US = 400_000
END_US = 900_000


def moving(
    omega: float, drag: float, valve_rate: float, gain: float, end_pa: float, diff_pa: float
) -> Motion:
    motion = Motion(FREE, omega, 0.0, drag, valve_rate, gain, end_pa, diff_pa)
    return RecordArray(motion).array[0]


def reference_motion(
    initial: tuple[float, float], start_s: float, switches: list[tuple[float, bool]], split: Any
) -> Any:
    """theta, omega, p of 4.1-4.15 by Runge-Kutta 8(5,3), piece by piece between the switches."""
    inertia = SHEET.shafts.layshaft_inertia_kgm2 + SHEET.shafts.input_inertia_kgm2 / split**2
    friction, torque = SHEET.shafts.friction_nms, SHEET.brake.max_torque_nm
    supply, tau = SHEET.air.supply_gauge_pa, SHEET.brake.time_constant_s
    state = np.array([*initial, 0.0])
    times = [start_s, *(time for time, _ in switches), END_US * 1e-6]
    inputs = [0.0, *(float(on) for _, on in switches)]
    pieces = []
    for begin, end, u in zip(times, times[1:], inputs, strict=False):

        def slope(_: float, x: Any, u: float = u) -> list[float]:
            brake = -torque * x[2] / supply
            return [x[1], (-friction * x[1] + brake) / inertia, (supply * u - x[2]) / tau]

        if end > begin:
            solved = solve_ivp(
                slope, (begin, end), state, "DOP853", rtol=1e-10, atol=1e-10, dense_output=True
            )
            pieces.append((begin, end, solved.sol))
            state = solved.y[:, -1]

    def at(time_s: float) -> Any:
        for begin, end, sol in pieces:
            if begin <= time_s <= end:
                return sol(time_s)
        raise ValueError(time_s)

    return at


@st.composite
def brake_pulses(draw: st.DrawFn) -> list[tuple[int, int]]:
    """Two or three brake pulses after the release, (on, off) in microseconds since power-up; on and
    off more than a command's cycle apart, since a valve has one slot."""
    pulses = []
    time_us = RELEASE_US
    for _ in range(draw(st.integers(2, 3))):
        time_us += draw(st.integers(1, 60_000))
        on_us = time_us
        time_us += draw(st.integers(10_001, 60_000))
        pulses.append((on_us, time_us))
        time_us += 10_001
    return pulses


def pulsing(bench: RigBench, pulses: list[tuple[int, int]]) -> Callable[[int], ValveCommand]:
    """Commands that switch the brake at exactly these times, each sent up to 10 ms ahead."""

    def brake(now_us: int) -> tuple[ValveAction, int]:
        on_us, off_us = next(
            ((on_us, off_us) for on_us, off_us in pulses if off_us > now_us), (END_US, END_US)
        )
        if on_us - 10_000 <= now_us < on_us:
            return ValveAction.ON_AT, bench.clock(on_us)
        if on_us <= now_us and off_us - 10_000 <= now_us:
            return ValveAction.OFF_AT, bench.clock(off_us)
        return (ValveAction.ON_NOW if on_us <= now_us else ValveAction.OFF_NOW), 0

    def valves(now_us: int) -> ValveCommand:
        action, time_us = brake(now_us)
        return release_first(now_us)._replace(brake_action=action, brake_time_us=time_us)

    return valves


@settings(max_examples=6, deadline=None, phases=[Phase.explicit, Phase.generate])
@given(seed=st.integers(0, 10_000), pulses=brake_pulses())
def test_every_edge_of_a_braked_shift_lies_where_an_independent_integration_has_it(
    seed: int, pulses: list[tuple[int, int]]
) -> None:
    bench = RigBench(thesis_rig(seed=seed))
    bench.step(0)
    wheels = [turns * 2 * math.pi + rest for turns, rest in bench.core.truth.angles]
    bench.run(END_US, pulsing(bench, pulses))
    (released,) = bench.events(EngagementEvent.RELEASED)
    start_s = (released.event_time_us - bench.clock(0)) % (1 << 32) * 1e-6
    omega_main = 644.0 * RPM
    omega = omega_main / SHEET.main.first.ratio
    delay_s = SHEET.brake.valve_delay_s
    switches = [
        (time_us * 1e-6 + delay_s, on)
        for pulse in pulses
        for time_us, on in zip(pulse, (True, False), strict=True)
    ]
    switches = [entry for entry in switches if entry[0] < END_US * 1e-6]
    split = SHEET.splitter.high.ratio
    motion = reference_motion((wheels[1] + omega * start_s, omega), start_s, switches, split)

    def layshaft(time_s: float) -> tuple[float, float]:
        if time_s < start_s:
            return wheels[1] + omega * time_s, omega
        theta, speed, _ = motion(time_s)
        return float(theta), float(speed)

    def check(kind: type[Any], shaft: int, teeth: int, ratio: float, duty: float) -> None:
        pitch = 2 * math.pi / teeth
        before = math.floor(wheels[shaft] / pitch - duty)
        edges = edges_of(bench.of(kind))
        assert len(edges) == max(edges) > 200
        for index, clock_us in list(edges.items())[::7]:
            # the timer counts whole microseconds: half a one later is the best guess of the edge
            time_s = (clock_us - bench.core.truth.clock_start_us + 0.5) * 1e-6
            theta, speed = layshaft(time_s)
            if shaft == 2:
                theta, speed = wheels[1] + omega_main * time_s, omega_main
            angle = wheels[shaft] + ratio * (theta - wheels[1])
            error_s = (angle - (before + index + duty) * pitch) / (ratio * speed)
            assert abs(error_s) < 1e-6

    check(EdgesLayshaftRise, 1, SHEET.wheels.layshaft.teeth, 1.0, 0.0)
    check(EdgesLayshaftFall, 1, SHEET.wheels.layshaft.teeth, 1.0, 0.5)
    check(EdgesInputRise, 0, SHEET.wheels.input_.teeth, 1.0 / split, 0.0)
    check(EdgesInputFall, 0, SHEET.wheels.input_.teeth, 1.0 / split, 0.5)
    check(EdgesMainRise, 2, SHEET.wheels.main.teeth, 1.0, 0.0)
    for sample in bench.of(GearboxSensors)[41::7]:
        time_s = (sample.sample_time_us - bench.clock(0)) % (1 << 32) * 1e-6
        pressure = sample.brake_pressure_pa - SHEET.air.atmosphere_pa
        assert pressure == pytest.approx(float(motion(time_s)[2]), abs=11.0)
    for sample in bench.of(ReferenceEncoder)[41::7]:
        for back, (angle, speed) in enumerate(
            zip(sample.angle_rad, sample.speed_rad_s, strict=True)
        ):
            time_s = (sample.sample_time_us - bench.clock(0)) % (1 << 32) * 1e-6 - 0.002 * back
            error = (angle - layshaft(time_s)[0] + math.pi) % (2 * math.pi) - math.pi
            assert abs(error) < 5e-5  # the release is known to a microsecond, not better
            assert speed == pytest.approx(layshaft(time_s)[1], abs=1e-4)


rates = st.one_of(st.just(0.0), st.floats(1e-9, 40.0))


@settings(max_examples=60, deadline=None)
@given(a=rates, b=st.floats(2.0, 1000.0), s=st.floats(1e-6, 1.0), same=st.booleans())
def test_the_closed_form_solves_the_equations_for_any_rates(
    a: float, b: float, s: float, same: bool
) -> None:
    a = b if same else a
    omega, k, p_end, p_diff = 150.0, 3.5e-4, 8e5, -5e5
    solved = solve_ivp(
        lambda t, x: [x[1], -a * x[1] - k * (p_end + p_diff * math.exp(-b * t))],
        (0.0, s),
        [0.0, omega],
        "DOP853",
        rtol=1e-12,
        atol=1e-12,
    )
    turned, speed = free_motion(moving(omega, a, b, k, p_end, p_diff), s)
    assert turned == pytest.approx(solved.y[0, -1], abs=1e-8, rel=1e-9)
    assert speed == pytest.approx(solved.y[1, -1], abs=1e-8, rel=1e-9)


@pytest.mark.parametrize("a", [1e-3, 1e-2, 1.9, 2.1, 20.0])
def test_the_series_for_slow_rates_joins_the_closed_form(a: float) -> None:
    # x = a s = 0.02 is where one takes over from the other
    below, above = (0.02 / a) * (1 - 1e-9), (0.02 / a) * (1 + 1e-9)
    motion = moving(150.0, a, 16.7, 3.5e-4, 8e5, -5e5)
    speed = free_motion(motion, below)[1]
    step = free_motion(motion, above)[0] - free_motion(motion, below)[0]
    assert step == pytest.approx(speed * (above - below), rel=1e-3, abs=1e-12)


def test_without_friction_the_brake_follows_its_closed_curve() -> None:
    sheet = replace(SHEET, shafts=replace(SHEET.shafts, friction_nms=0.0))
    bench = RigBench(thesis_rig(seed=3), sheet)
    brake_us = 400_000

    def valves(now_us: int) -> ValveCommand:
        on = ValveAction.ON_NOW if now_us >= brake_us else ValveAction.OFF_NOW
        return release_first(now_us)._replace(brake_action=on)

    bench.run(600_000, valves)
    omega = 1400.0 * RPM
    rate = sheet.brake.max_torque_nm / sheet.inertia_kgm2(bench.world.shafts.split)
    tau = sheet.brake.time_constant_s
    for sample in bench.of(ReferenceEncoder):
        time_s = (sample.sample_time_us - bench.clock(0)) % (1 << 32) * 1e-6
        s = max(time_s - brake_us * 1e-6 - sheet.brake.valve_delay_s, 0.0)
        expected = omega - rate * (s - tau * (1.0 - math.exp(-s / tau)))
        assert sample.speed_rad_s[0] == pytest.approx(expected, abs=1e-4)


def test_the_brake_stops_the_layshaft_and_never_turns_it_back() -> None:
    bench = RigBench(thesis_rig(seed=4))

    def valves(now_us: int) -> ValveCommand:
        on = ValveAction.ON_NOW if now_us >= 400_000 else ValveAction.OFF_NOW
        return release_first(now_us)._replace(brake_action=on)

    bench.run(1_500_000, valves)
    speeds = [sample.speed_rad_s[0] for sample in bench.of(ReferenceEncoder)]
    assert min(speeds) == 0.0
    assert speeds[-1] == 0.0
    angles = [sample.angle_rad[0] for sample in bench.of(ReferenceEncoder)[-30:]]
    assert len(set(angles)) == 1
