"""The python-can interface `meshpoint`."""

import asyncio
import select
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import can
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from patience import HANG_S, until_async

from meshpoint.bus.local.plugin import MeshpointBus
from meshpoint.bus.local.wire import FD_LENGTHS

Join = Callable[..., MeshpointBus]


@st.composite
def messages(draw: st.DrawFn) -> can.Message:
    """Every kind of message that exists on a CAN bus."""
    extended = draw(st.booleans())
    kind = draw(st.sampled_from(["fd", "data", "remote", "error"]))
    length = draw(st.sampled_from(sorted(FD_LENGTHS)) if kind == "fd" else st.integers(0, 8))
    return can.Message(
        arbitration_id=draw(st.integers(0, (1 << (29 if extended else 11)) - 1)),
        is_extended_id=extended,
        is_fd=kind == "fd",
        bitrate_switch=kind == "fd" and draw(st.booleans()),
        error_state_indicator=kind == "fd" and draw(st.booleans()),
        is_remote_frame=kind == "remote",
        is_error_frame=kind == "error",
        dlc=length,
        data=None if kind == "remote" else draw(st.binary(min_size=length, max_size=length)),
    )


def test_every_kind_of_message_arrives_as_it_was_sent(join: Join) -> None:
    sender, receiver = join(), join()

    @given(st.lists(messages(), min_size=1, max_size=20), st.booleans())
    @settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
    def check(batch: list[can.Message], drained: bool) -> None:
        began_s = time.time_ns() // 1000 / 1e6  # as the hub stamps, in whole microseconds
        for message in batch:
            sender.send(message)
        received: list[can.Message] = []
        while len(received) < len(batch):
            if drained:
                received += receiver.drain()
            else:
                message_or_none = receiver.recv(HANG_S)
                assert message_or_none is not None
                received.append(message_or_none)
        for before, after in zip(batch, received, strict=True):
            assert after.equals(before, timestamp_delta=None, check_channel=False)
            assert began_s <= after.timestamp <= time.time()

    check()


def test_the_descriptor_is_readable_exactly_while_messages_wait(join: Join) -> None:
    sender, receiver = join(), join()
    for number in range(5):
        sender.send(can.Message(arbitration_id=number, data=bytes(8)))
    for number in range(5):
        assert select.select([receiver], [], [], HANG_S)[0], f"message {number} is hidden"
        message = receiver.recv(0.0)
        assert message is not None
        assert message.arbitration_id == number
    assert not select.select([receiver], [], [], 0.0)[0]
    assert receiver.recv(0.0) is None
    assert receiver.drain() == []


@pytest.mark.asyncio
async def test_a_notifier_in_an_event_loop_gets_every_message_without_delay(join: Join) -> None:
    sender, receiver = join(), join()
    got: list[can.Message] = []
    notifier = can.Notifier(receiver, [got.append], loop=asyncio.get_running_loop())
    for number in range(50):
        sender.send(can.Message(arbitration_id=number))
    await until_async(lambda: len(got) == 50, "every message")
    notifier.stop()
    assert [message.arbitration_id for message in got] == list(range(50))


def test_filters_apply_to_single_messages_and_to_drained_ones(join: Join) -> None:
    sender, receiver = join(), join()
    receiver.set_filters([{"can_id": 0x100, "can_mask": 0x700, "extended": True}])
    for number in (0x0FF, 0x100, 0x2FF, 0x1FF, 0x000, 0x101):
        sender.send(can.Message(arbitration_id=number))
    first = receiver.recv(HANG_S)
    assert first is not None
    found = [first.arbitration_id]
    while len(found) < 3:
        found += [message.arbitration_id for message in receiver.drain()]
    assert found == [0x100, 0x1FF, 0x101]


@pytest.mark.parametrize(
    "message",
    [
        can.Message(arbitration_id=0x800, is_extended_id=False),
        can.Message(arbitration_id=1 << 29),
        can.Message(arbitration_id=1, data=bytes(9)),
        can.Message(arbitration_id=1, data=bytes(10), is_fd=True),
        can.Message(arbitration_id=1, data=bytes(4), dlc=8),
        can.Message(arbitration_id=1, is_fd=True, is_remote_frame=True),
    ],
)
def test_a_frame_that_no_bus_could_carry_is_refused_and_harms_nobody(
    join: Join, message: can.Message
) -> None:
    sender, receiver = join(), join()
    with pytest.raises(ValueError, match="0x"):
        sender.send(message)
    sender.send(can.Message(arbitration_id=2))
    received = receiver.recv(HANG_S)
    assert received is not None
    assert received.arbitration_id == 2


