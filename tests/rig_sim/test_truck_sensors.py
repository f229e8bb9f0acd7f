"""The truck's sensors: wheels as they were made, against the sampled sine of thesis 4.5."""

from __future__ import annotations

import math

import numpy as np
import pytest
from analog import edges_of_sine
from truck_bench import SHEET, run, world

from meshpoint.gearbox.gears import Sleeve
from meshpoint.kernels.structures import Floats, RecordArray
from meshpoint.rig_sim.parts.pneumatics import BrakeAir, chamber_pa_s, choked_rate
from meshpoint.rig_sim.shared.angle_kernels import TAU
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.as_built import linear, nominal
from meshpoint.rig_sim.truck.position_sensors import PositionSensors

QUIET = {"hall.jitter_us": 0.0, "hall.first_wrong_edges": 0.0}


def edge_times(truck: object, channel: int) -> list[int]:
    captured = truck.plant.rig.captured.channels[channel]  # type: ignore[attr-defined]
    count, size = captured.count, len(captured.times_us)
    return [int(captured.times_us[i % size]) for i in range(max(0, count - size), count)]


def edges_rad(truck: object, channel: int) -> Floats:
    hall = truck.plant.rig.hall[channel]  # type: ignore[attr-defined]
    return np.array(hall.edges_rad[: hall.teeth])


@pytest.mark.parametrize("threshold", [-0.4, 0.0, 0.3])
def test_edges_are_where_the_sampled_sine_passes_the_threshold(threshold: float) -> None:
    values = nominal() | QUIET | {"hall.threshold_share": threshold, "hall.runout_mm": 0.15}
    values |= {"hall.pitch_error_deg": 0.1, "hall.duty_percent": 0.0}
    truck = world(values | {"vehicle.constant_speed": 1.0}, seed=3)
    plant = truck.plant
    start = plant.y.angle_rad[at.MAIN]
    run(truck, 40_000)
    wheel = plant.edges.wheels[2]
    rises, falls = edges_of_sine(wheel, start, plant.main_rad_s, 0.040)
    for channel, sampled in ((4, rises), (5, falls)):
        found = edge_times(truck, channel)
        assert abs(len(found) - len(sampled)) <= 1  # one may lie at the very start
        for a, b in zip(found[::-1], sampled[::-1], strict=False):
            assert abs(a - b) <= 1  # the sine is seen at the next microsecond


def test_a_threshold_off_the_middle_narrows_the_teeth_and_a_duty_widens_them() -> None:
    pitch = TAU / SHEET.wheels.main.teeth
    for values, expected in (
        ({"hall.threshold_share": 0.3}, 0.5 - 2.0 * math.asin(0.3) / TAU),
        ({"hall.duty_percent": 5.0}, 0.55),
    ):
        truck = world(linear() | values)
        rises, falls = (edges_rad(truck, channel) for channel in (4, 5))
        shares = (falls - rises) / pitch
        assert shares == pytest.approx(expected)


def test_an_eccentric_wheel_ripples_once_a_turn_by_e_over_r() -> None:
    truck = world(linear() | {"hall.runout_mm": 0.1, "hall.wheel_radius_mm": 50.0})
    teeth = SHEET.wheels.layshaft.teeth
    errors = edges_rad(truck, 2) - TAU / teeth * np.arange(teeth)
    spectrum = np.abs(np.fft.rfft(errors)) * 2.0 / teeth
    assert spectrum[1] == pytest.approx(0.1 / 50.0, rel=1e-6)
    assert max(spectrum[2:]) < 1e-12


def test_jitter_has_its_standard_deviation_and_first_edges_are_wrong() -> None:
    calm = world(linear() | {"vehicle.constant_speed": 1.0}, seed=5)
    values = {"hall.jitter_us": 20.0, "hall.first_wrong_edges": 3.0, "hall.first_wrong_deg": 1.0}
    shaky = world(linear() | values, seed=5)
    errors: list[int] = []
    firsts: list[int] = []
    for now_us in range(20_000, 1_000_000, 20_000):
        run(calm, now_us)
        run(shaky, now_us)
        pairs = list(zip(edge_times(calm, 4)[-14:], edge_times(shaky, 4)[-14:], strict=False))
        (firsts if now_us == 20_000 else errors).extend(b - a for a, b in pairs)
    assert np.std(errors) == pytest.approx(20.0, rel=0.15)
    assert max(map(abs, firsts)) > 100


def test_a_position_sensor_has_noise_offset_and_gain_and_can_lie() -> None:
    truck = world({"position.noise_mm": 0.05, "position.offset_mm": 0.3, "position.gain": 1.01})
    sensors = PositionSensors(truck.built)
    read = np.array([sensors.read(Sleeve.FIRST_SECOND, (0.0,) * 10, 10_000 * i) for i in range(50)])
    assert read.std() == pytest.approx(0.05e-3, rel=0.2)
    assert 0.0 < abs(read.mean()) <= 0.3e-3 + 1e-5
    again = sensors.read(Sleeve.FIRST_SECOND, (0.0,) * 10, 0)
    assert tuple(read[0]) == again
    sensors.freeze(Sleeve.FIRST_SECOND, frozen=True)
    assert len(set(sensors.read(Sleeve.FIRST_SECOND, (0.01,) * 10, 20_000))) == 1


def test_a_chamber_fills_choked_in_9_5_ms_and_then_55_ms_more() -> None:
    # facts: 0.1 L, C 2e-8, 9 bar absolute, b 0.3, isothermal; the tail ends within 1 % of supply
    supply, ambient = 9e5, 1.013e5
    fill = choked_rate(2e-8, 0.1e-3, 1.0)
    air = BrakeAir(model=1.0, fill=fill, exhaust=fill, critical=0.3, atmosphere_pa=ambient)
    seen = RecordArray(air).array[0]
    pressure, t, choked_s, step = ambient, 0.0, None, 1e-6
    while pressure < 0.99 * supply:
        if choked_s is None and pressure > 0.3 * supply:
            choked_s = t
        pressure += step * chamber_pa_s(pressure, supply, 1.0, seen)
        t += step
    assert choked_s == pytest.approx(9.5e-3, abs=0.4e-3)
    assert t - choked_s == pytest.approx(55.1e-3, rel=0.25)


def test_the_tank_droops_when_valves_open_and_recovers() -> None:
    truck = world(nominal())
    truck.plant.coast()
    before = truck.plant.supply_gauge_pa
    truck.plant.set_brake(1.0)
    run(truck, 80_000)
    drooped = truck.plant.supply_gauge_pa
    truck.plant.set_brake(0.0)
    run(truck, 20_000_000)
    assert before - drooped > 2e3
    assert truck.plant.supply_gauge_pa == pytest.approx(before, rel=1e-3)
