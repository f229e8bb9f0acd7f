"""Hostile frames against live nodes: `fuzz_live.py COUNT [SEED]`.

A rig and a controller, each a process, on a local bus, their commands proven; this process sends
what an attacker sends, as fast as the bus takes it. Every tenth of the frames it stops, waits for
the controller to have all its inputs again, and asks for a shift. Neither node may end, or say
anything of a traceback; both must end well when told to.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import can
from hostile import ATTACKS, BENCH, Hostile

from meshpoint.bus.frames import frame_of
from meshpoint.bus.local.plugin import MeshpointBus
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver, Transmitter
from meshpoint.dbc.messages import (
    TC1,
    ControllerState,
    ControllerStatus,
    FaultCode,
    ShiftOutcome,
)
from meshpoint.dbc.node import Node

BURST = 50
ROUNDS = 10
BACK_S = 5.0
SHIFT_S = 20.0
START_S = 120.0
END_S = 20.0
AT_REST = (ControllerState.IN_GEAR, ControllerState.NEUTRAL)
OURS = frozenset({0x00, 0x03, 0x80, 0x81})


def message_of(frame: Frame) -> can.Message:
    return can.Message(
        arbitration_id=frame.can_id,
        data=frame.data,
        is_fd=frame.is_fd or len(frame.data) > 8,
        is_extended_id=frame.is_extended or frame.can_id > 0x7FF,
        check=False,
    )


class Live:
    """Both nodes, and a hand on their bus."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.channel = f"unix:{folder / 'bus.sock'}"
        keys = folder / "keys.toml"
        names = ("valve_command", "clutch_command", "engine_request")
        keys.write_text("".join(f'{name} = "{k:032x}"\n' for k, name in enumerate(names)))
        keys.chmod(0o600)
        self.bus = MeshpointBus(self.channel)
        self.said = {name: (folder / f"{name}.txt") for name in ("rig", "controller")}
        self.nodes = {
            name: subprocess.Popen(
                [
                    sys.executable, "-m", "meshpoint", name, "-c", self.channel,
                    "--keys", str(keys), "--until-eof", *more,
                ],
                stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=path.open("wb"),
            )
            for (name, path), more in zip(
                self.said.items(), (["--seed", str(seed)], ["--arm"]), strict=True
            )
        }  # fmt: skip
        self.hostile = Hostile(seed, ATTACKS, BENCH)
        self._receiver = Receiver(*Node)
        self._bench = Transmitter(Node.BENCH)
        self.status: ControllerStatus | None = None
        self.outcome: ShiftOutcome | None = None

    def hear(self, wait_s: float = 0.0) -> None:
        """All that has come, after waiting for the first."""
        first = self.bus.recv(wait_s)
        for message in ([] if first is None else [first]) + self.bus.drain():
            frame = frame_of(message)
            self.hostile.hear(frame)
            decoded = self._receiver.receive(frame).message
            if type(decoded) is ControllerStatus:
                self.status = decoded
            elif type(decoded) is ShiftOutcome:
                self.outcome = decoded

    def until(self, met: object, limit_s: float) -> float:
        """Seconds until it was; RuntimeError where it was not."""
        began_s = time.monotonic()
        while not met():  # type: ignore[operator]
            if time.monotonic() - began_s > limit_s:
                raise RuntimeError(f"not within {limit_s:g} s: {self.status}")
            self.check()
            self.hear(0.05)
        return time.monotonic() - began_s

    def check(self) -> None:
        for name, node in self.nodes.items():
            if node.poll() is not None:
                raise RuntimeError(f"{name} ended: {self.said[name].read_text()[-2000:]}")

    def flood(self, count: int) -> None:
        sent = 0
        while sent < count:
            for frame in self.hostile.frames(BURST):
                self.bus.send(message_of(frame), 30.0)
            sent += BURST
            self.hear()
            self.check()

    def is_back(self) -> bool:
        status = self.status
        return status is not None and status.invalid_channels == 0

    def is_at_rest(self) -> bool:
        return self.is_back() and self.status is not None and self.status.state in AT_REST

    def ask(self, gear: int) -> str:
        """A shift, asked for again and again as a driver would; how it ended."""
        self.outcome = None
        asked_s = [0.0]

        def ended() -> bool:
            if self.outcome is None and time.monotonic() - asked_s[0] > 0.2:
                asked_s[0] = time.monotonic()
                request = self._bench.encode(TC1(requested_gear=gear))
                self.bus.send(message_of(request), 5.0)
            return self.outcome is not None

        self.until(ended, SHIFT_S)
        outcome = self.outcome
        if outcome is None:
            return "none"
        fault = "" if outcome.fault is FaultCode.NONE else f", {outcome.fault.name.lower()}"
        return outcome.result.name.lower() + fault

    def end(self) -> list[int]:
        for node in self.nodes.values():
            node.send_signal(signal.SIGTERM)
        codes = []
        for node in self.nodes.values():
            try:
                codes.append(node.wait(END_S))
            except subprocess.TimeoutExpired:
                node.kill()
                codes.append(node.wait())
        self.bus.shutdown()
        return codes


def run(count: int, seed: int) -> tuple[bool, str]:
    """Whether all was well, and a line on it."""
    results: Counter[str] = Counter()
    back_s: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        live = Live(Path(folder), seed)
        try:
            live.until(live.is_at_rest, START_S)
            began_s = time.monotonic()
            for _ in range(ROUNDS):
                live.flood(count // ROUNDS)
                live.status = None
                back_s.append(live.until(live.is_back, BACK_S))
                live.until(live.is_at_rest, SHIFT_S)
                status = live.status
                results[live.ask(10 if status and status.current_gear != 10 else 8)] += 1
                live.until(live.is_at_rest, SHIFT_S)
            taken_s = time.monotonic() - began_s
        finally:
            codes = live.end()
        said = "".join(path.read_text(errors="replace") for path in live.said.values())
    traces = len(re.findall("Traceback", said))
    made = sum(live.hostile.made.values())
    good = codes == [0, 0] and traces == 0 and made >= count
    return good, (
        f"{made} hostile frames {dict(live.hostile.made)} in {taken_s:.0f} s, exit codes {codes}, "
        f"{traces} tracebacks; inputs back after {max(back_s) * 1e3:.0f} ms at most, shifts "
        f"{dict(results)}"
    )


def main(argv: list[str]) -> int:
    good, line = run(int(argv[0]), int(argv[1]) if len(argv) > 1 else 1)
    print(f"{line}: {'good' if good else 'NOT GOOD'}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
