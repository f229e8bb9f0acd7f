"""Each command that the rig obeys for a time: held just before it is over, gone just after."""

from __future__ import annotations

import pytest
from truck_bench import run, world

from meshpoint.rig_sim.orders import EngineRequest
from meshpoint.rig_sim.parts.engine import IDLE, SPEED_CONTROL, TORQUE_CONTROL
from meshpoint.rig_sim.shared.valve_drivers import EXPIRY_US
from meshpoint.rig_sim.truck.world import TruckWorld

SENT_US = 30_000
LAST_US, GONE_US = SENT_US + EXPIRY_US - 1, SENT_US + EXPIRY_US


def neutral() -> TruckWorld:
    truck = world({"clutch.kiss": 0.4})
    truck.plant.coast()
    run(truck, SENT_US)
    return truck


def test_commands_hold_for_100_ms() -> None:
    """docs/wire.md: valves, clutch and TSC1 alike."""
    assert EXPIRY_US == 100_000


@pytest.mark.parametrize(
    ("request_", "mode"),
    [
        (EngineRequest(200.0, None), SPEED_CONTROL),
        (EngineRequest(None, 0.5), TORQUE_CONTROL),
    ],
    ids=["speed", "torque"],
)
def test_an_engine_request_holds_for_100_ms_and_is_then_forgotten(
    request_: EngineRequest, mode: int
) -> None:
    truck = neutral()
    truck.command_engine(request_, SENT_US)
    run(truck, LAST_US)
    assert truck.plant.g.engine_mode == mode
    run(truck, GONE_US)
    assert truck.plant.g.engine_mode == IDLE


def test_an_engine_request_that_is_renewed_in_time_holds_on() -> None:
    truck = neutral()
    for now_us in range(SENT_US, 1_000_000, 90_000):
        run(truck, now_us)
        truck.command_engine(EngineRequest(None, 0.5), now_us)
    run(truck, now_us + EXPIRY_US - 1)
    assert truck.plant.g.engine_mode == TORQUE_CONTROL


def test_an_engine_that_is_no_longer_asked_for_torque_gives_it_up() -> None:
    truck = neutral()
    truck.command_clutch(False, SENT_US)
    truck.command_engine(EngineRequest(None, 0.5), SENT_US)
    run(truck, LAST_US)
    asked_nm = truck.plant.y.engine_nm
    run(truck, GONE_US + 500_000)
    assert asked_nm > 100.0
    assert truck.plant.y.engine_nm < 0.2 * asked_nm


def test_a_closed_clutch_stays_so_for_100_ms_and_opens_then() -> None:
    truck = neutral()
    truck.command_clutch(True, SENT_US)
    run(truck, LAST_US)
    assert truck.sensors(LAST_US).clutch == 1.0
    run(truck, GONE_US + 10_000)
    assert truck.sensors(GONE_US + 10_000).clutch < 1.0
    run(truck, GONE_US + 1_000_000)
    assert truck.sensors(GONE_US + 1_000_000).clutch == 0.0
