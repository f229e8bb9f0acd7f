"""What controller, rig and data sheet each write down must be what the DBC says."""

from __future__ import annotations

from pathlib import Path

import cantools.database
import pytest
from cantools.database.can import Database, Message
from hypothesis import given, settings
from hypothesis import strategies as st

import meshpoint.controller.core.core
import meshpoint.controller.guard.case
import meshpoint.controller.guard.listening as guard_ear
import meshpoint.controller.run.node
import meshpoint.rig_sim.node
import meshpoint.rig_sim.shared.valve_drivers
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.edges import EDGE_IDS, EDGE_MESSAGES
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import (
    EEC1,
    TC1,
    EdgesMainRise,
    GearboxSensors,
    SleevesAux,
    SleevesMain,
    ValveAction,
    ValveCommand,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.dbc.truck import TRUCK_DBC
from meshpoint.gearbox import MainGear
from meshpoint.gearbox.wheels import WHEEL_NAMES
from meshpoint.logs.consumed import RIG_ADDRESSES

DBC = Path(__file__).parents[2] / "dbc" / "meshpoint.dbc"


@pytest.fixture(scope="module")
def database() -> Database:
    """The DBC as cantools reads it, without any code of ours."""
    loaded = cantools.database.load_file(DBC)
    assert isinstance(loaded, Database)
    return loaded


def message(database: Database, name: str) -> Message:
    return database.get_message_by_name(name)


def address(database: Database, node: str) -> int:
    attributes = database.get_node_by_name(node).dbc.attributes
    return int(attributes["NmStationAddress"].value)


def test_the_main_gears_of_the_sheet_are_those_of_the_wire(database: Database) -> None:
    choices = message(database, "ReferenceEngagement").get_signal_by_name("Gear").choices
    assert choices is not None
    assert {int(k): str(v).upper() for k, v in choices.items()} == {g: g.name for g in MainGear}


def test_the_controller_answers_to_its_address_in_the_dbc(database: Database) -> None:
    own = address(database, "TransmissionControl")
    assert own == meshpoint.controller.core.core.OWN_ADDRESS
    assert frozenset({own}) == meshpoint.controller.run.node.ADDRESSES
    for sent in database.messages:
        is_ours = sent.senders == ["TransmissionControl"]
        assert (sent.frame_id & 0xFF == own) is is_ours, sent.name


def test_the_rig_process_has_the_addresses_of_the_nodes_it_plays(database: Database) -> None:
    played = {address(database, name) for name in ("GearboxIo", "Engine", "Reference")}
    assert played == RIG_ADDRESSES
    assert played == meshpoint.rig_sim.node.ADDRESSES


def test_each_of_the_trucks_other_nodes_sends_from_its_address() -> None:
    truck = cantools.database.load_file(TRUCK_DBC)
    for sent in truck.messages:
        assert sent.frame_id & 0xFF == address(truck, sent.senders[0]), sent.name
    others = {address(truck, name) for name in ("Brakes", "Tachograph")}
    assert others == meshpoint.rig_sim.node.TRUCK_ADDRESSES


def test_the_status_frame_closes_the_step(database: Database) -> None:
    """Its identifier loses against every other frame of its sender."""
    ours = [m for m in database.messages if m.senders == ["TransmissionControl"]]
    assert max(ours, key=lambda m: m.frame_id).name == "ControllerStatus"


def test_the_valves_stand_in_the_same_order_everywhere(database: Database) -> None:
    signals = message(database, "ValveCommand").signals
    actions = sorted((s for s in signals if s.name.endswith("Action")), key=lambda s: s.start)
    on_wire = [signal.name.removesuffix("Action") for signal in actions]

    def camel(name: str) -> str:
        return "".join(part.capitalize() for part in name.split("_"))

    assert [camel(valve.name) for valve in ValveName] == on_wire
    assert [camel(valve.name) for valve in meshpoint.rig_sim.shared.valve_drivers.Valve] == on_wire
    assert [int(valve) for valve in ValveName] == list(range(9))


def test_the_guard_reads_the_frame_where_the_dbc_has_it(database: Database) -> None:
    """Its own numbers, written down a second time on purpose."""
    command = message(database, "ValveCommand")
    assert command.length == meshpoint.controller.guard.case.FRAME_LENGTH
    first = command.get_signal_by_name("BrakeAction")
    assert first.start == 8 * meshpoint.controller.guard.case.ACTION_BYTES.start
    choices = first.choices
    assert choices is not None
    assert str(choices[meshpoint.controller.guard.case.ON_NOW]) == "OnNow"
    assert str(choices[meshpoint.controller.guard.case.ON_AT]) == "OnAt"


ACTIONS = st.tuples(*[st.sampled_from(list(ValveAction))] * 9)
TIMES = st.tuples(*[st.integers(0, (1 << 32) - 1)] * 9)


@settings(deadline=None, max_examples=150)
@given(actions=ACTIONS, times=TIMES, before=st.integers(0, 5))
def test_the_guard_decodes_what_the_codec_encodes(
    actions: tuple[ValveAction, ...], times: tuple[int, ...], before: int
) -> None:
    """Two decoders written apart agree on which valves a frame drives, whatever times and
    counters surround them."""
    transmitter = Transmitter(Node.TRANSMISSION_CONTROL)
    for _ in range(before):
        transmitter.encode(ValveCommand())
    payload = transmitter.encode(ValveCommand(*actions, *times)).data
    driven = tuple(action in (ValveAction.ON_NOW, ValveAction.ON_AT) for action in actions)
    assert meshpoint.controller.guard.case.decode(payload).driven == driven


def start_of(database: Database, name: str, signal: str) -> int:
    """The byte at which a signal begins."""
    bit = message(database, name).get_signal_by_name(signal).start
    assert bit % 8 == 0
    return bit // 8


def test_each_wheel_of_a_sheet_has_its_messages_in_the_order_of_the_channels(
    database: Database,
) -> None:
    names = [name.title().replace("_", "") for name in WHEEL_NAMES]
    of_wheels = [f"Edges{name}{edge}" for name in names for edge in ("Rise", "Fall")]
    assert [each.__name__ for each in EDGE_MESSAGES] == of_wheels
    assert [message(database, name).frame_id for name in of_wheels] == list(EDGE_IDS)
    assert list(EDGE_IDS) == sorted(EDGE_IDS)


def test_the_guard_hears_the_messages_that_the_dbc_has(database: Database) -> None:
    """Identifiers, lengths, E2E data identifiers and offsets, written down a second time."""
    edges = [f"Edges{shaft}Rise" for shaft in ("Input", "Layshaft", "Main", "Propeller")]
    slow = ["GearboxSensors", "SleevesMain", "SleevesAux", "ValveStatus"]
    assert [message(database, name).frame_id for name in edges] == list(guard_ear.EDGES)
    assert [message(database, name).frame_id for name in slow] == list(guard_ear.NEEDED)
    there = {}
    for name in edges + slow:
        sent = message(database, name)
        there[sent.frame_id] = (sent.length, int(sent.dbc.attributes["E2EDataId"].value))
        clock = "ReadTime" if name in edges else "SampleTime"
        assert start_of(database, name, clock) == guard_ear.STAMP_AT
    assert there == guard_ear.PROTECTED
    assert message(database, "EEC1").frame_id == guard_ear.ENGINE_SPEED
    assert message(database, "TC1").frame_id == guard_ear.GEAR_REQUEST
    assert start_of(database, "EEC1", "EngineSpeed") == guard_ear.ENGINE_AT
    assert start_of(database, "TC1", "RequestedGear") == guard_ear.GEAR_AT
    period_us = message(database, "ValveStatus").cycle_time * 1000
    assert 4 * period_us == guard_ear.SILENT_US


NUMBER = st.floats(0.0, 1.0)


@settings(deadline=None, max_examples=100)
@given(shares=st.tuples(*[NUMBER] * 5), stamp=st.integers(0, (1 << 32) - 1))
def test_the_guard_hears_what_the_codec_says(shares: tuple[float, ...], stamp: int) -> None:
    """Positions, pressures, clutch and engine speed, from two decoders written apart."""
    sleeves = [0.04 * share - 0.02 for share in shares[:4]]
    pressures = [share * 1.3107e6 for share in shares[:2]]
    engine, bench = Transmitter(Node.ENGINE), Transmitter(Node.BENCH)
    io, ear = Transmitter(Node.GEARBOX_IO), guard_ear.GuardReceiver()
    frames = [
        io.encode(SleevesMain(stamp, 0, (sleeves[0],) + (0.0,) * 9, (sleeves[1],) + (0.0,) * 9)),
        io.encode(SleevesAux(stamp, 2, (sleeves[2],) + (0.0,) * 9, (sleeves[3],) + (0.0,) * 9)),
        io.encode(GearboxSensors(stamp, pressures[0], pressures[1], 300.0, shares[4])),
        io.encode(ValveStatus(stamp)),
        io.encode(EdgesMainRise(stamp, 40_000, 3, False, False, False, (7, 5, 3) + (0,) * 24)),
        engine.encode(
            EEC1(engine_speed_rad_s=800.0 * shares[0], actual_engine_torque_fraction=shares[1])
        ),
        bench.encode(TC1(requested_gear=11)),
    ]
    assert ear.take(frames, 0) == [stamp] * 5
    assert ear.slow[guard_ear.SLEEVES_MAIN].values == pytest.approx(sleeves[:2], abs=0.51e-6)
    assert ear.slow[guard_ear.SLEEVES_AUX].values == pytest.approx(sleeves[2:], abs=0.51e-6)
    assert ear.slow[guard_ear.SLEEVES_AUX].is_faulty
    assert not ear.slow[guard_ear.SLEEVES_MAIN].is_faulty
    heard = ear.slow[guard_ear.SENSORS].values
    assert heard[:2] == pytest.approx(pressures, abs=10.1)
    assert heard[2] == pytest.approx(shares[4], abs=0.51e-4)
    (edges,) = ear.edges[guard_ear.MAIN_EDGES]
    assert edges == (stamp, 40_000, (7, 5, 3))
    assert ear.engine == [pytest.approx((800.0 * shares[0], shares[1]), abs=0.0066)]
    speeds = [sleeve / 3e-3 for sleeve in sleeves[:2]]
    assert ear.slow[guard_ear.SLEEVES_MAIN].speeds_m_s == pytest.approx(speeds, abs=0.51e-3)
    assert ear.requested_gear == 11
