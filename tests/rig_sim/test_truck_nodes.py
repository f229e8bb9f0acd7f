"""What a rig with --truck says of wheels, shaft and vehicle, against its own truth.

The frames are read by cantools from the DBC by PGN, as another tool would read them.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest
from read_dbc import database

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939_view import J1939_DBC
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import BenchAction, BenchCommand
from meshpoint.dbc.node import Node
from meshpoint.dbc.truck import TRUCK_SCHEMA
from meshpoint.gearbox.sheet import load_sheet
from meshpoint.rig_sim import Preset, RigCore, RigSettings
from meshpoint.rig_sim.settings import Profile
from meshpoint.rig_sim.shared.world import Vehicle
from meshpoint.rig_sim.truck_nodes import brakes, output_shaft
from meshpoint.rig_sim.truck_nodes.nodes import DELAY_US
from meshpoint.units import RPM

DBC = database(J1939_DBC, 0x03FFFF00)
IDS = {spec.can_id: spec for spec in TRUCK_SCHEMA.messages}
KMH = 3.6
EVEN = {"vehicle.constant_speed": 1.0}
UPHILL = {"vehicle.constant_speed": 0.0, "vehicle.slope_percent": 12.0}
WHEELS = ("FrontLeftSpeed", "FrontRightSpeed", "RearLeftSpeed", "RearRightSpeed")
TOOTH_M = brakes.CIRCUMFERENCE_M / brakes.TEETH
PITCH_SHARE = (brakes.TOOTH_RAD + brakes.RUNOUT_RAD) * brakes.TEETH / math.tau
"""How far a tooth may lie from its place, in pitches."""
READ_US = 10_000


class Said(NamedTuple):
    """A message of the truck's other nodes, and the truth at the read with which it was sent."""

    read_us: int
    values: dict[str, Any]
    road_m_s: float
    shaft_rad_s: float


def rig(preset: Preset = Preset.TRUCK, **settings: Any) -> RigCore:
    chosen = {"profile": Profile.CLEAN, "truck_nodes": True, "start_gear": 12} | settings
    return RigCore(load_sheet(preset.sheet_name), RigSettings(preset=preset, **chosen))


def steps(core: RigCore, seconds: float, begin_us: int = 0) -> Iterator[tuple[int, list[Frame]]]:
    for read_us in range(begin_us, begin_us + round(seconds * 1e6), READ_US):
        yield read_us, core.step(read_us).frames


def said(core: RigCore, seconds: float, begin_us: int = 0) -> dict[str, list[Said]]:
    """All that the other nodes said in so long, by message; None where it is not available."""
    found: dict[str, list[Said]] = defaultdict(list)
    for read_us, frames in steps(core, seconds, begin_us):
        for frame in frames:
            if frame.can_id not in IDS:
                continue
            message = DBC.get_message_by_frame_id(frame.can_id, force_extended_id=True)
            raw = message.decode(frame.data, scaling=False, decode_choices=False)
            values = message.decode(frame.data, decode_choices=False)
            known = {
                s.name: None if raw[s.name] == (1 << s.length) - 1 else values[s.name]
                for s in message.signals
            }
            truth = core.truth
            found[message.name].append(
                Said(read_us, known, truth.road_speed_m_s, truth.speeds_rad_s[-1])
            )
    return found


@pytest.fixture(scope="module")
def even() -> dict[str, list[Said]]:
    return said(rig(as_built=EVEN, seed=3), 4.0)


def wheel_error_m_s(speed_m_s: float, rate_m_s2: float = 0.0) -> float:
    """The most by which a wheel's speed may be wrong: tyre, teeth, age and half a step."""
    teeth = math.floor(speed_m_s / (1.0 + brakes.TYRE_SHARE) * brakes.WINDOW_US * 1e-6 / TOOTH_M)
    share = brakes.TYRE_SHARE + 1.02 * 2.0 * PITCH_SHARE / teeth + 1.0 / brakes.WINDOW_US
    tooth_s = 1.02 * TOOTH_M / speed_m_s
    age_s = (DELAY_US + brakes.WINDOW_US / 2.0) * 1e-6 + 1.5 * tooth_s
    return speed_m_s * share + abs(rate_m_s2) * age_s + 0.5 / 256.0 / KMH


