"""What a frame costs: the codec, end-to-end check included, beside cantools and the same check.

Both sides do the same work on the same frames: encode is message -> protected frame with values
held against their ranges, decode is frame -> checked message. Every signal is in the middle of its
range. Rounds of the two sides alternate, so that a slow moment of the machine hits both; the median
of the rounds is reported.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import cantools.database
from cantools.database.can import Database
from cantools.database.can import Message as ParsedMessage
from e2e.p05 import e2e_p05_check, e2e_p05_protect

from meshpoint.dbc import DBC_PATH, DBC_SHA256, Frame, Node
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import FrameVerdict, Receiver, Transmitter

MESSAGES = ("EdgesLayshaftRise", "SleevesMain", "ValveCommand", "GearboxSensors", "EEC1")
FRAMES_A_ROUND = 256
"""A whole turn of the counter, so that it runs on from round to round."""
LIMITS_US = {("EdgesLayshaftRise", "decode"): 3.0, ("EdgesLayshaftRise", "encode"): 5.0}


class Ours:
    """The product's two ends of the link."""

    def __init__(self, sample: Any) -> None:
        self._sample = sample
        self._transmitter = Transmitter(*Node)
        self._receiver = Receiver(*Node)

    def encode(self) -> Frame:
        return self._transmitter.encode(self._sample)

    def decode(self, frame: Frame) -> None:
        verdict, _ = self._receiver.receive(frame)
        if verdict is not FrameVerdict.OK:
            raise RuntimeError(f"a good frame was refused: {verdict.name}")


class Peer:
    """The same with cantools, scaled values by name, and the same library's CRC."""

    def __init__(self, parsed: ParsedMessage, data_id: int | None, sample: dict[str, Any]) -> None:
        self._parsed = parsed
        self._data_id = data_id
        self._sample = sample

    def encode(self) -> bytes:
        if self._data_id is None:
            return self._parsed.encode(self._sample)
        self._sample["Counter"] = (self._sample["Counter"] + 1) % 256
        data = bytearray(self._parsed.encode(self._sample))
        e2e_p05_protect(data, self._data_id, increment_counter=False)
        return bytes(data)

    def decode(self, frame: Frame) -> None:
        if self._data_id is not None and not e2e_p05_check(frame.data, self._data_id):
            raise RuntimeError("a good frame was refused")
        self._parsed.decode(frame.data, decode_choices=False)


def pair(parsed: ParsedMessage) -> tuple[Ours, Peer]:
    """Both sides of one message, with the same values."""
    codec = CODECS[parsed.name]
    middle = {s.name: (s.raw_min + s.raw_max) // 2 for s in codec.spec.signals}
    data = parsed.encode(middle, scaling=False, strict=False)
    values: Any = parsed.decode(data, decode_choices=False)
    return Ours(codec.decode(data)), Peer(parsed, codec.spec.data_id, values)


def encode_all(side: Ours | Peer) -> None:
    for _ in range(FRAMES_A_ROUND):
        side.encode()


def decode_all(side: Ours | Peer, frames: list[Frame]) -> None:
    for frame in frames:
        side.decode(frame)


def frame_us(work: Callable[[], None]) -> float:
    """Microseconds a frame of one round."""
    start_ns = time.perf_counter_ns()
    work()
    return (time.perf_counter_ns() - start_ns) / 1e3 / FRAMES_A_ROUND


def measure(parsed: ParsedMessage, repeats: int) -> list[dict[str, Any]]:
    """One row an operation: microseconds of ours and of cantools, and their ratio."""
    ours, peer = pair(parsed)
    frames = [ours.encode() for _ in range(FRAMES_A_ROUND)]
    operations: dict[str, tuple[Callable[[], None], Callable[[], None]]] = {
        "decode": (lambda: decode_all(ours, frames), lambda: decode_all(peer, frames)),
        "encode": (lambda: encode_all(ours), lambda: encode_all(peer)),
    }
    rows = []
    for operation, (our_round, peer_round) in operations.items():
        rounds = [(frame_us(our_round), frame_us(peer_round)) for _ in range(repeats)]
        our_us, peer_us = (statistics.median(side) for side in zip(*rounds, strict=True))
        limit_us = LIMITS_US.get((parsed.name, operation))
        rows.append(
            {
                "message": parsed.name,
                "bytes": parsed.length,
                "operation": operation,
                "ours_us": round(our_us, 3),
                "cantools_us": round(peer_us, 3),
                "ratio": round(peer_us / our_us, 2),
                "limit_us": limit_us,
                "is_within_limit": limit_us is None or our_us <= limit_us,
            }
        )
    return rows


def print_table(rows: list[dict[str, Any]]) -> None:
    print(f"{'message':<18} {'bytes':>5} {'':<7} {'ours us':>8} {'cantools us':>12} {'ratio':>6}")
    for row in rows:
        limit = "" if row["limit_us"] is None else f"  limit {row['limit_us']:.0f} us"
        print(
            f"{row['message']:<18} {row['bytes']:>5} {row['operation']:<7} {row['ours_us']:>8.2f} "
            f"{row['cantools_us']:>12.2f} {row['ratio']:>5.1f}x{limit}"
        )


def main(argv: list[str] | None = None) -> int:
    """Print the table; exit 1 if a stated limit is missed."""
    parser = argparse.ArgumentParser(prog="bench_codec", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    parser.add_argument("--repeats", type=int, default=101, help="rounds of each side (101)")
    options = parser.parse_args(argv)
    if options.repeats < 1:
        parser.error(f"--repeats {options.repeats}: 1 or more is allowed")
    database = cantools.database.load_file(DBC_PATH)
    if not isinstance(database, Database):
        raise TypeError(f"{DBC_PATH}: not a DBC file")
    parsed = [database.get_message_by_name(name) for name in MESSAGES]
    rows = [row for message in parsed for row in measure(message, options.repeats)]
    if options.json:
        print(json.dumps({"dbc_sha256": DBC_SHA256, "rows": rows}, indent=2))
    else:
        print_table(rows)
    return 0 if all(row["is_within_limit"] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
