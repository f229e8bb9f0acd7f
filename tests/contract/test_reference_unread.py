"""The reference sensors are truth for logs; the controller never reads them."""

from __future__ import annotations

import math
import random

from loop_bench import Loop

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import FrameVerdict, Receiver, Transmitter
from meshpoint.dbc.messages import (
    ControllerStatus,
    EngagementEvent,
    MainGear,
    ReferenceEncoder,
    ReferenceEngagement,
    ReferencePhase,
)
from meshpoint.dbc.node import Node

TRUTH = {
    CODECS[kind.__name__].spec.can_id: kind
    for kind in (ReferenceEncoder, ReferencePhase, ReferenceEngagement)
}
STATUS_ID = CODECS[ControllerStatus.__name__].spec.can_id


class Liar:
    """Sends other truths under the same identifiers, with good CRCs and counters."""

    def __init__(self, seed: int) -> None:
        self._chance = random.Random(seed)
        self._transmitter = Transmitter(Node.REFERENCE)
        self.lies = 0

    def __call__(self, frame: Frame) -> list[Frame]:
        kind = TRUTH.get(frame.can_id)
        if kind is None:
            return [frame]
        self.lies += 1
        lie = self._transmitter.encode(self._invent(kind))
        assert lie.can_id == frame.can_id
        return [lie, self._transmitter.encode(self._invent(kind))]

    def _invent(self, kind: type) -> ReferenceEncoder | ReferencePhase | ReferenceEngagement:
        chance = self._chance
        time_us = chance.randrange(1 << 32)
        if kind is ReferenceEncoder:
            angles = tuple(chance.uniform(0.0, 1600.0) for _ in range(5))
            return ReferenceEncoder(time_us, angles, (chance.uniform(-300.0, 300.0),) * 5)
        if kind is ReferencePhase:
            phases = [chance.uniform(-0.06, 0.06) for _ in range(4)]
            main = chance.uniform(0.0, 1600.0), chance.uniform(0.0, 200.0)
            return ReferencePhase(time_us, *main, *phases)
        return ReferenceEngagement(
            time_us,
            chance.choice(list(EngagementEvent)),
            chance.choice(list(MainGear)),
            chance.uniform(-0.06, 0.06),
            chance.uniform(-5.0, 5.0),
            chance.randint(0, 14),
        )


def test_the_controller_is_no_receiver_of_the_reference() -> None:
    """In the contract, and in the codec that follows it."""
    receiver, transmitter = Receiver(Node.TRANSMISSION_CONTROL), Transmitter(Node.REFERENCE)
    for kind in TRUTH.values():
        received = receiver.receive(transmitter.encode(kind()))
        assert received.verdict is FrameVerdict.NOT_FOR_US
        assert received.message is None


def test_a_lying_reference_changes_no_byte_of_what_the_controller_says() -> None:
    """Aimed shifts with the true reference, with two lying ones, and with none: all frames of the
    controller are the same but for the status frame, which counts what was consumed."""

    def said(loop: Loop) -> list[tuple[int, bytes]]:
        return [
            (frame.can_id, frame.data)
            for _, frame in loop.frames
            if frame.can_id & 0xFF == 0x03 and frame.can_id != STATUS_ID
        ]

    liar = Liar(4)
    true = Loop(shifts=3).run(30_000_000)
    lied_to = Loop(shifts=3, receiving=liar).run(30_000_000)
    deaf = Loop(shifts=3, receiving=lambda f: [] if f.can_id in TRUTH else [f]).run(30_000_000)
    assert liar.lies > 500
    assert [outcome.to_gear for outcome in true.outcomes] == [10, 12, 10]
    assert math.isfinite(true.outcomes[2].predicted_phase_rad)
    assert len(said(true)) > 1000
    assert said(lied_to) == said(true)
    assert said(deaf) == said(true)
