"""A live node: any core, on any python-can bus."""

import asyncio
import errno
import itertools
import re
import subprocess
import threading
import time
from collections.abc import Callable
from typing import Any

import can
import pytest
from fake_time import FakeTimeLoop, QuietBus, run_in_fake_time
from patience import HANG_S, until_async

from meshpoint.bus.clock import Clock
from meshpoint.bus.core import Step
from meshpoint.bus.driver import run_node
from meshpoint.bus.local.plugin import MeshpointBus
from meshpoint.bus.statistics import NodeStatistics
from meshpoint.dbc.frame import Frame

PERIOD_US = 10_000
LAST = Frame(0x18FF0001, b"off")

channels = (f"driver-test-{number}" for number in itertools.count())


class Metronome:
    """A core that sends the number of its step every 10 ms, and keeps what it is told."""

    def __init__(self, address: int = 1) -> None:
        self.address = address
        self.next_step_us = 0
        self.times_us: list[int] = []
        self.received: list[Frame] = []
        self.shut_down = 0

    def receive(self, frame: Frame) -> None:
        self.received.append(frame)

    def step(self, now_us: int) -> Step:
        assert not self.shut_down, "stepped after its end"
        self.times_us.append(now_us)
        self.next_step_us += PERIOD_US
        data = len(self.times_us).to_bytes(8, "big")
        return Step([Frame(0x18FF0000 | self.address, data)], [])

    def shutdown(self, now_us: int) -> Step:
        self.shut_down += 1
        return Step([LAST], ["valves off"])


class Counting(Metronome):
    """Tells when it has made so many steps."""

    def __init__(self, steps: int) -> None:
        super().__init__()
        self.steps = steps
        self.made = asyncio.Event()

    def step(self, now_us: int) -> Step:
        step = super().step(now_us)
        if len(self.times_us) == self.steps:
            self.made.set()
        return step


class Responder(Metronome):
    """Wants to be stepped at once when a frame comes, and answers it then; else sleeps."""

    def step(self, now_us: int) -> Step:
        self.times_us.append(now_us)
        self.next_step_us = now_us + 60_000_000
        answers = [Frame(0x18FF0002, frame.data) for frame in self.received]
        self.received.clear()
        return Step(answers, [])

    def receive(self, frame: Frame) -> None:
        self.received.append(frame)
        self.next_step_us = 0


class ScriptedBus(can.BusABC):
    """A bus without file descriptor, whose messages and errors a test decides."""

    def __init__(
        self, messages: tuple[can.Message, ...] = (), send_error: Exception | None = None
    ) -> None:
        self.messages = list(messages)
        self.send_error = send_error
        self.sent: list[can.Message] = []
        super().__init__(channel="scripted")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.messages:
            return self.messages.pop(0), True
        time.sleep(min(timeout or 0.0, 0.01))
        return None, True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.send_error is not None:
            raise self.send_error
        self.sent.append(msg)


class Run:
    """A node running in the background of a test."""

    def __init__(self, core: Any, open_bus: Callable[[], can.BusABC], **options: Any) -> None:
        self.core = core
        self.events: list[str] = []
        self.stop = asyncio.Event()
        self.statistics = NodeStatistics()
        self.task = asyncio.ensure_future(
            run_node(
                core,
                open_bus,
                options.pop("clock", None) or Clock(),
                on_event=self.events.append,
                stop=self.stop,
                name="node",
                statistics=self.statistics,
                **options,
            )
        )

    async def until(self, condition: Callable[[], object]) -> None:
        def holds() -> object:
            assert not self.task.done(), self.task
            return condition()

        await until_async(holds, "what the node should come to", say=lambda: self.events)

    async def end(self, limit_s: float | None = HANG_S) -> NodeStatistics:
        self.stop.set()
        return await asyncio.wait_for(self.task, limit_s)

    async def end_in_fake_time(self) -> NodeStatistics:
        """Without a limit: it would come at once while a thread closes the bus."""
        return await self.end(None)


