"""tools/test-containers where it cannot run: it says what is missing, and does not pass."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from toolbox import Machine

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="containers' own tools here are Linux's"
)


@pytest.fixture
def podman(tmp_path: Path) -> Machine:
    """Root's machine with podman and no docker engine."""
    machine = Machine(tmp_path)
    machine.program("docker", "echo 'Cannot connect to the Docker daemon' >&2; exit 1")
    for name in ("podman", "runc", "debootstrap", "catatonit"):
        machine.program(name, "exit 1")
    machine.program("id", "echo 0")
    return machine


def podman_compose(machine: Machine, line: str) -> None:
    """A podman-compose whose --version says so."""
    machine.program("podman-compose", f'echo "{line}"; echo "podman version 4.3.1"')


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("podman-compose version: 1.0.3", "here is 1.0.3"),
        ("podman-compose version 1.2.0", "here is 1.2.0"),
        ("usage: podman-compose", "here is one of unknown version"),
    ],
)
def test_a_podman_compose_too_old_is_named(podman: Machine, line: str, found: str) -> None:
    podman_compose(podman, line)
    done = podman.run("tools/test-containers")
    assert done.returncode == 3
    assert "podman-compose 1.3.0 or newer is needed" in done.stderr
    assert found in done.stderr
    assert "usage" not in done.stderr
    assert not podman.called("podman ")


@pytest.mark.parametrize("version", ["1.3.0", "1.10.0", "2.0"])
def test_a_newer_podman_compose_is_taken(podman: Machine, version: str) -> None:
    """It goes on to the image, which podman here cannot give, nor debootstrap make."""
    podman_compose(podman, f"podman-compose version {version}")
    done = podman.run("tools/test-containers")
    assert done.returncode not in (0, 3)
    assert podman.called("debootstrap --variant=minbase")


def test_what_is_missing_is_named(podman: Machine) -> None:
    done = podman.run("tools/test-containers")
    assert done.returncode == 3
    assert "podman-compose is missing" in done.stderr


def test_who_is_not_root_is_reported(podman: Machine) -> None:
    podman.program("id", "echo 1001")
    done = podman.run("tools/test-containers")
    assert done.returncode == 3
    assert "run it as root" in done.stderr
