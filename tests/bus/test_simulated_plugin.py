"""The python-can interface `meshpoint_simulated`, used as other tools use a bus."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path

import can
import can.logger
import can.player
import pytest
from can.interfaces import BACKENDS
from patience import HANG_S

from meshpoint.bus.simulated.error_frames import ErrorClass
from meshpoint.bus.simulated.events import ErrorKind
from meshpoint.bus.simulated.plugin import SimulatedBus

_names = itertools.count()
FD = {"is_fd": True, "bitrate_switch": True}


@pytest.fixture
def channel() -> str:
    return f"test{next(_names)}"


@pytest.fixture
def pair(channel: str) -> Iterator[tuple[SimulatedBus, SimulatedBus]]:
    with SimulatedBus(channel) as first, SimulatedBus(channel) as second:
        yield first, second


def receive(bus: can.BusABC) -> can.Message:
    message = bus.recv(HANG_S)
    assert message is not None
    return message


def until_data(bus: can.BusABC) -> tuple[list[can.Message], can.Message]:
    """Error frames, and the first message that is none."""
    errors = []
    while (message := receive(bus)).is_error_frame:
        errors.append(message)
    return errors, message


def test_python_can_finds_it_by_its_entry_point(channel: str) -> None:
    assert "meshpoint_simulated" in entry_points(group="can.interface").names
    assert "meshpoint_simulated" in BACKENDS
    with can.Bus(interface="meshpoint_simulated", channel=channel, fd=True, bitrate=250_000) as bus:
        assert isinstance(bus, SimulatedBus)
        found = can.detect_available_configs("meshpoint_simulated")
        assert {"interface": "meshpoint_simulated", "channel": channel} in found
    assert {"interface": "meshpoint_simulated", "channel": channel} not in (
        can.detect_available_configs("meshpoint_simulated")
    )


@pytest.mark.parametrize(
    "message",
    [
        can.Message(arbitration_id=0x18FF1080, data=bytes(range(64)), **FD),
        can.Message(arbitration_id=0x123, is_extended_id=False, data=b"abc"),
        can.Message(arbitration_id=0x7FF, is_extended_id=False, is_remote_frame=True, dlc=5),
        can.Message(arbitration_id=1, data=b"", is_fd=True),
    ],
    ids=["fd", "standard", "remote", "empty"],
)
def test_a_message_arrives_as_it_was_sent(
    pair: tuple[SimulatedBus, SimulatedBus], message: can.Message
) -> None:
    began_s = time.time()
    pair[0].send(message)
    got = receive(pair[1])
    assert got.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)
    assert began_s - 1e-3 < got.timestamp < time.time()
    assert pair[0].recv(0.0) is None


def test_a_burst_takes_its_time_on_the_wire_and_goes_by_priority_between_nodes(
    channel: str,
) -> None:
    """125 kbit/s: a frame of eight bytes takes a millisecond, so that both have something to send
    when the first one is through."""
    buses = [SimulatedBus(channel, bitrate=125_000) for _ in range(3)]
    sent_s = {}
    for number in range(8):
        for node, can_id in ((0, 0x700), (1, 0x100)):
            data = bytes([node, number]) + b"\x55" * 6
            sent_s[node, number] = time.time()
            buses[node].send(can.Message(arbitration_id=can_id, data=data))
    given_s = time.time() - min(sent_s.values())
    got = [receive(buses[2]) for _ in range(16)]
    for bus in buses:
        bus.shutdown()
    gaps_s = [b.timestamp - a.timestamp for a, b in itertools.pairwise(got)]
    assert min(gaps_s) > 128 * 8e-6
    # The bus is idle only while this test, stopped by other work, gives it nothing to send.
    assert sum(gaps_s) < 15 * 160 * 8e-6 + given_s
    for k, (before, frame) in enumerate(itertools.pairwise(got)):
        if frame.arbitration_id == 0x700:
            later = [sent_s[1, m.data[1]] for m in got[k + 2 :] if m.arbitration_id == 0x100]
            assert all(time_s > before.timestamp - 1e-4 for time_s in later), k
    assert [m.data[1] for m in got if m.arbitration_id == 0x700] == list(range(8))


def test_error_frames_on_demand_and_the_frame_again(
    pair: tuple[SimulatedBus, SimulatedBus],
) -> None:
    sender, receiver = pair
    sender.destroy_frames(3, ErrorKind.CRC)
    sender.send(can.Message(arbitration_id=0x100, data=b"x"))
    errors, through = until_data(receiver)
    assert through.arbitration_id == 0x100
    assert len(errors) == 3
    for error in errors:
        assert error.arbitration_id & ErrorClass.BUS_ERROR
        assert error.data[3] == 0x08
    assert [error.data[7] for error in errors] == [1, 2, 3]
    assert sender.error_counters == (23, 0)
    assert receiver.error_counters == (0, 2)
    assert receiver.recv(0.0) is None


def test_an_error_frame_that_is_sent_destroys_the_next_frame(
    pair: tuple[SimulatedBus, SimulatedBus],
) -> None:
    sender, receiver = pair
    receiver.send(can.Message(is_error_frame=True))
    sender.send(can.Message(arbitration_id=0x100))
    errors, _ = until_data(receiver)
    assert len(errors) == 1
    assert receiver.error_counters == (0, 8)  # 1 + 8 for having seen it first, less 1


def test_a_node_that_fails_is_passive_then_bus_off_and_comes_back_when_reported(
    pair: tuple[SimulatedBus, SimulatedBus],
) -> None:
    sender, receiver = pair
    sender.destroy_frames(32, own_only=True)
    sender.send(can.Message(arbitration_id=0x100))
    classes: list[int] = []
    while not classes or not classes[-1] & ErrorClass.BUS_OFF:
        classes.append(receive(sender).arbitration_id)
    passive = [c for c in classes if c & ErrorClass.CONTROLLER]
    assert len(passive) == 2  # warning, passive
    assert sender.state is can.BusState.ERROR
    with pytest.raises(can.CanOperationError, match="bus-off"):
        sender.send(can.Message(arbitration_id=0x101))
    receiver.send(can.Message(arbitration_id=0x200))
    assert sender.recv(0.05) is None
    sender.state = can.BusState.ACTIVE
    assert receive(sender).arbitration_id & ErrorClass.RESTARTED
    assert sender.state is can.BusState.ACTIVE
    sender.send(can.Message(arbitration_id=0x102))
    assert until_data(receiver)[1].arbitration_id == 0x102  # nothing stale


def test_bus_off_on_demand_ends_after_restart_ms(channel: str) -> None:
    with SimulatedBus(channel, restart_ms=20) as bus, SimulatedBus(channel) as other:
        began_s = time.monotonic()
        bus.go_bus_off()
        assert receive(bus).arbitration_id & ErrorClass.BUS_OFF
        assert receive(bus).arbitration_id & ErrorClass.RESTARTED
        assert time.monotonic() - began_s > 0.020 + 128 * 11 * 2e-6
        bus.send(can.Message(arbitration_id=1))
        assert until_data(other)[1].arbitration_id == 1


def test_a_full_transmit_queue_waits_or_says_so(channel: str) -> None:
    with SimulatedBus(channel, tx_queue_size=2) as bus, SimulatedBus(channel) as other:
        bus.destroy_frames(20)
        message = can.Message(arbitration_id=1, data=bytes(8))
        with pytest.raises(can.CanTimeoutError, match="queue full"):
            for _ in range(10):
                bus.send(message, timeout=0.0)
        for _ in range(10):
            bus.send(message)  # waits
        assert until_data(other)[1].arbitration_id == 1


def test_a_reader_that_does_not_read_loses_the_newest_and_knows_it(channel: str) -> None:
    with SimulatedBus(channel) as bus, SimulatedBus(channel, rx_queue_size=3) as other:
        for number in range(6):
            bus.send(can.Message(arbitration_id=number))
        own = SimulatedBus(channel, receive_own_messages=True)
        own.send(can.Message(arbitration_id=0x1000))
        assert receive(own).arbitration_id in range(0x1001)
        while own.recv(0.02) is not None:
            pass
        own.shutdown()
        assert [receive(other).arbitration_id for _ in range(3)] == [0, 1, 2]
        assert other.frames_lost == 4


def test_a_notifier_hears_every_frame_of_cyclic_senders(channel: str) -> None:
    """Two tasks as `cangen` would run, a Notifier with a buffer and a callback."""
    with SimulatedBus(channel) as sender, SimulatedBus(channel) as listener:
        buffer, called = can.BufferedReader(), []
        notifier = can.Notifier(listener, [buffer, called.append], timeout=0.05)
        tasks = [
            sender.send_periodic(can.Message(arbitration_id=can_id, data=bytes(8)), 0.005)
            for can_id in (0x100, 0x200)
        ]
        deadline_s = time.monotonic() + HANG_S
        while len(called) < 40 and time.monotonic() < deadline_s:
            time.sleep(0.01)
        for task in tasks:
            task.stop()
        notifier.stop()
        got = [buffer.get_message(0.0) for _ in range(40)]
        assert {m.arbitration_id for m in got if m is not None} == {0x100, 0x200}


def test_a_notifier_works_in_an_event_loop(channel: str) -> None:
    async def listen() -> list[int]:
        with SimulatedBus(channel) as sender, SimulatedBus(channel) as listener:
            reader = can.AsyncBufferedReader()
            notifier = can.Notifier(listener, [reader], loop=asyncio.get_running_loop())
            for number in range(5):
                sender.send(can.Message(arbitration_id=number))
            got = [await asyncio.wait_for(reader.get_message(), HANG_S) for _ in range(5)]
            await asyncio.to_thread(notifier.stop)
            return [message.arbitration_id for message in got]

    assert asyncio.run(listen()) == [0, 1, 2, 3, 4]


def test_a_log_is_played_onto_it_and_recorded_from_it(channel: str, tmp_path: Path) -> None:
    """python-can's player and a logger's listener: what was recorded is what was played."""
    played, recorded = tmp_path / "played.log", tmp_path / "recorded.log"
    messages = [
        can.Message(timestamp=k * 1e-3, arbitration_id=k, data=bytes(8 * (k % 3)), **FD)
        for k in range(1, 30)
    ]
    with can.Logger(str(played)) as writer:
        for message in messages:
            writer(message)
    with SimulatedBus(channel) as listener, can.Logger(str(recorded)) as logger:
        heard: list[can.Message] = []
        notifier = can.Notifier(listener, [logger, heard.append], timeout=0.05)
        with SimulatedBus(channel) as sender:
            for message in can.MessageSync(can.LogReader(str(played)), timestamps=True):
                sender.send(message)
        # What the sender had handed over goes out although it has left.
        deadline_s = time.monotonic() + HANG_S
        while len(heard) < len(messages) and time.monotonic() < deadline_s:
            time.sleep(0.01)
        notifier.stop()
    found = [(m.arbitration_id, bytes(m.data)) for m in can.LogReader(str(recorded))]
    assert found == [(m.arbitration_id, bytes(m.data)) for m in messages]


@pytest.mark.parametrize(
    "options",
    [
        {"bitrate": 0}, {"bitrate": 333_333}, {"data_bitrate": 10**9}, {"queue": "lifo"},
        {"tx_queue_size": 0}, {"rx_queue_size": 0}, {"restart_ms": -1},
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(channel: str, options: dict[str, object]) -> None:
    with pytest.raises(can.CanInitializationError, match="allowed"):
        SimulatedBus(channel, **options)  # type: ignore[arg-type]


def test_all_nodes_of_a_channel_have_its_bit_rates(
    channel: str, pair: tuple[SimulatedBus, SimulatedBus]
) -> None:
    with pytest.raises(can.CanInitializationError, match=r"is open with bitrate 500000, .*250000"):
        SimulatedBus(channel, bitrate=250_000)


def test_bit_rates_may_come_as_a_bit_timing(channel: str) -> None:
    classic = can.BitTiming.from_sample_point(8_000_000, 125_000, 75.0)
    flexible = can.BitTimingFd.from_sample_point(80_000_000, 125_000, 80.0, 2_000_000, 80.0)
    with SimulatedBus(channel, bitrate=125_000):
        for timing in (classic, flexible):
            SimulatedBus(channel, timing=timing).shutdown()


def test_a_bus_that_is_shut_down_says_so(channel: str) -> None:
    bus = SimulatedBus(channel)
    bus.shutdown()
    bus.shutdown()
    with pytest.raises(can.CanOperationError, match="shut down"):
        bus.send(can.Message())
    with pytest.raises(can.CanOperationError, match="shut down"):
        bus.recv(0.0)
    with pytest.raises(ValueError):
        bus.destroy_frames(0)


def test_what_no_bus_carries_is_refused(pair: tuple[SimulatedBus, SimulatedBus]) -> None:
    with pytest.raises(ValueError):
        pair[0].send(can.Message(arbitration_id=1 << 29, check=False))
    pair[0].send(can.Message(arbitration_id=1, data=bytes(10), is_fd=True, check=False))
    assert len(receive(pair[1]).data) == 12
