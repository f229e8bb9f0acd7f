"""What a command does whose output cannot be written, or has no reader."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FULL = Path("/dev/full")
needs_full = pytest.mark.skipif(not FULL.exists(), reason="no /dev/full here: no Linux")


def run(*arguments: str, **streams: int) -> subprocess.CompletedProcess[str]:
    given = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | streams
    return subprocess.run(
        [sys.executable, "-m", "meshpoint", *arguments],
        stdin=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])},
        check=False,
        **given,
    )


@needs_full
@pytest.mark.parametrize("more", [(), ("--toml",), ("--json", "-")])
def test_results_that_find_no_room_are_a_failure_in_one_line(more: tuple[str, ...]) -> None:
    with FULL.open("w") as full:
        done = run("show", "gearbox", *more, stdout=full.fileno())
    assert done.returncode == 1
    assert "standard output cannot be written: No space left on device" in done.stderr
    assert "Traceback" not in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("more", [(), ("--toml",), ("--json", "-")])
def test_a_reader_of_results_that_has_seen_enough_is_no_failure(more: tuple[str, ...]) -> None:
    read, write = os.pipe()
    os.close(read)
    done = run("show", "gearbox", *more, stdout=write)
    os.close(write)
    assert (done.returncode, done.stderr) == (0, "")


def test_an_error_whose_words_nobody_reads_keeps_its_exit_code() -> None:
    read, write = os.pipe()
    os.close(read)
    done = run("show", "gearbox", "no_such.toml", stderr=write)
    os.close(write)
    assert (done.returncode, done.stdout) == (2, "")


def test_a_command_without_standard_error_does_its_work() -> None:
    closed = subprocess.run(
        ["/bin/sh", "-c", f"exec {sys.executable} -m meshpoint show gearbox no_such.toml 2>&-"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])},
        stdout=subprocess.PIPE,
        check=False,
    )
    assert (closed.returncode, closed.stdout) == (2, b"")
