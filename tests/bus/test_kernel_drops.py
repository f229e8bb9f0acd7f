"""What the kernel throws away is counted and reported."""

from __future__ import annotations

import asyncio
import socket
import struct
import sys
from typing import Any

import can
import pytest

from meshpoint.bus.clock import Clock
from meshpoint.bus.core import Step
from meshpoint.bus.driver import run_node
from meshpoint.bus.kernel_drops import (
    SO_RXQ_OVFL,
    CountingSocket,
    count_lost_frames,
    lost_frames,
)
from meshpoint.bus.statistics import NodeStatistics
from meshpoint.dbc.frame import Frame

SENT = 400
SIZE = 512


def answering_socket(counts: list[int | None]) -> Any:
    """A socket whose messages carry a time stamp, and these counts of lost ones."""

    class Answering(socket.socket):
        def setsockopt(self, *_: Any) -> None:
            """Takes what the system may not know."""

        def recvmsg(self, size: int, ancillary_bytes: int = 0, flags: int = 0) -> Any:
            assert (size, flags) == (72, 0)
            assert ancillary_bytes >= 32 + socket.CMSG_SPACE(4)
            stamp = (socket.SOL_SOCKET, 35, bytes(16))
            count = counts.pop(0)
            lost = [] if count is None else [count]
            reported = [(socket.SOL_SOCKET, SO_RXQ_OVFL, struct.pack("=I", n)) for n in lost]
            return b"frame", [stamp, *reported], 0, ("vcan0",)

    return Answering(socket.AF_UNIX, socket.SOCK_DGRAM)


def test_the_count_is_taken_out_and_added_up() -> None:
    with answering_socket([None, 3, 3, 10, (1 << 32) - 1, 4]) as inner:
        counting = CountingSocket(inner)
        found = []
        for _ in range(6):
            data, ancillary, flags, address = counting.recvmsg(72, 32)
            assert (data, flags, address) == (b"frame", 0, ("vcan0",))
            assert ancillary == [(socket.SOL_SOCKET, 35, bytes(16))], "what python-can asked for"
            found.append(counting.lost)
        assert found == [0, 3, 3, 10, (1 << 32) - 1, (1 << 32) + 4]
        assert counting.fileno() == inner.fileno()


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux counts them")
def test_the_kernel_itself_tells_what_it_lost() -> None:
    """On a socket of another family than CAN, which every machine has."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reader,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        reader.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        reader.bind(("127.0.0.1", 0))
        reader.settimeout(5.0)
        counting = CountingSocket(reader)
        for number in range(SENT):
            sender.sendto(number.to_bytes(2, "big") * (SIZE // 2), reader.getsockname())
        reader.setblocking(False)
        got = 0
        with pytest.raises(BlockingIOError):
            while True:
                counting.recvmsg(SIZE)
                got += 1
        # The next one carries the count of those lost before it.
        sender.sendto(b"last", reader.getsockname())
        reader.settimeout(5.0)
        counting.recvmsg(SIZE)
        assert 0 < got < SENT
        assert counting.lost == SENT - got


class CountedBus(can.BusABC):
    """A bus whose socket says what was lost."""

    def __init__(self, counts: list[int | None]) -> None:
        self.socket = answering_socket(counts)
        self._counts = counts
        count_lost_frames(self)
        super().__init__(channel="counted")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._counts:
            return None, True
        self.socket.recvmsg(72, 32)
        return can.Message(arbitration_id=0x18FF0001), True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Goes nowhere."""

    def fileno(self) -> int:
        return int(self.socket.fileno())

    def shutdown(self) -> None:
        super().shutdown()
        self.socket.close()


class Listener:
    """A core that looks at its bus every millisecond."""

    next_step_us = 0

    def receive(self, frame: Frame) -> None:
        """Nothing of it matters."""

    def step(self, now_us: int) -> Step:
        self.next_step_us = now_us + 1_000
        return Step([], [])

    def shutdown(self, now_us: int) -> Step:
        return Step([], [])


@pytest.mark.asyncio
async def test_a_node_counts_and_tells_what_the_kernel_lost() -> None:
    events: list[str] = []
    stop, statistics = asyncio.Event(), NodeStatistics()
    buses: list[can.BusABC] = []

    def open_bus() -> can.BusABC:
        buses.append(CountedBus([None, 7, 7, 19, 19]))
        return buses[-1]

    node = asyncio.ensure_future(
        run_node(
            Listener(),
            open_bus,
            Clock(),
            on_event=events.append,
            stop=stop,
            name="node",
            statistics=statistics,
        )
    )
    while statistics.frames_received < 5:
        await asyncio.sleep(0.005)
    assert lost_frames(buses[0]) == 19
    stop.set()
    await node
    assert statistics.frames_lost == 19
    (said,) = [event for event in events if "lost in the kernel" in event]
    assert said.startswith("node: 19 frames lost in the kernel (19 so far)")
