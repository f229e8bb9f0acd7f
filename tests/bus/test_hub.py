"""The local bus between real processes."""

import asyncio
import json
import socket
import stat
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path

import can
import pytest
from patience import HANG_S, until

from meshpoint.bus.local import wire
from meshpoint.bus.local.channel import ChannelError, HubChannel, parse_channel
from meshpoint.bus.local.dial import dial
from meshpoint.bus.local.hub import serve
from meshpoint.bus.local.listening import listen
from meshpoint.bus.local.plugin import MeshpointBus

TRAFFIC = str(Path(__file__).with_name("traffic.py"))

Process = subprocess.Popen[str]
Start = Callable[..., Process]
Join = Callable[..., MeshpointBus]


def ready(process: Process) -> Process:
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


def go(process: Process) -> None:
    assert process.stdin is not None
    process.stdin.write("go\n")
    process.stdin.flush()


def report(process: Process) -> dict[str, object]:
    assert process.stdout is not None
    result: dict[str, object] = json.loads(process.stdout.readline())
    return result


def fd_message(number: int) -> can.Message:
    return can.Message(arbitration_id=number, data=bytes(64), is_fd=True, bitrate_switch=True)


def test_two_listeners_see_all_frames_of_two_senders_in_the_same_order(
    common_channel: str, start: Start
) -> None:
    listeners = [start(TRAFFIC, "listen", common_channel, "2") for _ in range(2)]
    senders = [start(TRAFFIC, "send", common_channel, str(n), "1000", "0") for n in (1, 2)]
    for process in listeners + senders:
        ready(process)
    for sender in senders:
        go(sender)
    first, second = (report(listener) for listener in listeners)
    assert first["counts"] == {"1": 1000, "2": 1000}
    assert first == second


def test_a_reader_that_stalls_for_300_ms_at_3000_frames_a_second_loses_nothing(
    common_channel: str, start: Start, join: Join
) -> None:
    node = join()
    sender = ready(start(TRAFFIC, "send", common_channel, "5", "1800", "3000"))
    go(sender)
    numbers = []
    stalled = False
    while True:
        message = node.recv(HANG_S)
        assert message is not None
        if message.dlc == 0:
            break
        numbers.append(int.from_bytes(message.data[:4], "big"))
        if len(numbers) > 600 and not stalled:
            time.sleep(0.3)
            stalled = True
    assert numbers == list(range(1800))