def virtual(channel: str) -> can.BusABC:
    return can.Bus(channel=channel, interface="virtual", ignore_config=True)


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
async def test_a_reopened_bus_that_carries_nothing_is_not_called_back(
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


@pytest.mark.parametrize(
    "error",
    [
        can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS),
        can.CanOperationError("Transmit buffer full"),
        can.CanTimeoutError("the hub takes no frames"),
        can.CanOperationError("Failed to transmit: Invalid argument", errno.EINVAL),
    ],
)
def test_a_frame_that_the_bus_refuses_is_dropped_and_the_node_goes_on(error: Exception) -> None:
    """Said once a second: 250 refusals in 2.5 s, by a time in which steps are never late."""

    async def two_and_a_half_seconds(loop: FakeTimeLoop) -> tuple[Run, list[str]]:
        bus = QuietBus(send_error=error)
        node = Run(Counting(250), lambda: bus, clock=Clock(source_ns=loop.time_ns))
        await node.core.made.wait()
        refusals = [event for event in node.events if "not sent" in event]
        assert node.statistics.frames_refused == 250
        bus.send_error = None
        await asyncio.sleep(0.015)
        assert bus.sent
        await node.end_in_fake_time()
        return node, refusals

    node, refusals = run_in_fake_time(two_and_a_half_seconds)
    assert node.statistics.outages == 0
    assert len(refusals) == 3
    assert all(str(error) in refusal for refusal in refusals)


def test_every_refused_frame_is_told_of_soon_or_at_the_end() -> None:
    """Forty in the first 0.4 s, of which the first is told at once; the others within a second,
    though no further one is refused. And what is refused last, before the node ends."""
    full = can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS)

    async def bursts(loop: FakeTimeLoop) -> tuple[Run, int]:
        bus = QuietBus(send_error=full)
        node = Run(Metronome(), lambda: bus, clock=Clock(source_ns=loop.time_ns))
        while node.statistics.frames_refused < 40:
            await asyncio.sleep(0.005)
        bus.send_error = None
        await asyncio.sleep(1.5)
        told = len(counts_told(node))
        bus.send_error = full
        await node.end_in_fake_time()
        return node, told

    def counts_told(node: Run) -> list[list[str]]:
        refusals = [event for event in node.events if "not sent" in event]
        return [re.findall(r"\d+", refusal)[-2:] for refusal in refusals]

    node, told = run_in_fake_time(bursts)
    assert counts_told(node) == [["1", "1"], ["39", "40"], ["1", "41"]]
    assert told == 2


class SocketcanBus(ScriptedBus):
    """Under the name of python-can's: its error frames are the kernel's."""


@pytest.mark.asyncio
@pytest.mark.parametrize("kind", [SocketcanBus, ScriptedBus])
async def test_a_bus_off_is_told_with_the_way_back_where_the_kernel_tells_it(
    kind: type[ScriptedBus],
) -> None:
    """Classes 0x040 and 0x100 of linux/can/error.h; other interfaces mean other things by them."""
    frames = [
        can.Message(arbitration_id=error_class, is_error_frame=True, is_extended_id=False)
        for error_class in (0x044, 0x040, 0x100)
    ]
    seen: list[can.Message] = []
    node = Run(Metronome(), lambda: kind(messages=tuple(frames)), on_message=seen.append)
    await node.until(lambda: len(seen) == 3)
    counted = await node.end()
    told = [event for event in node.events if "bus-off" in event]
    if kind is ScriptedBus:
        assert (counted.bus_offs, told) == (0, [])
        return
    assert counted.bus_offs == 2
    assert len(told) == 2, "two within a second are told once"
    assert "With restart-ms 0 it never does by itself" in told[0]
    assert "restarted after bus-off (2 so far)" in told[1]


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
    node = Run(Metronome(), lambda: bus, own_addresses=frozenset({1, 7}), on_message=seen.append)
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
    assert (counted.error_frames, counted.remote_frames, counted.own_address_frames) == (2, 2, 2)
    assert counted.frames_received == 4
    told = [event for event in node.events if "on the bus" in event]
    assert len(told) == 3


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
