"""A wheel that turns back: a Hall sensor does not know, and counts on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from analog import edges_of_angles
from truck_bench import run, world

from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.as_built import nominal
from meshpoint.rig_sim.truck.world import TruckWorld

QUIET = {"hall.jitter_us": 0.0, "hall.first_wrong_edges": 0.0, "hall.duty_percent": 0.0}
CLEAR = {"clutch.kiss": 1.0}


def edges(truck: TruckWorld, channel: int) -> list[float]:
    captured = truck.plant.rig.captured.channels[channel]
    assert captured.count <= len(captured.times_us)  # so none is lost
    return captured.times_us[: captured.count]


@pytest.mark.parametrize(
    ("rpm", "accel_rad_s2"), [(200.0, -400.0), (500.0, -1777.0), (900.0, -4000.0)]
)
def test_edges_on_the_way_back_are_where_the_sampled_sine_passes_the_threshold(
    rpm: float, accel_rad_s2: float
) -> None:
    values = nominal() | QUIET | CLEAR | {"hall.threshold_share": 0.25}
    truck = world(values, main_speed_rpm=rpm, seed=6)
    plant = truck.plant
    plant.coast()
    plant.script_main(accel_rad_s2)
    start, omega = plant.y.angle_rad[at.MAIN], plant.main_rad_s
    run(truck, round(2.5e6 * omega / -accel_rad_s2))
    t = np.arange(round(plant.time_us)) * 1e-6
    sampled = edges_of_angles(plant.edges.wheels[2], start + (omega + accel_rad_s2 / 2 * t) * t)
    assert plant.main_rad_s < 0.0
    for channel, expected in zip((4, 5), sampled, strict=True):
        found = edges(truck, channel)
        assert len(found) == len(expected) > 8
        for a, b in zip(found, expected, strict=True):
            assert abs(a - b) <= 1.0


def test_a_truck_that_rolls_back_down_a_hill_counts_on() -> None:
    truck = world(nominal() | QUIET | CLEAR | {"vehicle.slope_percent": 12.0}, main_speed_rpm=60.0)
    truck.plant.coast()
    counts, speeds = [], []
    for now_us in range(0, 6_000_000, 100_000):
        run(truck, now_us)
        counts.append(truck.plant.rig.captured.channels[4].count)
        speeds.append(truck.plant.main_rad_s)
    assert speeds[0] > 1.0 > -1.0 > speeds[-1]
    assert counts == sorted(counts)
    turns, rest_rad = truck.plant.angle(at.MAIN)
    turns = abs(turns + rest_rad / math.tau)
    way = sum(abs(speed) for speed in speeds) * 0.1 / math.tau
    teeth = truck.plant.rig.hall[4].teeth
    assert way > turns + 1.0  # it went up and came back
    assert counts[-1] == pytest.approx(way * teeth, abs=0.02 * way * teeth + 3)
