"""What a live node does and says where its bus takes no frames, or its controller is bus-off."""

import asyncio
import errno
import re

import can
import pytest
from driver_parts import Counting, Metronome, Run, ScriptedBus
from fake_time import FakeTimeLoop, QuietBus, run_in_fake_time

from meshpoint.bus.clock import Clock


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
    """Forty in the first 0.4 s, of which the first is reported at once; the others within a second,
    though no further one is refused. And what is refused last, before the node ends."""
    full = can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS)

    async def bursts(loop: FakeTimeLoop) -> tuple[Run, int]:
        bus = QuietBus(send_error=full)
        node = Run(Metronome(), lambda: bus, clock=Clock(source_ns=loop.time_ns))
        while node.statistics.frames_refused < 40:
            await asyncio.sleep(0.005)
        bus.send_error = None
        await asyncio.sleep(1.5)
        reported = len(counts_reported(node))
        bus.send_error = full
        await node.end_in_fake_time()
        return node, reported

    def counts_reported(node: Run) -> list[list[str]]:
        refusals = [event for event in node.events if "not sent" in event]
        return [re.findall(r"\d+", refusal)[-2:] for refusal in refusals]

    node, reported = run_in_fake_time(bursts)
    assert counts_reported(node) == [["1", "1"], ["39", "40"], ["1", "41"]]
    assert reported == 2


class SocketcanBus(ScriptedBus):
    """Under the name of python-can's: its error frames are the kernel's."""


@pytest.mark.asyncio
@pytest.mark.parametrize("kind", [SocketcanBus, ScriptedBus])
async def test_a_bus_off_is_reported_with_the_way_back_where_the_kernel_tells_it(
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
    reported = [event for event in node.events if "bus-off" in event]
    if kind is ScriptedBus:
        assert (counted.bus_offs, reported) == (0, [])
        return
    assert counted.bus_offs == 2
    assert len(reported) == 2, "two within a second are reported once"
    assert "With restart-ms 0 it never does by itself" in reported[0]
    assert "restarted after bus-off (2 so far)" in reported[1]
