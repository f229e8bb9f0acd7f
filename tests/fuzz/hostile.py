"""Hostile frames, drawn from a seed and from what was heard on the bus."""

from __future__ import annotations

import random
from collections import Counter, deque

from meshpoint.dbc.e2e import write_crc
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.node import Node

SPECS = {codec.spec.can_id: codec.spec for codec in CODECS.values()}
LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
COMMANDS = frozenset(
    spec.can_id for spec in SPECS.values() if spec.name in ("ValveCommand", "ClutchCommand", "TSC1")
)
BENCH = frozenset(spec.can_id for spec in SPECS.values() if spec.sender is Node.BENCH)
"""The operator's hand: what it asks for is done. Nobody forges it here."""
ACCIDENTS = ("unknown", "junk", "misshapen", "flipped", "repeated")
"""What noise, a faulty node or one of another make may put onto a bus."""
ATTACKS = (*ACCIDENTS, "protected", "replayed")
"""Besides, by somebody who knows the contract: right CRC, right counter."""


class Hostile:
    """Makes frames of these kinds; `spared` identifiers are not used for protected or replayed
    ones, nor for frames that have no protection."""

    def __init__(self, seed: int, kinds: tuple[str, ...], spared: frozenset[int]) -> None:
        self._draw = random.Random(seed)
        self._kinds = kinds
        self._spared = spared
        self._ids = list(SPECS)
        self._forgeable = [can_id for can_id in SPECS if can_id not in spared]
        self._heard: deque[Frame] = deque(maxlen=4_000)
        self._last: dict[int, Frame] = {}
        self.made: Counter[str] = Counter()

    def hear(self, frame: Frame) -> None:
        """A frame of the bus as it was sent."""
        if frame.can_id in SPECS:
            self._heard.append(frame)
            self._last[frame.can_id] = frame

    def frames(self, count: int) -> list[Frame]:
        """This many, once something has been heard."""
        if not self._heard:
            return []
        return [self._one() for _ in range(count)]

    def _one(self) -> Frame:
        kind = self._draw.choice(self._kinds)
        self.made[kind] += 1
        frame: Frame = getattr(self, f"_{kind}")()
        if frame.can_id in self._spared and not self._is_refused(frame):
            return self._unknown()
        return frame

    def _is_refused(self, frame: Frame) -> bool:
        """Whether a frame of a spared identifier cannot pass: of a protected one, damaged."""
        spec = SPECS[frame.can_id]
        return spec.is_protected and frame not in self._heard

    def _unknown(self) -> Frame:
        draw, extended = self._draw, self._draw.random() < 0.5
        can_id = draw.getrandbits(29 if extended else 11)
        while extended and can_id in SPECS:
            can_id = draw.getrandbits(29)
        return Frame(can_id, draw.randbytes(draw.choice(LENGTHS)), draw.random() < 0.5, extended)

    def _junk(self) -> Frame:
        spec = SPECS[self._draw.choice(self._ids)]
        return Frame(spec.can_id, self._draw.randbytes(spec.length), spec.is_fd)

    def _misshapen(self) -> Frame:
        draw, spec = self._draw, SPECS[self._draw.choice(self._ids)]
        length = draw.choice([n for n in LENGTHS if n != spec.length])
        is_fd = draw.random() < 0.5 or length > 8
        return Frame(spec.can_id, draw.randbytes(length), is_fd, draw.random() < 0.9)

    def _flipped(self) -> Frame:
        draw, frame = self._draw, self._draw.choice(self._heard)
        data = bytearray(frame.data)
        for _ in range(draw.choice((1, 1, 2, 3, 8))):
            data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
        return frame._replace(data=bytes(data))

    def _repeated(self) -> Frame:
        """The newest of its identifier once more."""
        return self._last[self._draw.choice(list(self._last))]

    def _replayed(self) -> Frame:
        """One of before, as it was or with the counter that is due."""
        frame = self._draw.choice(self._heard)
        return frame if self._draw.random() < 0.5 else self._with_counter(frame.can_id, frame.data)

    def _protected(self) -> Frame:
        """Any content, with the CRC and the counter that are due."""
        spec = SPECS[self._draw.choice(self._forgeable)]
        return self._with_counter(spec.can_id, self._draw.randbytes(spec.length))

    def _with_counter(self, can_id: int, data: bytes) -> Frame:
        spec, buffer = SPECS[can_id], bytearray(data)
        if spec.data_id is not None:
            last = self._last.get(can_id)
            counter = self._draw.randrange(256) if last is None else last.data[2]
            buffer[2] = (counter + self._draw.choice((0, 0, 0, 1, 255, 100))) % 256
            write_crc(buffer, spec.data_id)
        return Frame(can_id, bytes(buffer), spec.is_fd)
