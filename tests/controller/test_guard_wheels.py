"""From raw frames: a speed wheel that the others deny has no speed for the guard, so nothing is
engaged by it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest
from guard_cases import LIMITS, NEUTRAL, SHEET, near, payload, ready
from test_guard_ear import frame, write_crc

from meshpoint.controller.guard.listening import (
    EDGES,
    PROTECTED,
    SENSORS,
    SLEEVES_AUX,
    SLEEVES_MAIN,
    VALVE_STATUS,
)
from meshpoint.controller.guard.view import GuardInputs, GuardView
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox import MainGear, Range, Split
from meshpoint.units import RPM

CYCLE_US = 10_000
STAMPS = 27
NONE, IN_SECOND = 0, 12_000
HIGH, LOW = 12_000, 0x10000 - 12_000
LAYSHAFT_RPM = 1_400.0


def turning(layshaft_rpm: float = LAYSHAFT_RPM) -> tuple[float, ...]:
    """All four shafts in second gear, high split, low range."""
    layshaft = layshaft_rpm * RPM
    main = layshaft * SHEET.main_mesh(MainGear.SECOND).ratio
    propeller = main * SHEET.range_mesh(Range.LOW).ratio
    return layshaft / SHEET.split_mesh(Split.HIGH).ratio, layshaft, main, propeller


def edges(shaft: int, counter: int, stamp: int, omega_rad_s: float) -> Frame:
    """A read of a wheel that has turned at this speed since the clock began."""
    wheels = SHEET.wheels
    teeth = (wheels.input_, wheels.layshaft, wheels.main, wheels.propeller)[shaft].teeth
    tooth_us = 2.0 * math.pi * 1e6 / (teeth * omega_rad_s)
    newest = int(stamp / tooth_us)
    times_us = [round((newest - k) * tooth_us) for k in range(STAMPS)]
    return edges_at(shaft, counter, stamp, newest, times_us)


def edges_at(shaft: int, counter: int, stamp: int, newest: int, times_us: list[int]) -> Frame:
    """A read of a wheel with these edges, the newest first."""
    can_id = EDGES[shaft]
    data = bytearray(64)
    data[2] = counter % 256
    data[3:7] = stamp.to_bytes(4, "little")
    data[7:9] = (newest & 0xFFFF).to_bytes(2, "little")
    data[9] = STAMPS
    for k, time_us in enumerate(times_us):
        data[10 + 2 * k : 12 + 2 * k] = (time_us & 0xFFFF).to_bytes(2, "little")
    write_crc(data, PROTECTED[can_id][1], increment_counter=False)
    return Frame(can_id, bytes(data), is_fd=True)


RAISED_S, RAISED_RAD_S2 = 1.0, 1_000.0
"""From then on the engine raises the layshaft for so much."""


def raised_edges(shaft: int, counter: int, stamp: int) -> Frame:
    """A read of a wheel of which the layshaft was turned evenly, and is raised since."""
    wheels, omegas = SHEET.wheels, turning(500.0)
    omega, gain = omegas[shaft], RAISED_RAD_S2 * omegas[shaft] / omegas[1]
    teeth = (wheels.input_, wheels.layshaft, wheels.main, wheels.propeller)[shaft].teeth

    def passed_s(index: int) -> float:
        beyond = 2.0 * math.pi * index / teeth - omega * RAISED_S
        if beyond <= 0.0:
            return RAISED_S + beyond / omega
        return RAISED_S + (math.sqrt(omega**2 + 2.0 * gain * beyond) - omega) / gain

    since_s = 1e-6 * (stamp - 2_000_000)
    turned = omega * since_s + 0.5 * gain * max(0.0, since_s - RAISED_S) ** 2
    newest = math.floor(turned * teeth / (2.0 * math.pi))
    times_us = [2_000_000 + round(1e6 * passed_s(newest - k)) for k in range(STAMPS)]
    return edges_at(shaft, counter, stamp, newest, times_us)


def in_doubt_raised(apart: tuple[int, ...]) -> set[tuple[int, ...]]:
    """What comes into doubt in neutral, while the layshaft is raised; apart: wheels whose frames of
    a read are heard a step sooner than the others."""
    view, found = GuardView(SHEET, LIMITS), set()
    for counter in range(50, 120):
        stamp = 2_000_000 + CYCLE_US * counter
        frames = [raised_edges(shaft, counter, stamp) for shaft in range(4)]
        slow = [
            frame(SENSORS, counter, stamp),
            frame(SLEEVES_MAIN, counter, stamp, {7: 0, 8: NONE}),
            frame(SLEEVES_AUX, counter, stamp, {8: HIGH, 28: LOW}),
            frame(VALVE_STATUS, counter, stamp),
        ]
        sooner = [frames[shaft] for shaft in apart]
        later = [each for each in frames if each not in sooner] + slow
        for after_us, heard in ((500, sooner), (5_500, later)):
            now_us = stamp + after_us
            found.add(view.take(heard, now_us, now_us).in_doubt)
    return found


@pytest.mark.parametrize("apart", [(), (0,), (1,), (0, 1), (2,), (0, 2), (3,)])
def test_steps_between_the_frames_of_a_read_bring_no_wheel_into_doubt(
    apart: tuple[int, ...],
) -> None:
    """Red before: once a window had begun with the counts of two reads it went on so, and while the
    engine raised the shafts they contradicted each other."""
    assert in_doubt_raised(apart) == {()}


def seen_after(
    for_ms: int, factors: Sequence[float], first_second: int = IN_SECOND, fault_bits: int = 0
) -> GuardInputs:
    """What the guard sees after so long, with wheels that give this many times their edges."""
    view = GuardView(SHEET, LIMITS)
    for counter in range(for_ms // 10):
        stamp = 2_000_000 + CYCLE_US * counter
        frames = [
            edges(shaft, counter, stamp, omega * factors[shaft])
            for shaft, omega in enumerate(turning())
        ]
        frames += [
            frame(SENSORS, counter, stamp),
            frame(SLEEVES_MAIN, counter, stamp, {7: fault_bits, 8: first_second}),
            frame(SLEEVES_AUX, counter, stamp, {8: HIGH, 28: LOW}),
            frame(VALVE_STATUS, counter, stamp),
        ]
        seen = view.take(frames, 5_000_000 + CYCLE_US * counter, stamp)
    return seen


def test_wheels_that_read_right_have_their_speeds() -> None:
    seen = seen_after(1_500, (1.0, 1.0, 1.0, 1.0))
    assert seen.valid
    assert seen.in_doubt == ()
    speeds = [None if each is None else each.omega_rad_s for each in seen.speeds]
    assert speeds == pytest.approx(list(turning()), rel=1e-2)


@pytest.mark.parametrize("factor", [2.0, 0.5, 0.8])
@pytest.mark.parametrize("wheel", range(4))
def test_a_wheel_that_the_others_deny_has_no_speed_and_the_others_keep_theirs(
    wheel: int, factor: float
) -> None:
    factors = [factor if shaft == wheel else 1.0 for shaft in range(4)]
    seen = seen_after(1_500, factors)
    assert seen.in_doubt == (wheel,)
    assert [speed is None for speed in seen.speeds] == [shaft == wheel for shaft in range(4)]


def test_positions_of_a_sensor_that_says_it_is_out_of_range_put_nothing_in_mesh() -> None:
    assert seen_after(1_500, (1.0, 2.0, 1.0, 1.0), fault_bits=1).in_doubt == ()


@pytest.mark.parametrize(("wheel", "row"), [(0, None), (1, 4), (2, 4), (3, None)])
def test_by_the_speed_of_a_wheel_in_doubt_nothing_is_engaged(wheel: int, row: int | None) -> None:
    """Row 4: layshaft and main shaft are those that a gear is fired by."""
    speeds = [None if shaft == wheel else speed for shaft, speed in enumerate(NEUTRAL.speeds)]
    a, b, c, d = speeds
    guard = ready()
    seen = near(ValveName.MAIN_SECOND)._replace(speeds=(a, b, c, d), in_doubt=(wheel,))
    assert guard.passes(payload(ValveName.MAIN_SECOND), seen) is (row is None)
    assert guard.blocked_row == row
