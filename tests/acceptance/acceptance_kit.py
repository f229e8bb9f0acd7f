"""What the acceptance tests share: running the commands as processes.

Neither this nor what reads the wire (`acceptance_wire`) imports the product.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from patience import HANG_S

ROOT = Path(__file__).resolve().parents[2]
DBC_FILE = ROOT / "dbc" / "meshpoint.dbc"
THESIS_SHEET = ROOT / "meshpoint" / "gearbox" / "sheets" / "thesis.toml"
COMMAND = (sys.executable, "-m", "meshpoint")

# The thesis's sheet: 48 dog teeth, backlash a fifth of the pitch.
PITCH_DEG = 7.5
HALF_BACKLASH_DEG = 0.75
EXPIRY_US = 100_000
US_WRAP = 1 << 32

MAIN_GEAR_OF = {13: 1, 14: 1} | {gear: 2 + (gear - 1) % 6 // 2 for gear in range(1, 13)}


STRATEGIES = ("speed_window", "target_phase")
FIRST_SEEDS = (1, 2, 3)
OTHER_SEEDS = (101, 202, 303)
SHIFTS = 60


def words(text: str) -> list[str]:
    return text.split()


# ---------------------------------------------------------------------------------- processes


class Outcome(NamedTuple):
    """How a command ended."""

    code: int
    out: str
    err: str

    @property
    def text(self) -> str:
        return f"exit code {self.code}\n--- stdout\n{self.out}\n--- stderr\n{self.err}"

    @property
    def json(self) -> Any:
        return strict_json(self.out)


def strict_json(text: str) -> Any:
    """JSON as RFC 8259 has it: NaN and Infinity are no JSON."""

    def refuse(token: str) -> None:
        raise ValueError(f"{token} is not JSON")

    return json.loads(text, parse_constant=refuse)


def environment(**more: str) -> dict[str, str]:
    """The environment of a command: the repository importable, no CAN settings of this user."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("CAN_")}
    kept["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), kept.get("PYTHONPATH", "")]))
    kept["PYTHONUNBUFFERED"] = "1"
    kept["COLUMNS"] = "200"
    kept.pop("NO_COLOR", None)
    return kept | more


def start(*arguments: object, cwd: Path, **more: str) -> subprocess.Popen[str]:
    """A command running in a process group of its own, its output in pipes."""
    return subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        cwd=cwd,
        env=environment(**more),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def kill_group(process: subprocess.Popen[str]) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.communicate(timeout=HANG_S)


class PreparedCommands:
    """Processes that have the product imported and fork one more for each command."""

    def __init__(self) -> None:
        self._idle: queue.SimpleQueue[subprocess.Popen[str]] = queue.SimpleQueue()
        self.all: list[subprocess.Popen[str]] = []

    def _take(self) -> subprocess.Popen[str]:
        with contextlib.suppress(queue.Empty):
            return self._idle.get_nowait()
        process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("prepared_command.py"))],
            env=environment(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.all.append(process)
        return process

    def run(self, arguments: Sequence[str], cwd: Path, scratch: Path, timeout_s: float) -> Outcome:
        out, err = scratch / "out", scratch / "err"
        request = {
            "arguments": arguments,
            "cwd": str(cwd),
            "out": str(out),
            "err": str(err),
            "timeout_s": timeout_s,
        }
        process = self._take()
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(json.dumps(request) + "\n")
        process.stdin.flush()
        answer = process.stdout.readline()
        assert answer, "the product cannot be imported"
        self._idle.put(process)
        code = json.loads(answer)
        assert code is not None, f"{arguments} did not end within {timeout_s:g} s"
        return Outcome(code, out.read_text(errors="replace"), err.read_text(errors="replace"))

    def close(self) -> None:
        for process in self.all:
            process.kill()
            process.communicate()


PREPARED = PreparedCommands()


def run(*arguments: object, cwd: Path | None = None, timeout_s: float = HANG_S) -> Outcome:
    """Run a command to its end; a command that does not end in time fails the test."""
    with tempfile.TemporaryDirectory(prefix="meshpoint-") as scratch:
        folder = Path(scratch)
        if hasattr(os, "fork"):
            work = folder / "work"
            work.mkdir()
            return PREPARED.run([*map(str, arguments)], cwd or work, folder, timeout_s)
        return run_whole(*arguments, cwd=cwd or folder, timeout_s=timeout_s)


def run_whole(*arguments: object, cwd: Path, timeout_s: float = HANG_S) -> Outcome:
    """The same by a fresh interpreter."""
    process = start(*arguments, cwd=cwd)
    try:
        out, err = process.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        kill_group(process)
        raise AssertionError(f"{arguments} did not end within {timeout_s:g} s") from None
    return Outcome(process.returncode, out, err)


def run_many(commands: Sequence[Sequence[object]]) -> list[Outcome]:
    """Run commands, two at a time."""
    with ThreadPoolExecutor(max_workers=2) as pool:
        return list(pool.map(lambda command: run(*command), commands))


def assert_ended_well(outcome: Outcome) -> None:
    assert outcome.code == 0, outcome.text
    assert "Traceback" not in outcome.err + outcome.out, outcome.text


def assert_refused(outcome: Outcome, *named: str) -> None:
    """Exit code 2, no traceback, and one error line that names each of `named`.

    A long one goes on indented. argparse prints its usage first; the error is the last line."""
    assert "Traceback" not in outcome.err + outcome.out, outcome.text
    assert outcome.code == 2, outcome.text
    said = outcome.err.replace("\n  ", " ")
    lines = [line for line in said.splitlines() if line.strip()]
    assert lines, f"refused without a word\n{outcome.text}"
    start_of_usage = lines[0].startswith("usage:")
    assert start_of_usage or len(lines) == 1, f"more than one line\n{outcome.text}"
    for name in named:
        assert name.lower() in lines[-1].lower(), f"{name!r} is not named\n{outcome.text}"
