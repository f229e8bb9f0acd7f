"""A fresh bus for every test that could break it, a common one for the others; makes the helper
importable."""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from patience import HANG_S, until

from meshpoint.bus.local.channel import parse_channel
from meshpoint.bus.local.launch import connect
from meshpoint.bus.local.plugin import MeshpointBus
from meshpoint.bus.local.register import register_interface

sys.path.insert(0, str(Path(__file__).parent))

ROOT = Path(__file__).resolve().parents[2]

Process = subprocess.Popen[str]

register_interface()


@contextmanager
def short_directory() -> Iterator[Path]:
    """pytest's own temporary directories have paths that may be too long for a socket."""
    directory = Path(tempfile.mkdtemp(prefix="mpb-"))
    try:
        yield directory
    finally:
        shutil.rmtree(directory, ignore_errors=True)


def start_process(*arguments: str) -> Process:
    return subprocess.Popen(
        [sys.executable, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])},
    )


def end_process(process: Process) -> None:
    process.kill()
    process.communicate()


def serves(channel: str, process: Process) -> bool:
    assert process.poll() is None, f"the hub has ended with {process.returncode}"
    try:
        connect(parse_channel(channel), HANG_S, start=False).close()
    except OSError:
        return False
    return True


@contextmanager
def running_hub(directory: Path) -> Iterator[tuple[str, Process]]:
    channel = f"unix:{directory}/bus.sock"
    process = start_process("-m", "meshpoint.bus.local.hub", channel, "--linger", "1000")
    try:
        until(lambda: serves(channel, process), "the hub is up")
        yield channel, process
    finally:
        end_process(process)


@pytest.fixture
def place() -> Iterator[Path]:
    """An empty directory."""
    with short_directory() as directory:
        yield directory


@pytest.fixture
def start() -> Iterator[Callable[..., Process]]:
    """Starts Python processes that know this repository, and ends those that still run."""
    running: list[Process] = []

    def run(*arguments: str) -> Process:
        running.append(start_process(*arguments))
        return running[-1]

    yield run
    for process in running:
        end_process(process)


@pytest.fixture
def hub(place: Path) -> Iterator[tuple[str, Process]]:
    """A hub of this test alone: its channel and its process."""
    with running_hub(place) as channel_and_process:
        yield channel_and_process


@pytest.fixture(scope="session")
def common_channel() -> Iterator[str]:
    """The channel of a hub that no test ends."""
    with short_directory() as directory, running_hub(directory) as (channel, _):
        yield channel


@pytest.fixture
def join(common_channel: str) -> Iterator[Callable[..., MeshpointBus]]:
    """Connects nodes to the common hub, or to that of a channel given."""
    nodes: list[MeshpointBus] = []

    def open_node(channel: str = common_channel) -> MeshpointBus:
        nodes.append(MeshpointBus(channel, start_hub=False))
        return nodes[-1]

    yield open_node
    for node in nodes:
        node.shutdown()
