"""An attacker beside a rig that takes proven commands alone: `forged_commands.py COUNT [SEED]`.

The attacker hears everything and sends what it likes: commands with right CRC and counter, frames
of before with their proofs, proofs with counters set back or forward, codes exchanged or drawn. The
run must be that without it, frame by frame.
"""

from __future__ import annotations

import random
import sys
import time
from collections import Counter, deque

from loop_bench import PHASES_US, Operator

from meshpoint.base.provenance import product_version
from meshpoint.bench.virtual_time import VirtualTime
from meshpoint.bus.authentication.cores import ProvingCore, VerifyingCore
from meshpoint.bus.authentication.frames import PROOF
from meshpoint.bus.authentication.proof import CLUTCH, COMMANDS, HELD, VALVES
from meshpoint.bus.command_keys import CommandKeys, make_keys
from meshpoint.bus.core import Step
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.header import new_header
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.e2e import write_crc
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import Preset, RigSettings

NAMES = ("valve_command", "clutch_command", "engine_request")
KEYS = make_keys({name: bytes([k]) * 16 for k, name in enumerate(NAMES)}, "test")
REQUESTS = [(400_000, 10), (1_700_000, 12), (3_000_000, 10), (4_300_000, 8)]
DATA_IDS = {codec.spec.can_id: codec.spec.data_id for codec in CODECS.values()}


def protected(can_id: int, data: bytes, counter: int) -> Frame:
    """With the CRC and the counter that the receiver's own check wants."""
    buffer, data_id = bytearray(data), DATA_IDS[can_id]
    if data_id is not None:
        buffer[2] = (counter - 1) % 256
        write_crc(buffer, data_id)
    return Frame(can_id, bytes(buffer), data_id is not None)


class Attacker:
    """Makes hostile frames of what was heard."""

    KINDS = (
        "forged", "forged with a proof", "replayed", "rewound", "exchanged", "drawn", "damaged",
    )  # fmt: skip

    def __init__(self, seed: int) -> None:
        self._draw = random.Random(seed)
        self._heard: deque[Frame] = deque(maxlen=2_000)
        self._last: dict[int, Frame] = {}
        self.sent: Counter[str] = Counter()
        """Attacks by their kind; each is one to four frames."""
        self.frame_count = 0

    def hear(self, frame: Frame) -> None:
        if frame.can_id in COMMANDS or frame.can_id == PROOF.can_id:
            self._heard.append(frame)
            self._last[frame.can_id] = frame

    def frames(self, count: int, between: bool = False) -> list[Frame]:
        """`between`: a command has been sent and its proof has not: forged commands alone."""
        made: list[Frame] = []
        while len(made) < count and self._heard:
            kind = "forged" if between else self._draw.choice(self.KINDS)
            made += self._make(kind)
            self.sent[kind] += 1
        self.frame_count += len(made)
        return made

    def _make(self, kind: str) -> list[Frame]:
        draw = self._draw
        proof = self._last.get(PROOF.can_id)
        if kind in ("forged", "forged with a proof") or proof is None:
            can_id = draw.choice(COMMANDS)
            length = CODECS_BY_ID[can_id]
            last = self._last.get(can_id)
            counter = (last.data[2] + 1) % 256 if last is not None else draw.randrange(256)
            forged = protected(can_id, draw.randbytes(length), counter)
            return [forged] if kind == "forged" or proof is None else [forged, proof]
        message = PROOF.decode(proof)
        if kind == "replayed":
            at = draw.randrange(len(self._heard))
            return [self._heard[k] for k in range(at, min(at + 4, len(self._heard)))]
        if kind == "rewound":
            step = draw.choice((-3, -1, 1, 2, 100, draw.randrange(0x8000)))
            message = message._replace(proof_counter=(message.proof_counter + step) & 0xFFFF)
        elif kind == "exchanged":
            message = message._replace(
                proof_counter=message.proof_counter + 1,
                valve_mac=message.clutch_mac,
                clutch_mac=message.valve_mac,
                engine_mac=message.valve_mac,
                engine_proven=True,
            )
        elif kind == "drawn":
            message = message._replace(
                proof_counter=min(0xFFFF, message.proof_counter + draw.randrange(1, 9)),
                valve_mac=draw.getrandbits(64),
                clutch_mac=draw.getrandbits(64),
            )
        else:
            data = bytearray(proof.data)
            data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
            return [proof._replace(data=bytes(data))]
        command = self._last[draw.choice([c for c in COMMANDS if c in self._last])]
        return [command, PROOF.encode(draw.randrange(256), message)]