def test_a_hub_that_goes_away_is_an_operation_error_for_sender_and_receiver(
    hub: tuple[str, subprocess.Popen[str]], join: Join
) -> None:
    receiver, sender, drainer = (join(hub[0]) for _ in range(3))
    hub[1].kill()
    with pytest.raises(can.CanOperationError, match="hub"):
        receiver.recv(HANG_S)
    with pytest.raises(can.CanOperationError, match="not connected"):
        receiver.recv(0.0)
    with pytest.raises(can.CanOperationError):
        drainer.drain()
    with pytest.raises(can.CanOperationError):
        while True:  # what is sent while the hub dies may be accepted yet
            sender.send(can.Message(arbitration_id=1))
            time.sleep(0.001)


def test_what_a_stopped_hub_does_not_take_is_kept_until_the_buffer_is_full(
    hub: tuple[str, subprocess.Popen[str]], join: Join
) -> None:
    sender, receiver = join(hub[0]), join(hub[0])
    hub[1].send_signal(signal.SIGSTOP)
    sent = 0
    with pytest.raises(can.CanTimeoutError, match="takes no frames"):
        while sent < 200_000:
            sender.send(can.Message(arbitration_id=sent, data=bytes(64), is_fd=True), timeout=0.0)
            sent += 1
    hub[1].send_signal(signal.SIGCONT)
    received: list[int] = []
    while len(received) < sent:
        assert sender.recv(0.0) is None  # a node that only receives sends what is left, too
        select.select([receiver], [], [], 1.0)
        received += [message.arbitration_id for message in receiver.drain()]
    assert received == list(range(sent))
    assert sent > 10_000


def test_frames_sent_together_arrive_in_their_order_and_one_behind_them(join: Join) -> None:
    sender, receiver = join(), join()
    sender.send_together([can.Message(arbitration_id=number) for number in range(5)])
    sender.send(can.Message(arbitration_id=5))
    received = [receiver.recv(HANG_S) for _ in range(6)]
    assert [each.arbitration_id for each in received if each is not None] == list(range(6))


def test_frames_sent_together_are_all_refused_where_one_can_be_none(join: Join) -> None:
    sender, receiver = join(), join()
    broken = can.Message(arbitration_id=2)
    broken.dlc = 9
    with pytest.raises(ValueError, match="length 9"):
        sender.send_together([can.Message(arbitration_id=1), broken])
    sender.send(can.Message(arbitration_id=3))
    message = receiver.recv(HANG_S)
    assert message is not None and message.arbitration_id == 3


def test_frames_sent_together_that_find_no_place_are_none_of_them_sent(
    hub: tuple[str, subprocess.Popen[str]], join: Join
) -> None:
    sender, receiver = join(hub[0]), join(hub[0])
    hub[1].send_signal(signal.SIGSTOP)
    step = [can.Message(arbitration_id=each, data=bytes(64), is_fd=True) for each in range(100)]
    sent = 0
    with pytest.raises(can.CanTimeoutError, match="takes no frames"):
        while sent < 200_000:
            sender.send_together(step, timeout=0.0)
            sent += len(step)
    hub[1].send_signal(signal.SIGCONT)
    received: list[int] = []
    while len(received) < sent:
        assert sender.recv(0.0) is None
        select.select([receiver], [], [], 1.0)
        received += [message.arbitration_id for message in receiver.drain()]
    assert received == [each.arbitration_id for each in step] * (sent // len(step))


def test_the_default_bus_is_private_to_the_user(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(place))
    with MeshpointBus() as node, MeshpointBus() as other:
        assert node.channel_info == f"meshpoint channel unix:{place}/meshpoint/default.sock"
        node.send(can.Message(arbitration_id=4))
        assert other.recv(HANG_S) is not None
    assert (place / "meshpoint").stat().st_mode & 0o077 == 0