def test_nodes_that_start_at_the_same_time_meet_at_one_hub(place: Path) -> None:
    channel = f"unix:{place}/sub/bus.sock"
    opened: list[MeshpointBus] = []

    def open_node() -> None:
        opened.append(MeshpointBus(channel))

    threads = [threading.Thread(target=open_node) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for number, node in enumerate(opened):
        node.send(fd_message(number))
    heard = []
    for node in opened:
        messages = [node.recv(HANG_S) for _ in range(2)]
        heard.append({message.arbitration_id for message in messages if message is not None})
        node.shutdown()
    assert heard == [{0, 1, 2} - {own} for own in range(3)]


def test_a_hub_is_invisible_to_others_and_leaves_nothing_behind(place: Path, start: Start) -> None:
    socket_file = place / "private" / "bus.sock"
    hub = start("-m", "meshpoint.bus.local.hub", f"unix:{socket_file}", "--linger", "0.1")
    until(lambda: hub.poll() is not None or socket_file.exists(), "a hub's socket")
    with MeshpointBus(f"unix:{socket_file}", start_hub=False) as node:
        assert stat.S_IMODE(socket_file.stat().st_mode) & 0o077 == 0
        assert stat.S_IMODE(socket_file.parent.stat().st_mode) == 0o700
        assert "bus.sock" in node.channel_info
    assert hub.wait(HANG_S) == 0
    assert list(socket_file.parent.iterdir()) == []


def test_a_socket_file_left_by_a_killed_hub_is_taken_over(
    hub: tuple[str, Process],
) -> None:
    channel, process = hub
    process.kill()
    process.wait()
    with MeshpointBus(channel) as one, MeshpointBus(channel) as other:
        one.send(fd_message(7))
        received = other.recv(HANG_S)
    assert received is not None
    assert received.arbitration_id == 7


def test_frames_sent_right_before_closing_arrive_although_the_sender_never_read(
    join: Join,
) -> None:
    listener, leaver = join(), join()
    for number in range(500):
        listener.send(fd_message(number))  # lie unread at the leaver, which must not matter
    for number in range(500):
        leaver.send(fd_message(number))
    leaver.shutdown()
    received = [listener.recv(HANG_S) for _ in range(500)]
    assert [message.arbitration_id for message in received if message is not None] == list(
        range(500)
    )


def test_a_node_that_talks_nonsense_is_disconnected_and_the_others_go_on(
    common_channel: str, join: Join
) -> None:
    one, other = join(), join()
    stranger = dial(parse_channel(common_channel), 1.0)
    good = wire.pack(wire.Flag.EXTENDED, 0x123, b"\x01", 1)
    stranger.sendall(good + b"GET / HTTP/1.1\r\n\r\n")
    stranger.setblocking(True)
    stranger.settimeout(HANG_S)
    assert stranger.recv(100) == b""
    stranger.close()
    first = one.recv(HANG_S)
    assert first is not None
    assert first.arbitration_id == 0x123
    other.send(fd_message(5))
    second = one.recv(HANG_S)
    assert second is not None
    assert second.arbitration_id == 5


def test_a_hub_serves_a_port_of_this_machine() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        channel = f"tcp:127.0.0.1:{probe.getsockname()[1]}"
    with MeshpointBus(channel) as one, MeshpointBus(channel) as other:
        one.send(fd_message(9))
        received = other.recv(HANG_S)
    assert received is not None
    assert received.arbitration_id == 9


def test_a_second_hub_on_a_channel_leaves_it_to_the_first(
    common_channel: str, start: Start, join: Join
) -> None:
    node = join()
    second = start("-m", "meshpoint.bus.local.hub", common_channel)
    assert second.wait(HANG_S) == 0
    other = join()
    other.send(fd_message(3))
    assert node.recv(HANG_S) is not None


def test_a_port_that_other_machines_reach_is_refused(start: Start) -> None:
    with pytest.raises(ChannelError, match="--allow-remote"):
        listen(parse_channel("tcp:0.0.0.0:29999"))
    with pytest.raises(ValueError, match="allow_remote"):
        MeshpointBus("tcp:192.0.2.1:29999")


def test_something_else_on_the_port_is_reported_from_a_hub() -> None:
    with socket.create_server(("127.0.0.1", 0)) as stranger:
        port = stranger.getsockname()[1]

        def answer() -> None:
            connection, _ = stranger.accept()
            connection.sendall(b"220 mail.example ESMTP\r\n")
            connection.close()

        thread = threading.Thread(target=answer)
        thread.start()
        with pytest.raises(can.CanInitializationError, match="no meshpoint hub"):
            MeshpointBus(f"tcp:127.0.0.1:{port}")
        thread.join()


def test_a_hub_that_cannot_start_says_why(place: Path) -> None:
    (place / "file").write_text("in the way")
    with pytest.raises(can.CanInitializationError, match=r"file/bus.sock: Not a directory"):
        MeshpointBus(f"unix:{place}/file/bus.sock")
    (place / "bus.sock").write_text("no socket")
    with pytest.raises(can.CanInitializationError, match=r"bus.sock: .*in use"):
        MeshpointBus(f"unix:{place}/bus.sock")


FLOOD_BYTES = 6_000_000
SLOW_READ_BYTES = 16 * 1024


def _greeted(channel: HubChannel) -> socket.socket:
    node = dial(channel, 1.0)
    node.settimeout(30.0)
    return node


def _flood(node: socket.socket) -> None:
    record = wire.pack(wire.Flag.EXTENDED | wire.Flag.FD, 0x1FFF0001, bytes(64), 64)
    chunk = record * 100
    for _ in range(FLOOD_BYTES // len(chunk)):
        node.sendall(chunk)


@pytest.mark.asyncio
async def test_a_node_that_floods_the_bus_waits_and_nobody_is_thrown_off(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Readers that are slower than the flood still get all of it, and what others say between."""
    monkeypatch.setattr("meshpoint.bus.local.hub.MAX_BACKLOG_BYTES", 1_000_000)
    channel = parse_channel(f"unix:{place}/bus.sock")
    server = asyncio.ensure_future(serve(listen(channel), linger_s=0.05))
    await asyncio.sleep(0.05)
    reader, other, flooder = [await asyncio.to_thread(_greeted, channel) for _ in range(3)]
    flood = asyncio.ensure_future(asyncio.to_thread(_flood, flooder))
    drained = asyncio.ensure_future(asyncio.to_thread(_read_all, flooder, 80))
    quick = asyncio.ensure_future(asyncio.to_thread(_read_all, other, FLOOD_BYTES // 8000 * 8000))
    got = bytearray()
    said = wire.pack(wire.Flag.EXTENDED | wire.Flag.FD, 0x1234, bytes(64), 64)
    while len(got) < 80 + FLOOD_BYTES // 8000 * 8000:
        if len(got) // 1_000_000 and said:
            other.sendall(said)
            said = b""
        got += await asyncio.to_thread(reader.recv, SLOW_READ_BYTES)
        await asyncio.sleep(0.002)
    await asyncio.wait_for(asyncio.gather(flood, drained, quick), 30.0)
    identifiers = [record.can_id for record, _ in wire.records(got)]
    assert len(identifiers) == FLOOD_BYTES // 8000 * 100 + 1
    # What another node says is heard soon, not behind megabytes of the flood.
    assert identifiers.index(0x1234) < len(identifiers) // 2
    messages = capsys.readouterr().err
    assert "disconnected" not in messages
    assert "is made to wait" in messages
    for node in (reader, other, flooder):
        node.close()
    await asyncio.wait_for(server, 30.0)


def _read_all(node: socket.socket, size: int) -> None:
    read = 0
    while read < size:
        read += len(node.recv(65536))


@pytest.mark.asyncio
async def test_a_node_that_does_not_read_is_disconnected_after_an_unbroken_sequence(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("meshpoint.bus.local.hub.MAX_BACKLOG_BYTES", 100_000)
    channel = parse_channel(f"unix:{place}/bus.sock")
    server = asyncio.ensure_future(serve(listen(channel), linger_s=0.05))
    await asyncio.sleep(0.05)
    sleeper, reader, sender = [
        await asyncio.to_thread(MeshpointBus, str(channel)) for _ in range(3)
    ]
    read = 0
    while "unread" not in capsys.readouterr().err:
        for number in range(200):
            sender.send(fd_message(number), timeout=0.0)
        await asyncio.sleep(0.001)
        read += len(reader.drain())
        assert read < 100_000
    got = []
    with pytest.raises(can.CanOperationError):
        while True:
            got += [message.arbitration_id for message in sleeper.drain()]
            await asyncio.sleep(0.001)
    assert len(got) > 1000
    assert got == [index % 200 for index in range(len(got))]
    sender.send(fd_message(0x1FFF))
    while 0x1FFF not in [message.arbitration_id for message in reader.drain()]:
        await asyncio.sleep(0.001)
    for node in (sleeper, reader, sender):
        await asyncio.to_thread(node.shutdown)
    await asyncio.wait_for(server, HANG_S)
