"""A node whose record cannot be written, or whose words nobody reads, goes on with its work."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import can
import pytest
from patience import HANG_S

sys.path.insert(0, str(Path(__file__).parent))

from live_command import live

from meshpoint.bus.local.plugin import MeshpointBus

ROOT = Path(__file__).resolve().parents[2]
FULL = Path("/dev/full")
ADDRESS = {"controller": 0x03, "rig": 0x80, "up": 0x03}
pytestmark = [
    pytest.mark.timeout(900),
    pytest.mark.skipif(not FULL.exists(), reason="no /dev/full here: the system is no Linux"),
]


@contextmanager
def node(channel: str, *arguments: str, stderr: int | IO[Any]) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "meshpoint", *arguments, "-i", "meshpoint", "-c", channel],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=stderr,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])},
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


def end(process: subprocess.Popen[bytes]) -> int:
    process.send_signal(signal.SIGTERM)
    return process.wait(HANG_S)


def is_of(name: str, message: can.Message | None) -> bool:
    """Whether there is a message, and a node of this name has sent it."""
    return message is not None and message.arbitration_id & 0xFF == ADDRESS[name]


def hear(process: subprocess.Popen[bytes], bus: can.BusABC, name: str, count: int = 5) -> None:
    """Waits for this many frames of a node, as long as it lives."""
    while count:
        count -= is_of(name, bus.recv(1.0))
        assert process.poll() is None, f"ended with {process.returncode}"


def hub_of(channel: str) -> int:
    """The process that serves a channel."""
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_text().split("\0")
        except OSError:
            continue
        if "meshpoint.bus.local.hub" in words and channel in words:
            return int(path.parent.name)
    raise AssertionError(f"no hub at {channel}")


@pytest.mark.parametrize("profile", ["fd", pytest.param("classic", marks=pytest.mark.long)])
def test_a_controller_whose_disk_is_full_goes_on_after_its_link_was_lost(
    channel: str, tmp_path: Path, profile: str
) -> None:
    with live(
        tmp_path, "controller", "--header-dir", "kept", "--profile", profile,
        "-i", "meshpoint", "-c", channel,
    ) as controller:  # fmt: skip
        with MeshpointBus(channel) as bus:
            controller.until(lambda: is_of("controller", bus.recv(1.0)))
        # No file may grow over a few bytes: to the process this is a disk that is full.
        resource.prlimit(controller.pid, resource.RLIMIT_FSIZE, (500, 500))
        os.kill(hub_of(channel), signal.SIGKILL)
        controller.until_said("cannot be written")
        with MeshpointBus(channel) as bus:
            for _ in range(20):
                controller.until(lambda: is_of("controller", bus.recv(1.0)))
        controller.signal(signal.SIGTERM)
        code = controller.end()
    assert controller.said.count("cannot be written") == 1, controller.said
    assert "lines of its records could not be written" in controller.said
    assert "Traceback" not in controller.said
    assert code == 1, controller.said


@pytest.mark.parametrize("name", ["controller", pytest.param("rig", marks=pytest.mark.long), "up"])
def test_a_node_whose_words_nobody_reads_any_more_goes_on(channel: str, name: str) -> None:
    read, write = os.pipe()
    os.close(read)
    with node(channel, name, stderr=write) as process:
        os.close(write)
        with MeshpointBus(channel) as bus:
            hear(process, bus, name)
        assert end(process) == 0


@pytest.mark.parametrize("name", [pytest.param("controller", marks=pytest.mark.long), "rig"])
def test_a_node_whose_words_find_no_room_goes_on_and_ends_with_1(channel: str, name: str) -> None:
    with FULL.open("wb") as full, node(channel, name, stderr=full) as process:
        with MeshpointBus(channel) as bus:
            hear(process, bus, name)
        assert end(process) == 1
