"""A local bus in a folder where other users may write: theirs is neither heard nor trusted."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest
from patience import until

from meshpoint.bus.local import wire
from meshpoint.bus.local.plugin import MeshpointBus

NOBODY = 65534
Process = subprocess.Popen[str]
pytestmark = [
    pytest.mark.timeout(300),
    pytest.mark.device,
    pytest.mark.skipif(
        sys.platform != "linux" or os.getuid() != 0,
        reason="only root can be another user, and only Linux reports who a peer is",
    ),
]
SERVE = """
import os, socket, sys
path, greeting = sys.argv[1:]
listener = socket.socket(socket.AF_UNIX)
listener.bind(path)
os.chmod(path, 0o666)
listener.listen()
print("ready", flush=True)
connection, _ = listener.accept()
connection.sendall(greeting.encode())
sys.stdin.read()
"""
SAY = """
import socket, sys
path, greeting = sys.argv[1:]
connection = socket.socket(socket.AF_UNIX)
connection.connect(path)
try:
    connection.sendall(greeting.encode())
    print(repr(connection.recv(100)), flush=True)
except ConnectionError:
    print("b''", flush=True)
"""
LOCK = """
import fcntl, os, sys
fcntl.flock(os.open(sys.argv[1], os.O_RDONLY), fcntl.LOCK_EX)
print("ready", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def shared() -> Iterator[Path]:
    """A folder like /tmp."""
    folder = Path(tempfile.mkdtemp(prefix="mpo-"))
    folder.chmod(0o1777)
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def somebody() -> Iterator[Callable[..., Process]]:
    """Runs a program as another user."""
    running: list[Process] = []

    def run(program: str, *arguments: str) -> Process:
        running.append(
            subprocess.Popen(
                ["/usr/bin/env", "python3", "-c", program, *arguments],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd="/",
                user=NOBODY, group=NOBODY, extra_groups=[],
            )
        )  # fmt: skip
        return running[-1]

    yield run
    for process in running:
        process.kill()
        process.communicate()


def said(process: Process) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def test_a_hub_of_another_user_is_refused_by_name(
    shared: Path, somebody: Callable[..., Process]
) -> None:
    path = shared / "bus.sock"
    assert said(somebody(SERVE, str(path), wire.GREETING.decode())) == "ready"
    with pytest.raises(can.CanInitializationError, match=rf"bus\.sock: .*user {NOBODY} is there"):
        MeshpointBus(f"unix:{path}")


def test_a_node_of_another_user_is_not_let_in(
    shared: Path, somebody: Callable[..., Process]
) -> None:
    path = shared / "bus.sock"
    with MeshpointBus(f"unix:{path}"):
        path.chmod(0o666)
        assert said(somebody(SAY, str(path), wire.GREETING.decode())) == "b''"
        log = path.with_name("bus.sock.log")
        until(lambda: f"user {NOBODY}" in log.read_text(encoding="utf-8"), "the hub says so")


def test_a_folder_that_another_user_has_locked_keeps_nobody_waiting(
    shared: Path, somebody: Callable[..., Process]
) -> None:
    assert said(somebody(LOCK, str(shared))) == "ready"
    with MeshpointBus(f"unix:{shared}/bus.sock") as bus:
        assert bus.recv(0.0) is None


@pytest.mark.parametrize("name", ["bus.sock.lock", "bus.sock.log"])
def test_a_file_of_another_user_is_not_written_to(shared: Path, name: str) -> None:
    path = shared / name
    path.touch()
    os.chown(path, NOBODY, NOBODY)
    with pytest.raises(can.CanInitializationError, match=rf"{name} must be a file of this user"):
        MeshpointBus(f"unix:{shared}/bus.sock")
    assert path.read_bytes() == b""


@pytest.mark.parametrize("name", ["bus.sock.lock", "bus.sock.log"])
def test_no_link_is_followed(shared: Path, name: str) -> None:
    other = shared / "other"
    (shared / name).symlink_to(other)
    with pytest.raises(can.CanInitializationError, match=name):
        MeshpointBus(f"unix:{shared}/bus.sock")
    assert not other.exists()


def test_what_a_hub_makes_is_for_its_user_alone_and_its_lock_does_not_stay(shared: Path) -> None:
    path = shared / "made" / "bus.sock"
    for place in (path, shared / "bus.sock"):
        with MeshpointBus(f"unix:{place}"):
            assert place.stat().st_mode & 0o777 == 0o600
            assert not place.with_name("bus.sock.lock").exists()
    assert path.parent.stat().st_mode & 0o777 == 0o700