CODECS_BY_ID = {codec.spec.can_id: codec.spec.length for codec in CODECS.values()}


class Attacked:
    """A node that hears the attacker besides, `each` frames behind every proof."""

    def __init__(self, core: VerifyingCore, attacker: Attacker | None, each: int) -> None:
        self.core = core
        self._attacker = attacker
        self._each = each

    @property
    def next_step_us(self) -> int:
        return self.core.next_step_us

    def receive(self, frame: Frame) -> None:
        attacker = self._attacker
        self.core.receive(frame)
        if attacker is None:
            return
        attacker.hear(frame)
        extra: list[Frame] = []
        if frame.can_id == PROOF.can_id:
            extra = attacker.frames(self._each)
        elif frame.can_id in (VALVES, CLUTCH):
            extra = attacker.frames(1, between=True)[: HELD - 3]
        for hostile in extra:
            self.core.receive(hostile)

    def step(self, now_us: int) -> Step:
        return self.core.step(now_us)

    def shutdown(self, now_us: int) -> Step:
        return self.core.shutdown(now_us)


class Run:
    """Controller, rig and an operator; the rig is attacked or not."""

    def __init__(
        self,
        attacker: Attacker | None,
        each: int = 0,
        keys: CommandKeys = KEYS,
        requests: list[tuple[int, int]] = REQUESTS,
    ) -> None:
        sheet = load_sheet("thesis")
        header = new_header(product_version(), sheet, ControllerSettings())
        settings = RigSettings(preset=Preset.THESIS, seed=3, start_gear=8, main_speed_rpm=644.0)
        self.rig = RigCore(sheet, settings)
        draw = random.Random(1)
        self.gate = VerifyingCore(self.rig, KEYS, lambda: draw.getrandbits(64))
        self.frames: list[tuple[int, Frame]] = []
        self.time = VirtualTime(
            [
                ProvingCore(ControllerCore(header), keys),
                Attacked(self.gate, attacker, each),
                Operator(requests),
            ],
            PHASES_US,
            lambda time_us, frame: self.frames.append((time_us, frame)),
        )

    def to(self, time_us: int) -> Run:
        self.time.run(lambda: False, time_us)
        return self


def main(argv: list[str]) -> int:
    """Attacks until this many hostile frames were heard; 1 where the run was changed by them."""
    count, seed = int(argv[0]), int(argv[1]) if len(argv) > 1 else 1
    attacker = Attacker(seed)
    attacked, quiet = Run(attacker, each=200), Run(None)
    began_s, until_us, same = time.monotonic(), 0, True
    while attacker.frame_count < count and same:
        until_us += 500_000
        attacked.to(until_us)
        quiet.to(until_us)
        same = attacked.frames == quiet.frames
        attacked.frames.clear()
        quiet.frames.clear()
    verifier, violations = attacked.gate.verifier, sum(attacked.rig.truth.violations.values())
    print(
        f"{attacker.frame_count} hostile frames, attacks {dict(attacker.sent)}, in "
        f"{until_us / 1e6:g} s of bus time, {time.monotonic() - began_s:.0f} s: "
        f"{verifier.proven} commands proven, {verifier.refused} proofs refused, violations "
        f"{violations}, {'the run is that without them' if same else 'THE RUN WAS CHANGED'}"
    )
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
