"""A file that finds no room on its disk is said in one line, with the exit code that the table of
exit codes has for it, and leaves nothing half written behind."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from meshpoint.base.errors import CommandError, RunError
from meshpoint.bus.logs.recorder import LogWriter
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import SleevesMain
from meshpoint.dbc.node import Node
from meshpoint.results.output import write_json

ROOT = Path(__file__).resolve().parents[2]
FULL = Path("/dev/full")
ROOM_BLOCKS = 64
"""Of 512 bytes, or of 1,024 by another shell: less than any of these files needs."""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two thousand sleeve samples that no compression makes small."""
    path, io = tmp_path_factory.mktemp("full") / "x.log", Transmitter(Node.GEARBOX_IO)
    with LogWriter(path, flush_every_s=None) as writer:
        for number in range(3_000):
            places = tuple(1e-6 * ((7919 * number + 104_729 * k) % 9_973) for k in range(10))
            read = SleevesMain(
                sample_time_us=10_000 * number, sensor_fault=0, sleeve_first_second_m=places,
                sleeve_crawl_third_m=places[::-1],
            )  # fmt: skip
            writer.write(0.010 * number, io.encode(read))
    return path


@pytest.mark.parametrize(
    "ending", ["mcap", *(pytest.param(each, marks=pytest.mark.long) for each in ("mf4", "parquet"))]
)
def test_a_converted_log_that_finds_no_room_is_a_failure_in_one_line(
    log: Path, tmp_path: Path, ending: str
) -> None:
    """Files of this process may be no larger: to who writes them it is a disk that is full."""
    command = f"ulimit -f {ROOM_BLOCKS}; trap '' XFSZ; exec \"$@\""
    path = os.pathsep.join([str(ROOT), *sys.path])
    done = subprocess.run(
        ["/bin/sh", "-c", command, "sh", sys.executable, "-m", "meshpoint", "convert", str(log),
         "-o", f"x.{ending}"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert f"meshpoint convert: x.{ending}: cannot be written: " in done.stderr
    assert "File too large" in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full here: the system is no Linux")
def test_results_on_a_full_disk_are_a_failure_of_the_run_not_of_its_arguments(
    tmp_path: Path,
) -> None:
    with pytest.raises(RunError, match=r"/dev/full: cannot be written: No space left on device"):
        write_json(str(FULL), {"a": 1})
    with pytest.raises(CommandError, match=r"none/x\.json: cannot be written: No such file"):
        write_json(str(tmp_path / "none" / "x.json"), {"a": 1})
