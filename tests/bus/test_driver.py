"""A live node: any core, on any python-can bus."""

import asyncio
import errno
import itertools
import subprocess
import threading
import time

import can
import pytest
from driver_parts import LAST, PERIOD_US, Counting, Metronome, Responder, Run, ScriptedBus, virtual
from fake_time import FakeTimeLoop, QuietBus, run_in_fake_time
from patience import HANG_S

from meshpoint.bus.clock import Clock
from meshpoint.bus.core import Step
from meshpoint.bus.local.plugin import MeshpointBus
from meshpoint.dbc.frame import Frame

channels = (f"driver-test-{number}" for number in itertools.count())


@pytest.mark.asyncio
async def test_two_nodes_on_a_virtual_bus_hear_every_frame_of_each_other() -> None:
    channel = next(channels)
    first = Run(Metronome(1), lambda: virtual(channel))
    second = Run(Metronome(2), lambda: virtual(channel))
    await second.until(lambda: len(second.core.received) > 20 and len(first.core.received) > 20)
    counted = await first.end()
    await second.until(lambda: LAST in second.core.received)
    await second.end()
    heard = [frame for frame in second.core.received if frame != LAST]
    assert [int.from_bytes(frame.data, "big") for frame in heard] == list(
        range(counted.steps - len(heard) + 1, counted.steps + 1)
    )
    assert all(frame.is_fd and frame.is_extended for frame in heard)
    assert counted.frames_sent == counted.steps + 1
    assert first.events == ["node: valves off"]


@pytest.mark.parametrize("speed", [0.5, 1.0, 4.0])
def test_steps_come_at_their_times_by_a_clock_of_any_speed(speed: float) -> None:
    async def hundred_steps(loop: FakeTimeLoop) -> tuple[Run, float]:
        clock = Clock(speed, source_ns=loop.time_ns)
        node = Run(Counting(100), QuietBus, clock=clock)
        await node.core.made.wait()
        passed_s = loop.time()
        await node.end_in_fake_time()
        return node, passed_s

    node, passed_s = run_in_fake_time(hundred_steps)
    times_us = node.core.times_us
    assert all(type(now_us) is int for now_us in times_us)
    # A step is never early; a clock of whole microseconds may be one of them late.
    late_us = [now_us - index * PERIOD_US for index, now_us in enumerate(times_us)]
    assert min(late_us) >= 0
    assert max(late_us) <= 1
    assert passed_s == pytest.approx(99 * 0.01 / speed, abs=2e-6)
    assert node.statistics.lateness_us.total == len(times_us) == node.statistics.steps
    assert node.statistics.lateness_us.maximum <= 1 / speed


@pytest.mark.asyncio
async def test_a_core_that_asks_for_it_is_stepped_as_soon_as_a_frame_has_come() -> None:
    channel = next(channels)
    node = Run(Responder(), lambda: virtual(channel))
    with virtual(channel) as peer:
        await node.until(lambda: node.core.times_us)
        peer.send(can.Message(arbitration_id=5, data=b"\x07", is_fd=True))
        answer = await asyncio.to_thread(peer.recv, HANG_S)
    assert answer is not None
    assert bytes(answer.data) == b"\x07"
    await node.end()


