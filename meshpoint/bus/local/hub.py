"""The hub of a local bus: one small process that passes every frame on to all other nodes.

Frames of all nodes are put into one total order, the same for every listener, and none is lost:
a node that does not read is disconnected once `MAX_BACKLOG_BYTES` wait for it, never skipped.
A node that sends faster than the others read is made to wait for them (`throttle`).
Run by `python -m meshpoint.bus.local.hub CHANNEL`; nodes start it by themselves when nobody listens
(`meshpoint.bus.local.launch`). It ends when it has been without nodes for a while.
"""

import argparse
import asyncio
import contextlib
import itertools
import os
import signal
import socket
import subprocess
import sys
import time
from typing import cast

from meshpoint.bus import given_numbers
from meshpoint.bus.local import wire
from meshpoint.bus.local.channel import SYNTAX, ChannelError, HubChannel, hub_log, parse_channel
from meshpoint.bus.local.dial import NoHubError, dial
from meshpoint.bus.local.listening import HubRunningError, clean_up, listen
from meshpoint.bus.local.own_files import StrangerError, check_peer, open_own
from meshpoint.bus.local.throttle import LOOK_S, Allowance, ReaderProgress
from meshpoint.bus.standard_error import lasting_error

DEFAULT_LINGER_S = 3.0
MAX_BACKLOG_BYTES = 8 * 1024 * 1024
_GREETING_TIMEOUT_S = 5.0


class Hub:
    """The nodes connected right now, and the one order of their frames."""

    def __init__(self, linger_s: float) -> None:
        self._nodes: dict[_Connection, None] = {}  # a dict, because it keeps its order
        self._linger_s = linger_s
        self._linger: asyncio.TimerHandle | None = None
        self._held: list[_Connection] = []
        self.ended = asyncio.Event()
        # The first node may need a while, whatever it wants of the time after the last.
        self._start_lingering(max(linger_s, DEFAULT_LINGER_S))

    def join(self, node: "_Connection") -> None:
        """From here on, `node` gets every frame of the others."""
        self._nodes[node] = None
        if self._linger is not None:
            self._linger.cancel()
            self._linger = None

    def leave(self, node: "_Connection") -> None:
        """`node` is gone; a node which had not joined yet may leave, too."""
        if node in self._nodes:
            del self._nodes[node]
            if not self._nodes:
                self._start_lingering(self._linger_s)

    def pass_on(self, records: bytes, sender: "_Connection") -> None:
        """Sends whole records to every node but their sender."""
        for node in tuple(self._nodes):  # one that reads too little leaves in between
            if node is not sender:
                node.send(records)
        if not sender.spend(len(records)) and self._is_anyone_behind(but=[sender]):
            sender.hold()
            if not self._held:
                self._look_again()
            self._held.append(sender)

    def disconnect_all(self) -> None:
        """Ends every connection."""
        for node in list(self._nodes):
            node.close()

    def _is_anyone_behind(self, but: "list[_Connection]") -> bool:
        return any(node.is_behind() for node in self._nodes if node not in but)

    def _look_again(self) -> None:
        asyncio.get_running_loop().call_later(LOOK_S, self._let_go)

    def _let_go(self) -> None:
        """Those that flooded the bus are heard again once nobody is behind."""
        # One that is held may be busy sending, and reads later: nobody waits for it.
        if self._is_anyone_behind(but=self._held):
            self._look_again()
            return
        held, self._held = self._held, []
        for node in held:
            node.go_on()

    def _start_lingering(self, seconds: float) -> None:
        self._linger = asyncio.get_running_loop().call_later(seconds, self.ended.set)