def test_each_message_comes_at_its_cycle_time(even: dict[str, list[Said]]) -> None:
    assert set(even) == {spec.name for spec in TRUCK_SCHEMA.messages}
    for spec in TRUCK_SCHEMA.messages:
        reads_us = [each.read_us for each in even[spec.name]]
        assert reads_us[0] < spec.cycle_time_us
        assert set(np.diff(reads_us)) == {spec.cycle_time_us}, spec.name


def test_messages_of_equal_cycle_have_phases_of_their_own() -> None:
    first = {
        name: tuple(said(rig(as_built=EVEN, seed=seed), 0.1)[name][0].read_us for seed in range(4))
        for name in ("EBC1", "EBC2", "CCVS1")
    }
    assert len(set(first.values())) == 3


def test_at_an_even_speed_each_wheel_is_right_to_within_tyre_and_teeth(
    even: dict[str, list[Said]],
) -> None:
    settled = [each for each in even["HRW"] if each.read_us > 200_000]
    speed = settled[0].road_m_s
    assert speed > 10.0
    read = np.array([[each.values[name] / KMH for name in WHEELS] for each in settled])
    assert np.abs(read - speed).max() < wheel_error_m_s(speed)
    teeth_alone = np.abs(read - read.mean(axis=0)).max()
    assert 1.0 / 256.0 / KMH < teeth_alone < wheel_error_m_s(speed) - brakes.TYRE_SHARE * speed
    assert len({round(each, 3) for each in read.mean(axis=0)}) == 4  # no two tyres are the same


def test_front_axle_and_difference_are_the_wheels_again(even: dict[str, list[Said]]) -> None:
    """To within the teeth and half a step of the difference."""
    wheels = {name: np.mean([each.values[name] for each in even["HRW"][10:]]) for name in WHEELS}
    relative = ("FrontLeftRelative", "FrontRightRelative", "RearLeftRelative", "RearRightRelative")
    for each in even["EBC2"][2:]:
        teeth = KMH * (wheel_error_m_s(each.road_m_s) - brakes.TYRE_SHARE * each.road_m_s)
        for less, whole in zip(relative, WHEELS, strict=True):
            speed = each.values["FrontAxleSpeed"] + each.values[less]
            assert speed == pytest.approx(wheels[whole], abs=teeth + 1.0 / 32.0)
        assert each.values["SecondRearLeftRelative"] is None  # there is one rear axle


def test_shaft_and_vehicle_are_right_to_within_impulses_and_calibration(
    even: dict[str, list[Said]],
) -> None:
    shaft = output_shaft
    pitch = (shaft.TOOTH_RAD + shaft.RUNOUT_RAD) * shaft.IMPULSES / math.tau
    for name, field, window_us in (
        ("TCO1", "VehicleSpeed", shaft.TACHOGRAPH_US),
        ("CCVS1", "WheelBasedSpeed", shaft.ENGINE_US),
    ):
        for each in even[name]:
            if each.values[field] is None:
                assert each.read_us < 1_000_000
                continue
            impulses_s = each.shaft_rad_s / math.tau * shaft.IMPULSES
            share = 2.0 * pitch / max(1.0, math.floor(impulses_s * window_us * 1e-6))
            wrong = abs(each.values[field] / KMH / each.road_m_s - 1.0)
            assert wrong < shaft.CALIBRATION_SHARE + share + 1e-3
            if name == "TCO1":
                assert each.values["OutputShaftSpeed"] * RPM == pytest.approx(
                    each.shaft_rad_s, rel=share + 1e-3
                )
                assert each.values["VehicleMotion"] == 1


