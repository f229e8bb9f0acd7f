"""What proving commands costs: the proof of a step's three commands, and its check, a command each.

Beside it the codec's own cost of the same three frames, for scale, and what a forged proof costs
the receiver, which is what a flood would use.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

from meshpoint.bus.authentication.frames import CHALLENGE, PROOF
from meshpoint.bus.authentication.proof import CommandProver, CommandVerifier
from meshpoint.bus.command_keys import make_keys
from meshpoint.bus.simulated.frame_bits import INTERMISSION_BITS, BitTiming, WireFrame, longest
from meshpoint.dbc import Frame, Node
from meshpoint.dbc.link import Receiver, Transmitter
from meshpoint.dbc.messages import TSC1, ClutchCommand, ValveCommand

STEPS = 200
COMMANDS = 3
KEYS = make_keys(
    {
        name: bytes([k]) * 16
        for k, name in enumerate(("valve_command", "clutch_command", "engine_request"))
    },
    "bench",
)
LIMIT_US = {"prove": 100.0, "check": 100.0}
"""A command; a step has three and 10,000 us."""


def frames() -> list[list[Frame]]:
    """The commands of some steps."""
    transmitter = Transmitter(Node.TRANSMISSION_CONTROL)
    messages = (TSC1(), ValveCommand(), ClutchCommand())
    return [[transmitter.encode(message) for message in messages] for _ in range(STEPS)]


def command_us(work: Callable[[], None]) -> float:
    """Microseconds a command of one round."""
    start_ns = time.perf_counter_ns()
    work()
    return (time.perf_counter_ns() - start_ns) / 1e3 / (STEPS * COMMANDS)


class Round:
    """Each operation once over all steps."""

    def __init__(self) -> None:
        self.steps = frames()
        self.proofs: list[Frame] = []
        self.prover = CommandProver(KEYS)
        self.verifier = CommandVerifier(KEYS, lambda: 1)
        challenge = self.verifier.challenge(0)
        if challenge is None:
            raise RuntimeError("no challenge at the start")
        self.prover.hear(challenge)

    def prove(self) -> None:
        for step in self.steps:
            proof = self.prover.prove(step)
            if proof is None:
                raise RuntimeError("a step was not proven")
            self.proofs.append(proof)

    def check(self) -> None:
        for step, proof in zip(self.steps, self.proofs, strict=True):
            for frame in (*step, proof):
                self.verifier.receive(frame)

    def forged(self) -> None:
        message = PROOF.decode(self.proofs[-1])._replace(proof_counter=0xFFFF, valve_mac=1)
        proof = PROOF.encode(0, message._replace(clutch_mac=1, engine_mac=1))
        for step in self.steps:
            for frame in (*step, proof):
                self.verifier.receive(frame)

    def codec(self) -> None:
        transmitter, receiver = Transmitter(Node.TRANSMISSION_CONTROL), Receiver(*Node)
        for _ in range(STEPS):
            for message in (TSC1(), ValveCommand(), ClutchCommand()):
                receiver.receive(transmitter.encode(message))

    def run(self) -> dict[str, float]:
        works = (self.prove, self.check, self.forged, self.codec)
        taken = {work.__name__: command_us(work) for work in works}
        if self.verifier.proven != STEPS * COMMANDS:
            raise RuntimeError("a good command was refused")
        return taken


def bus_share() -> float:
    """What both frames take of the bus at their longest."""
    timing, share = BitTiming(), 0.0
    for can_id, length, period_ns in ((PROOF.can_id, 32, 10e6), (CHALLENGE.can_id, 12, 50e6)):
        bits_ns = longest(WireFrame(can_id, bytes(length))).duration_ns(timing)
        share += (bits_ns + INTERMISSION_BITS * timing.nominal_ns) / period_ns
    return share


def main(argv: list[str] | None = None) -> int:
    """Print the table; exit 1 if a stated limit is missed."""
    parser = argparse.ArgumentParser(prog="bench_authentication", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    parser.add_argument("--repeats", type=int, default=15, help="rounds (15)")
    options = parser.parse_args(argv)
    rounds = [Round().run() for _ in range(options.repeats)]
    rows: list[dict[str, Any]] = [
        {
            "operation": name,
            "command_us": round(statistics.median(taken[name] for taken in rounds), 2),
            "limit_us": LIMIT_US.get(name),
        }
        for name in rounds[0]
    ]
    if options.json:
        print(json.dumps({"bus_share": round(bus_share(), 4), "rows": rows}, indent=2))
    else:
        print("microseconds a command (forged: a wrong proof while four of each wait; codec: both")
        print("ends without proof), median of the rounds")
        for row in rows:
            limit = "" if row["limit_us"] is None else f"  limit {row['limit_us']:g}"
            print(f"{row['operation']:<8} {row['command_us']:>8.2f}{limit}")
        print(f"share of the bus: {bus_share():.2%}")
    return int(any(row["limit_us"] and row["command_us"] > row["limit_us"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
