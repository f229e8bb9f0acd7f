"""`replay --verify` of a BLF log, beside a loop that only reads and decodes it with cantools.

    replay    every recorded step of the controller made again and compared byte for byte
    cantools  python-can's BLFReader, and cantools' decoding of every frame of our DBC

Both work on the same log, of `simulate`, and in turn; of each the least processor time counts. What
a command takes to start is not in it.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import cantools.database

import can  # isort: skip
from meshpoint.cli.main import main as meshpoint
from meshpoint.dbc import DBC_PATH

SHIFTS = 20


def recorded(folder: Path) -> Path:
    """A log with its header beside it."""
    log = folder / "run.blf"
    _meshpoint("simulate", "--as-built", "clean", "--shifts", str(SHIFTS), "--log", str(log))
    return log


def _meshpoint(*words: str) -> None:
    with contextlib.redirect_stdout(io.StringIO()):
        code = meshpoint(list(words))
    if code != 0:
        raise RuntimeError(f"meshpoint {' '.join(words)}: ended with {code}")


def read_and_decoded(log: Path) -> float:
    """How long the log is, s."""
    messages = {each.frame_id: each for each in cantools.database.load_file(str(DBC_PATH)).messages}
    times_s: list[float] = []
    with can.BLFReader(log) as reader:
        for frame in reader:
            times_s.append(frame.timestamp)
            if frame.arbitration_id in messages:
                messages[frame.arbitration_id].decode(
                    bytes(frame.data), decode_choices=False, allow_excess=True
                )
    return times_s[-1] - times_s[0]


def cpu_s(work: Callable[[], object]) -> float:
    """The processor's seconds."""
    began_s = time.process_time()
    work()
    return time.process_time() - began_s


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--repeats", type=int, default=5)
    namespace = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        log = recorded(Path(folder))
        length_s = read_and_decoded(log)
        _meshpoint("replay", str(log), "--verify")  # loaded and compiled
        ours, peers = [], []
        for _ in range(namespace.repeats):
            ours.append(cpu_s(lambda: _meshpoint("replay", str(log), "--verify")))
            peers.append(cpu_s(lambda: read_and_decoded(log)))
    figures = {
        "log_s": round(length_s, 1),
        "times_real_time": round(length_s / min(ours), 1),
        "cantools_times_real_time": round(length_s / min(peers), 1),
    }
    if namespace.json:
        print(json.dumps(figures))
    else:
        print(
            f"replay --verify: {figures['times_real_time']} x real time, reading and decoding the "
            f"same BLF with cantools {figures['cantools_times_real_time']} x ({length_s:.0f} s)"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