def test_a_vehicle_that_becomes_slower_is_read_a_little_late_and_its_rate_is_known() -> None:
    found = said(rig(as_built=UPHILL, seed=3), 3.0)
    times = np.array([each.read_us for each in found["VDC2"]]) * 1e-6
    speeds = np.array([each.road_m_s for each in found["VDC2"]])
    rate = np.polyfit(times[50:], speeds[50:], 1)[0]
    assert -1.5 < rate < -1.0  # 12 % uphill, and rolling
    for each in found["HRW"]:
        if each.read_us > 500_000:
            wheels = [each.values[name] / KMH for name in WHEELS]
            bound = wheel_error_m_s(each.road_m_s, rate)
            assert all(abs(wheel - each.road_m_s) < bound for wheel in wheels)
    read = np.array([each.values["LongitudinalAcceleration"] for each in found["VDC2"][50:]])
    span_s = brakes.ACCELERATION_US * 1e-6
    teeth = 2.0 * (wheel_error_m_s(speeds.max()) - brakes.TYRE_SHARE * speeds.max()) / span_s
    assert np.abs(read - rate).max() < teeth + 0.05 + 0.02 * abs(rate)
    assert read.mean() == pytest.approx(rate, abs=0.05)


@pytest.fixture(scope="module")
def ramp() -> tuple[dict[str, list[Said]], dict[str, list[Said]]]:
    """At an even 13 m/s, and then the bench's script takes the vehicle to 20 m/s in 0.3 s."""
    core = rig(as_built=EVEN)
    before = said(core, 0.5)
    back = BenchCommand(
        action=BenchAction.RETURN_TO_GEAR, gear=12, sequence=1, main_speed_rad_s=1_000.0 * RPM
    )
    core.receive(Transmitter(Node.BENCH).encode(back))
    return before, said(core, 2.0, 500_000)


def test_a_signal_stops_at_its_end(ramp: tuple[dict[str, list[Said]], ...]) -> None:
    read = [each.values["LongitudinalAcceleration"] for each in ramp[1]["VDC2"]]
    assert max(each for each in read if each is not None) == 12.5


def test_a_speed_is_as_old_as_its_window_its_teeth_and_its_node_make_it(
    ramp: tuple[dict[str, list[Said]], ...],
) -> None:
    even, steep = (each["HRW"] for each in ramp)
    tyre = {
        name: np.mean([each.values[name] / KMH / each.road_m_s for each in even[10:]])
        for name in WHEELS
    }
    road = {each.read_us: each.road_m_s for each in ramp[1]["VDC2"]}
    ages_s = []
    for each in steep:
        rates = np.diff([road.get(each.read_us - k * READ_US, 0.0) for k in range(6)]) * -1e2
        if rates.min() < 20.0 or np.ptp(rates) > 1e-3:
            continue  # not in the middle of the ramp
        for name in WHEELS:
            ages_s.append((each.road_m_s - each.values[name] / KMH / tyre[name]) / rates[0])
            teeth = wheel_error_m_s(each.road_m_s) - brakes.TYRE_SHARE * each.road_m_s
            around_s = 2.0 * teeth / rates[0]
            half_s, tooth_s = brakes.WINDOW_US / 2e6, TOOTH_M / (each.road_m_s - 1.0)
            assert half_s - around_s < ages_s[-1]
            assert ages_s[-1] < half_s + 1.5 * tooth_s + DELAY_US * 1e-6 + around_s
    mean_s = half_s + 0.75 * tooth_s + DELAY_US / 2e6
    assert np.mean(ages_s) == pytest.approx(mean_s, abs=1e-3)


def test_driven_wheels_that_slip_are_told_apart() -> None:
    wheels = brakes.BrakeController(np.random.default_rng(1))
    for time_us in range(0, 500_001, READ_US):
        wheels.turn(time_us, Vehicle(road_m_s=10.0, driven_m_s=11.0, wheel_m=0.2))
    hrw, ebc2 = wheels.hrw(500_000), wheels.ebc2(500_000)
    for side in ("left", "right"):
        assert hrw[f"front_{side}_speed_m_s"] == pytest.approx(10.0, rel=0.02)
        assert hrw[f"rear_{side}_speed_m_s"] == pytest.approx(11.0, rel=0.02)
        assert ebc2[f"rear_{side}_relative_m_s"] == pytest.approx(1.0, abs=0.3)