class _Connection(asyncio.Protocol):
    """One node at the hub."""

    def __init__(self, hub: Hub, number: int) -> None:
        self._hub = hub
        self._number = number
        self._received = bytearray()
        self._greeted = False
        self._was_held = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._transport.set_write_buffer_limits(high=MAX_BACKLOG_BYTES)
        self._loop = loop = asyncio.get_running_loop()
        try:
            check_peer(transport.get_extra_info("socket"))
        except StrangerError as error:
            _say(f"node {self._number} refused: {error}")
            self._transport.abort()
            return
        self._allowance = Allowance(loop.time())
        self._progress = ReaderProgress(loop.time())
        self._greeting_timer = loop.call_later(
            _GREETING_TIMEOUT_S, self._drop, "it did not say what it is"
        )

    def data_received(self, data: bytes) -> None:
        if self._transport.is_closing():
            return
        self._received += data
        if not self._greeted and not self._take_greeting():
            return
        end, error = wire.stamp(self._received, time.time_ns() // 1000)
        if end:
            records = bytes(self._received[:end])
            del self._received[:end]
            self._hub.pass_on(records, self)
        if error is not None:
            self._drop(str(error))

    def send(self, records: bytes) -> None:
        """Queues records for this node."""
        if not self._transport.is_closing():
            self._progress.sent(len(records))
            self._transport.write(records)

    def spend(self, sent_bytes: int) -> bool:
        """It has sent this much; whether that is within what any node may send."""
        return self._allowance.spend(sent_bytes, self._loop.time())

    def is_behind(self) -> bool:
        """Whether more waits for it than should, and it reads."""
        return self._progress.is_behind(self._transport.get_write_buffer_size(), self._loop.time())

    def hold(self) -> None:
        """Takes nothing from this node until `go_on`."""
        self._transport.pause_reading()
        if not self._was_held:
            self._was_held = True
            _say(f"node {self._number} is made to wait: it sends faster than the others read")

    def go_on(self) -> None:
        """Takes its frames again."""
        if not self._transport.is_closing():
            self._transport.resume_reading()

    def close(self) -> None:
        """Ends this connection."""
        self._transport.close()

    def pause_writing(self) -> None:
        self._drop(f"it has left more than {MAX_BACKLOG_BYTES} bytes of frames unread")

    def eof_received(self) -> bool:
        # All it sent has been passed on by now; it does not read any more.
        self._hub.leave(self)
        return False

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 (asyncio's name)
        self._greeting_timer.cancel()
        self._hub.leave(self)

    def _take_greeting(self) -> bool:
        size = len(wire.GREETING)
        if self._received[:size] != wire.GREETING[: len(self._received)]:
            self._drop("it is no meshpoint node")
            return False
        if len(self._received) < size:
            return False
        del self._received[:size]
        self._greeted = True
        self._greeting_timer.cancel()
        self._hub.join(self)
        # The answer comes after joining: a node that has it misses no frame from here on.
        self._transport.write(wire.GREETING)
        return True

    def _drop(self, reason: str) -> None:
        if not self._transport.is_closing():
            _say(f"node {self._number} disconnected: {reason}")
            self._hub.leave(self)
            self._transport.abort()


async def serve(listener: socket.socket, linger_s: float = DEFAULT_LINGER_S) -> None:
    """Runs a hub on `listener` until it has been without nodes for `linger_s` seconds."""
    hub = Hub(linger_s)
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        with contextlib.suppress(NotImplementedError):  # Windows: ends by KeyboardInterrupt
            loop.add_signal_handler(number, hub.ended.set)
    numbers = itertools.count(1)
    server = await loop.create_server(lambda: _Connection(hub, next(numbers)), sock=listener)
    await hub.ended.wait()
    server.close()
    hub.disconnect_all()


def main(arguments: list[str] | None = None) -> int:
    """`python -m meshpoint.bus.local.hub`: returns 0 once done, or when another hub serves; 2 when
    impossible."""
    parser = argparse.ArgumentParser(
        prog="python -m meshpoint.bus.local.hub",
        description="Passes CAN frames between the nodes of a local bus.",
    )
    parser.add_argument("channel", metavar="CHANNEL", help=SYNTAX)
    parser.add_argument(
        "--linger",
        type=given_numbers.seconds,
        default=DEFAULT_LINGER_S,
        metavar="SECONDS",
        help="end after so long without nodes (default %(default)s)",
    )
    parser.add_argument(
        "--allow-remote", action="store_true", help="serve a TCP address other machines can reach"
    )
    parser.add_argument(
        "--detach",
        action="store_true",
        help="go on in the background as soon as the channel is served, with messages to a file",
    )
    options = parser.parse_args(arguments)
    try:
        channel = parse_channel(options.channel)
        if options.detach and sys.platform == "win32":
            return _start_in_background(channel)
        listener = listen(channel, options.allow_remote)
        messages = open_own(hub_log(channel)) if options.detach else None
    except HubRunningError:
        return 0
    except ChannelError as error:
        _say(str(error))
        return 2
    except OSError as error:
        _say(f"{options.channel}: {error}")
        return 2
    if messages is not None and sys.platform != "win32":
        if os.fork() > 0:
            return 0
        _leave_terminal(messages)
    with contextlib.suppress(KeyboardInterrupt):
        try:
            asyncio.run(serve(listener, options.linger))
        finally:
            clean_up(channel)
    return 0


def _start_in_background(channel: HubChannel) -> int:
    """Where a process cannot fork: starts another one and waits until that serves."""
    with hub_log(channel).open("ab") as messages:
        hub = subprocess.Popen(  # noqa: S603 (our own module)
            [sys.executable, "-m", "meshpoint.bus.local.hub", str(channel)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=messages,
            creationflags=getattr(subprocess, "DETACHED_PROCESS", 0),
        )
    while hub.poll() is None:
        try:
            dial(channel, timeout_s=1.0).close()
        except NoHubError:
            time.sleep(0.02)
        else:
            return 0
    return hub.returncode


def _leave_terminal(messages: int) -> None:
    """Nothing of this process is tied to those of its starter from here on: whoever waits for the
    end of the starter's output does not wait for the hub's end."""
    if sys.platform != "win32":
        os.setsid()
    nothing = os.open(os.devnull, os.O_RDWR)
    for number, target in enumerate((nothing, nothing, messages)):
        os.dup2(target, number)


def _say(line: str) -> None:
    sys.stderr.write(f"meshpoint hub: {line}\n")
    sys.stderr.flush()


if __name__ == "__main__":
    with lasting_error():
        code = main()
    sys.exit(code)
