"""The devices of `with-vcan --controllers`, and an slcan adapter behind the kernel's driver."""

from __future__ import annotations

import fcntl
import json
import os
import select
import struct
import subprocess
import threading
import tty
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from vcan_bench import CLASSIC, FD, Wire, ip

KVASER_BITS = ("bitrate", "500000", "sample-point", "0.875", "restart-ms", "100")
CTU_BITS = ("bitrate", "500000", "sample-point", "0.8", "dbitrate", "2000000",
            "dsample-point", "0.8", "fd", "on", "restart-ms", "100")  # fmt: skip
QUEUE_FRAMES = "1000"
"""As docs/bench.md sets adapters up; the kernel's own 10 are the exception that a test makes."""
_N_SLCAN = 17
_TIOCSETD = 0x5423


def set_up(devices: tuple[str, str], bits: tuple[str, ...]) -> None:
    """Both as docs/bench.md sets them up, whatever a test before this one did to them."""
    for device in devices:
        fast(device)
        ip("set", device, "down")
        ip("set", device, "type", "can", *bits)
        ip("set", device, "txqueuelen", QUEUE_FRAMES)
        ip("set", device, "up")


KVASER = Wire("can0", "can1", CLASSIC, lambda: set_up(("can0", "can1"), KVASER_BITS))
CTU = Wire("can2", "can3", FD, lambda: set_up(("can2", "can3"), CTU_BITS))


def tc(*words: str) -> str:
    """`tc ...`, as root."""
    return subprocess.run(["tc", *words], check=True, capture_output=True, text=True).stdout


def slow(device: str, bit_s: int) -> None:
    """Gives a device a bit rate, which QEMU's have not, behind a queue of its own length."""
    rate = ["rate", f"{bit_s}bit", "burst", "144", "latency", "60s"]
    tc("qdisc", "replace", "dev", device, "root", "handle", "1:", "tbf", *rate)
    tc("qdisc", "replace", "dev", device, "parent", "1:", "handle", "2:", "pfifo")


def hurry(device: str) -> None:
    """Lets what waits in the queue of a slow one out at once; the queue stays, with its counts."""
    rate = ["rate", "1gbit", "burst", "100kb", "latency", "60s"]
    tc("qdisc", "change", "dev", device, "root", "handle", "1:", "tbf", *rate)


def fast(device: str) -> None:
    """As it was before it was made slow."""
    with suppress(subprocess.CalledProcessError):
        tc("qdisc", "delete", "dev", device, "root")


def queue_counts(device: str) -> dict[str, Any]:
    """The kernel's own counts of the queue of a slow device: `drops`, `limit`, `qlen`."""
    queues = json.loads(tc("-json", "-statistics", "qdisc", "show", "dev", device))
    found = next(queue for queue in queues if queue["kind"] == "pfifo")
    return {**found, "limit": found["options"]["limit"]}


class SerialAdapter:
    """An slcan adapter, played at a pseudo-terminal; `device` is what the kernel's driver makes
    of it. Unlike QEMU's controllers it can go bus-off."""

    def __enter__(self) -> SerialAdapter:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        before = _devices()
        fcntl.ioctl(self._slave, _TIOCSETD, struct.pack("i", _N_SLCAN))
        (self.device,) = _devices() - before
        self.heard = b""
        self._ended = threading.Event()
        # The driver waits for each of its commands to be read.
        self._reader = threading.Thread(target=self._read)
        self._reader.start()
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _value: object, _where: TracebackType | None
    ) -> None:
        with suppress(subprocess.CalledProcessError):
            ip("set", self.device, "down")
        self._ended.set()
        self._reader.join()
        os.close(self._slave)
        os.close(self._master)

    def _read(self) -> None:
        while not self._ended.is_set():
            if select.select([self._master], [], [], 0.05)[0]:
                self.heard += os.read(self._master, 4096)

    def say(self, line: str) -> None:
        """One line of the protocol, to the driver."""
        os.write(self._master, line.encode() + b"\r")


def _devices() -> set[str]:
    return {entry.name for entry in Path("/sys/class/net").iterdir()}
