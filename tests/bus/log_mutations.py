"""Damage to recorded buses, drawn from a seed: `python tests/bus/log_mutations.py COUNT [SEED]`.

A log is damaged as files are: bits flipped, a hole of zeros, bytes overwritten, missing, inserted
or moved, the end missing. Less than was written may then be read only with a LogError.
"""

from __future__ import annotations

import random
import sys
import tempfile
from collections import Counter
from pathlib import Path

import can

from meshpoint.bus.logs.reader import FORMATS, LogError, read_log
from meshpoint.bus.logs.recorder import LogWriter
from meshpoint.dbc.frame import Frame

EPOCH_S = 1_700_000_000.0
KINDS = ("flip", "zeros", "junk", "missing", "inserted", "moved", "cut")
TAKING = ("missing", "moved", "cut")


def mixed_log(path: Path, count: int, seed: int = 1) -> None:
    """A log as a bus gives it: CAN FD and classic frames, now and then an error or remote frame."""
    draw = random.Random(seed)
    with LogWriter(path, flush_every_s=None) as log:
        for number in range(count):
            time_s = EPOCH_S + number * 1e-3
            length = draw.choice((8, 12, 24, 48, 64))
            log.write(time_s, Frame(0x18FF0080, draw.randbytes(length)))
            log.write(time_s, Frame(0x0CF00400, draw.randbytes(8), is_fd=False))
            if number % 50 == 0:
                log.write_message(can.Message(timestamp=time_s, is_error_frame=True))
                remote = can.Message(timestamp=time_s, arbitration_id=1, is_remote_frame=True)
                log.write_message(remote)


def damaged(content: bytes, draw: random.Random) -> tuple[str, bytes]:
    """The kind of damage, and the content with it."""
    kind = draw.choice(KINDS)
    at = draw.randrange(len(content))
    length = draw.choice((1, 2, 4, 16, 64, 512))
    before, hit, behind = content[:at], content[at : at + length], content[at + length :]
    match kind:
        case "flip":
            flipped = content[at] ^ (1 << draw.randrange(8))
            return kind, before + bytes([flipped]) + content[at + 1 :]
        case "zeros":
            return kind, before + bytes(len(hit)) + behind
        case "junk":
            return kind, before + draw.randbytes(len(hit)) + behind
        case "missing":
            return kind, before + behind
        case "inserted":
            return kind, before + draw.randbytes(length) + hit + behind
        case "moved":
            to = draw.randrange(len(content))
            rest = before + behind
            return kind, rest[:to] + hit + rest[to:]
    return kind, before


def entries(path: Path) -> tuple[int, bool]:
    """How many entries are read of a log, and whether the reader is content with it."""
    reader = read_log(path)
    content = True
    try:
        for _ in reader:
            pass
    except LogError:
        content = False
    return (
        reader.frames + reader.error_frames + reader.remote_frames,
        content and not reader.unfinished,
    )


def lost_lines(original: bytes, content: bytes) -> int:
    """By how many lines a text has become shorter."""
    return original.count(b"\n") - content.count(b"\n")


def silent_partial_reads(ending: str, count: int, seed: int, folder: Path) -> Counter[str]:
    """Damages `count` copies of a log. `silent`: fewer entries than written were read and nothing
    was reported; `reported`: an error or a log called unfinished; `whole`: nothing is missing;
    `shorter`: a text log from which bytes were taken such that what is left is a well-formed log
    with as many fewer lines, which no reader can tell (`tests/closed_loop/test_damaged_logs.py`
    can)."""
    path = folder / f"mutated{ending}"
    mixed_log(path, 300)
    original = path.read_bytes()
    written, _ = entries(path)
    draw = random.Random(f"{ending} {seed}")
    found: Counter[str] = Counter()
    for number in range(count):
        kind, content = damaged(original, draw)
        path.write_bytes(content)
        read, is_content = entries(path)
        if not is_content:
            found["reported"] += 1
        elif read >= written:
            found["whole"] += 1
        elif (
            ending != ".blf" and kind in TAKING and lost_lines(original, content) >= written - read
        ):
            found["shorter"] += 1
        else:
            found["silent"] += 1
            print(f"{ending} seed {seed} number {number}: {kind}, {read} of {written} entries")
    return found


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        for ending_ in FORMATS:
            made = silent_partial_reads(
                ending_, int(sys.argv[1]), int([*sys.argv, "1"][2]), Path(scratch)
            )
            print(ending_, dict(sorted(made.items())))