def test_where_the_driveline_twists_driven_wheels_are_a_body_of_their_own() -> None:
    core = rig(profile=Profile.TYPICAL)
    said(core, 0.5)
    vehicle, state = core.truth.vehicle, core.truth.plant.y  # type: ignore[attr-defined]
    assert vehicle is not None
    turning_rad_s = {state.wheels_rad_s, state.vehicle_rad_s, core.truth.speeds_rad_s[-1]}
    assert len(turning_rad_s) == 3
    assert vehicle.driven_m_s == state.wheels_rad_s * vehicle.wheel_m
    assert vehicle.road_m_s == state.vehicle_rad_s * vehicle.wheel_m


def test_nobody_brakes(even: dict[str, list[Said]]) -> None:
    for each in even["EBC1"]:
        assert each.values == {"AbsActive": 0, "EbsBrakeSwitch": 0, "BrakePedalPosition": 0.0}
    assert {each.values["BrakeSwitch"] for each in even["CCVS1"]} == {0}


def test_a_truck_that_stands_reads_zero_once_that_is_known() -> None:
    found = said(rig(as_built=EVEN, main_speed_rpm=0.0), 1.5)
    wheels = [set(each.values.values()) for each in found["HRW"]]
    assert wheels[0] == {None}
    assert wheels[-1] == {0.0}
    assert found["TCO1"][-1].values == {
        "VehicleMotion": 0, "OutputShaftSpeed": 0.0, "VehicleSpeed": 0.0,
    }  # fmt: skip
    assert found["VDC2"][-1].values == {"LongitudinalAcceleration": 0.0}


def test_without_a_vehicle_only_the_shaft_is_known() -> None:
    found = said(rig(Preset.THESIS, start_gear=8), 1.5)
    for name in ("EBC1", "EBC2", "HRW", "VDC2", "CCVS1"):
        assert {value for each in found[name] for value in each.values.values()} == {None}, name
    last = found["TCO1"][-1]
    assert last.values["VehicleSpeed"] is None
    assert last.values["OutputShaftSpeed"] * RPM == pytest.approx(last.shaft_rad_s, rel=0.05)


def test_without_the_other_nodes_every_byte_stays_as_it_is() -> None:
    with_them = list(steps(rig(seed=5, profile=Profile.TYPICAL), 1.0))
    without = list(steps(rig(seed=5, profile=Profile.TYPICAL, truck_nodes=False), 1.0))
    assert [(us, [f for f in frames if f.can_id not in IDS]) for us, frames in with_them] == without


def test_the_same_seed_says_the_same_and_another_one_does_not() -> None:
    first, again, other = (
        [f for _, frames in steps(rig(seed=seed), 1.0) for f in frames if f.can_id in IDS]
        for seed in (5, 5, 6)
    )
    assert first == again
    assert first != other


def test_the_tachograph_says_that_it_moves_after_five_seconds_and_that_it_stands_in_one() -> None:
    """(EU) 2016/799: more than an impulse a second, for five seconds."""
    shaft = output_shaft.OutputShaft(np.random.default_rng(1))
    crawl_rad_s = 0.5 * math.tau / output_shaft.IMPULSES
    moves = {}
    for time_us in range(0, 30_000_000, READ_US):
        turning_rad_s = 40.0 if 1e6 < time_us <= 9e6 else crawl_rad_s if time_us > 15e6 else 0.0
        shaft.turn(time_us, turning_rad_s, None)
        if time_us % output_shaft.TACHOGRAPH_US == 0 and time_us:
            moves[time_us * 1e-6] = shaft.tco1(time_us).get("vehicle_motion")
    begun_s = min(time_s for time_s, moving in moves.items() if time_s > 1.0 and moving)
    ended_s = min(time_s for time_s, moving in moves.items() if time_s > 9.0 and not moving)
    assert begun_s == pytest.approx(6.0, abs=0.2)
    assert 9.0 < ended_s < 10.3
    assert not any(moving for time_s, moving in moves.items() if time_s > ended_s)


def test_a_truck_that_drives_says_so_on_the_bus(even: dict[str, list[Said]]) -> None:
    assert {each.values["VehicleMotion"] for each in even["TCO1"][2:]} == {1}
