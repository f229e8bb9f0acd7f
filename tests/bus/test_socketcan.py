"""A node on real SocketCAN, on a virtual device of its own."""

import argparse
import asyncio
import itertools
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest
from patience import until_async

from meshpoint.bus.clock import Clock
from meshpoint.bus.core import Step
from meshpoint.bus.driver import run_node
from meshpoint.bus.logs.reader import read_log
from meshpoint.bus.options import add_bus_arguments, open_bus_from
from meshpoint.bus.statistics import NodeStatistics
from meshpoint.dbc.frame import Frame

pytestmark = pytest.mark.device
DEVICE = "vcan-mp"


def ip(*arguments: str) -> None:
    subprocess.run(["ip", "link", *arguments], check=True, capture_output=True, text=True)


def create() -> None:
    ip("add", "dev", DEVICE, "type", "vcan")
    ip("set", DEVICE, "mtu", "72", "up")


@pytest.fixture
def device() -> Iterator[str]:
    try:
        create()
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no virtual CAN device can be made here: {getattr(error, 'stderr', error)}")
    yield DEVICE
    subprocess.run(["ip", "link", "del", DEVICE], check=False, capture_output=True)


def opener(device: str) -> Callable[[], can.BusABC]:
    parser = argparse.ArgumentParser()
    add_bus_arguments(parser)
    namespace = parser.parse_args(["-i", "socketcan", "-c", device])
    return lambda: open_bus_from(namespace)


class Talker:
    """Sends a 48-byte FD frame and a classic one every 10 ms; keeps what it hears."""

    def __init__(self, address: int) -> None:
        self.address = address
        self.next_step_us = 0
        self.heard: list[Frame] = []
        self.numbers = itertools.count()

    def receive(self, frame: Frame) -> None:
        self.heard.append(frame)

    def step(self, now_us: int) -> Step:
        self.next_step_us = now_us + 10_000
        data = next(self.numbers).to_bytes(8, "big")
        identifier = 0x18FF0000 | self.address
        return Step([Frame(identifier, data * 6), Frame(identifier, data, is_fd=False)], [])

    def shutdown(self, now_us: int) -> Step:
        return Step([], [])


def listens(device: str) -> bool:
    """Whether somebody takes all frames of the device, as the kernel's table says."""
    table = Path("/proc/net/can/rcvlist_all")
    return table.exists() and device in table.read_text()


@pytest.mark.asyncio
async def test_nodes_on_socketcan_survive_a_link_that_goes_down_and_a_device_that_is_replaced(
    device: str,
) -> None:
    stop = asyncio.Event()
    talkers = [Talker(1), Talker(2)]
    events: list[str] = []
    counts = [NodeStatistics(), NodeStatistics()]
    nodes = [
        asyncio.ensure_future(
            run_node(
                talker,
                opener(device),
                Clock(),
                on_event=events.append,
                stop=stop,
                name=f"node {talker.address}",
                own_addresses=frozenset({talker.address}),
                statistics=count,
            )
        )
        for talker, count in zip(talkers, counts, strict=True)
    ]

    def back() -> int:
        return sum("bus is back" in event for event in events)

    await until_async(
        lambda: all(len(talker.heard) > 50 for talker in talkers),
        "fifty frames each",
        say=lambda: events,
    )
    heard = talkers[0].heard
    assert {(f.can_id, len(f.data), f.is_fd, f.is_extended) for f in heard} == {
        (0x18FF0002, 48, True, True),
        (0x18FF0002, 8, False, True),
    }
    numbers = [int.from_bytes(frame.data[:8], "big") for frame in heard]
    assert numbers == sorted(numbers)

    ip("set", device, "down")
    await until_async(
        lambda: all(count.outages == 1 for count in counts), "the bus lost", say=lambda: events
    )
    await asyncio.sleep(1.2)  # reopened meanwhile, in vain
    assert back() == 0
    ip("set", device, "up")
    await until_async(lambda: back() == 2, "both back", say=lambda: events)

    ip("del", device)
    await until_async(
        lambda: all(count.outages == 2 for count in counts), "the bus lost", say=lambda: events
    )
    create()
    await until_async(lambda: back() == 4, "both back", say=lambda: events)
    before = [len(talker.heard) for talker in talkers]
    await until_async(
        lambda: all(len(t.heard) > n + 20 for t, n in zip(talkers, before, strict=True)),
        "frames of the new device",
        say=lambda: events,
    )

    stop.set()
    await asyncio.gather(*nodes)
    assert sum("bus lost" in event for event in events) == 4


@pytest.mark.asyncio
async def test_a_log_of_candump_holds_what_a_node_sent(
    device: str, tmp_path: Path, start: Callable[..., subprocess.Popen[str]]
) -> None:
    if shutil.which("candump") is None:
        pytest.skip("candump is not installed")
    log = tmp_path / "candump.log"
    with log.open("w") as output:
        candump = subprocess.Popen(["stdbuf", "-oL", "candump", "-L", device], stdout=output)
    await until_async(lambda: listens(device), "candump on the device")
    stop, counts = asyncio.Event(), NodeStatistics()
    node = asyncio.ensure_future(
        run_node(
            Talker(1),
            opener(device),
            Clock(),
            on_event=print,
            stop=stop,
            name="node",
            statistics=counts,
        )
    )
    await until_async(lambda: counts.frames_sent >= 200, "200 frames")
    stop.set()
    await node

    def lines() -> int:
        return log.read_bytes().count(b"\n")

    await until_async(lambda: lines() >= counts.frames_sent, "all of them in the log", say=lines)
    candump.terminate()
    candump.wait()
    frames = [frame for _, frame in read_log(log)]
    assert len(frames) == counts.frames_sent
    assert [len(frame.data) for frame in frames[:4]] == [48, 8, 48, 8]
    assert all(frame.can_id == 0x18FF0001 for frame in frames)