@pytest.mark.asyncio
async def test_a_hub_that_dies_is_reported_and_replaced_and_nothing_stale_is_sent(
    hub: tuple[str, subprocess.Popen[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    channel, process = hub
    away = threading.Event()

    def open_bus() -> can.BusABC:
        if away.is_set():
            raise can.CanInitializationError("not yet")
        return MeshpointBus(channel)

    monkeypatch.setattr("meshpoint.bus.driver.RECONNECT_S", 0.01)
    node = Run(Metronome(), open_bus)
    await node.until(lambda: node.statistics.frames_sent > 10)
    away.set()
    process.kill()
    await node.until(lambda: node.statistics.frames_discarded > 20)
    steps_before = node.statistics.steps
    with MeshpointBus(channel) as listener:
        away.clear()
        first = await asyncio.to_thread(listener.recv, HANG_S)
        await node.end()
    assert first is not None
    assert int.from_bytes(first.data, "big") > steps_before, "made while there was no bus"
    assert node.statistics.outages == 1
    lost, still, back, off = node.events
    assert "bus lost" in lost
    assert "lost the hub" in lost
    assert "bus still away: not yet" in still
    assert "bus is back" in back
    assert off == "node: valves off"


@pytest.mark.asyncio
async def test_a_node_whose_bus_is_away_ends_at_once(
    hub: tuple[str, subprocess.Popen[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    channel, process = hub
    node = Run(Metronome(), lambda: MeshpointBus(channel, start_hub=False))
    await node.until(lambda: node.statistics.frames_sent)
    monkeypatch.setattr("meshpoint.bus.driver.RECONNECT_S", 0.01)
    process.kill()
    await node.until(lambda: any("bus still away" in event for event in node.events))
    monkeypatch.setattr("meshpoint.bus.driver.RECONNECT_S", 1000.0)
    await asyncio.sleep(0.1)
    await node.end()
    assert sum("bus still away" in event for event in node.events) == 1
    assert node.core.shut_down == 1


@pytest.mark.asyncio
async def test_a_reopened_bus_that_carries_nothing_is_not_recalled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("meshpoint.bus.driver.RECONNECT_S", 0.05)
    down = can.CanOperationError("Failed to transmit: Network is down", errno.ENETDOWN)
    buses = [ScriptedBus(), ScriptedBus(send_error=down), ScriptedBus(send_error=down)]
    opened: list[ScriptedBus] = []

    def open_bus() -> can.BusABC:
        opened.append(buses[min(len(opened), 2)])
        return opened[-1]

    node = Run(Metronome(), open_bus)
    await node.until(lambda: node.statistics.frames_sent)
    buses[0].send_error = down
    await node.until(lambda: len(opened) >= 3)
    assert [event for event in node.events if "bus" in event] == [
        f"node: bus lost: {down}; trying again every 0.05 s"
    ]
    buses[2].send_error = None
    await node.until(lambda: any("bus is back" in event for event in node.events))
    await node.end()


@pytest.mark.asyncio
async def test_only_data_frames_of_others_reach_the_core() -> None:
    frames = (
        can.Message(arbitration_id=0x40, is_error_frame=True, is_extended_id=False),
        can.Message(arbitration_id=0x18FF0003, is_remote_frame=True, dlc=8),
        can.Message(arbitration_id=0x18FF0001, data=b"echo", is_fd=True, is_rx=True),
        can.Message(arbitration_id=0x101, data=b"std", is_extended_id=False),
        can.Message(arbitration_id=0x18FF0003, data=b"other", is_rx=False),
    )
    bus = ScriptedBus(messages=frames * 2)
    seen: list[can.Message] = []
    own: list[Frame] = []
    node = Run(
        Metronome(), lambda: bus,
        own_addresses=frozenset({1, 7}), on_message=seen.append, on_own=own.append,
    )  # fmt: skip
    await node.until(lambda: len(seen) == 10)
    counted = await node.end()
    assert (
        node.core.received
        == [
            Frame(0x101, b"std", is_fd=False, is_extended=False),
            Frame(0x18FF0003, b"other", is_fd=False),
        ]
        * 2
    )
    assert own == [Frame(0x18FF0001, b"echo")] * 2
    assert (counted.error_frames, counted.remote_frames, counted.own_address_frames) == (2, 2, 2)
    assert counted.frames_received == 4
    reported = [event for event in node.events if "on the bus" in event]
    assert len(reported) == 3


@pytest.mark.asyncio
async def test_an_error_in_the_core_ends_the_node_with_valves_off() -> None:
    class Broken(Metronome):
        def step(self, now_us: int) -> Step:
            if len(self.times_us) == 3:
                raise ZeroDivisionError("a bug")
            return super().step(now_us)

    bus = ScriptedBus()
    node = Run(Broken(), lambda: bus)
    with pytest.raises(ZeroDivisionError):
        await asyncio.wait_for(node.task, HANG_S)
    assert [bytes(message.data) for message in bus.sent][-1] == LAST.data


@pytest.mark.asyncio
async def test_a_cancelled_node_ends_with_valves_off() -> None:
    bus = ScriptedBus()
    node = Run(Metronome(), lambda: bus)
    await node.until(lambda: bus.sent)
    node.task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await node.task
    assert bytes(bus.sent[-1].data) == LAST.data


@pytest.mark.asyncio
async def test_a_bus_that_cannot_be_opened_at_all_is_the_callers_error() -> None:
    def open_bus() -> can.BusABC:
        raise can.CanInitializationError("no such device")

    node = Run(Metronome(), open_bus)
    with pytest.raises(can.CanInitializationError, match="no such device"):
        await node.task
    assert node.core.times_us == []


@pytest.mark.device
@pytest.mark.asyncio
async def test_udp_multicast_carries_frames_between_nodes() -> None:
    pytest.importorskip("msgpack", reason="udp_multicast needs msgpack")
    port = 40_000 + time.time_ns() % 20_000

    def open_bus() -> can.BusABC:
        return can.Bus(
            interface="udp_multicast",
            channel="239.74.163.2",
            port=port,
            hop_limit=0,
            ignore_config=True,
        )

    try:
        with open_bus() as probe:
            probe.send(can.Message(arbitration_id=1))
            if probe.recv(1.0) is None:
                pytest.skip("multicast is not looped back here (no route for 224.0.0.0/4?)")
    except can.CanError as error:
        pytest.skip(f"no multicast on this machine: {error}")
    first = Run(Metronome(1), open_bus, own_addresses=frozenset({1}))
    second = Run(Metronome(2), open_bus, own_addresses=frozenset({2}))
    await first.until(lambda: len(first.core.received) > 10 and len(second.core.received) > 10)
    await first.end()
    await second.end()
    assert first.statistics.own_address_frames > 10
    assert {frame.can_id for frame in first.core.received} == {0x18FF0002}
