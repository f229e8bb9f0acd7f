"""A core whose commands are proven, and one that takes proven commands alone."""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter

from meshpoint.bus.authentication.proof import CommandProver, CommandVerifier
from meshpoint.bus.command_keys import CommandKeys
from meshpoint.bus.core import AroundCore, Core, Step
from meshpoint.dbc.frame import Frame

_identifier = itemgetter(0)


class ProvingCore(AroundCore[Core]):
    """Sends the proof of its core's commands behind them."""

    def __init__(self, core: Core, keys: CommandKeys) -> None:
        super().__init__(core)
        self._prover = CommandProver(keys)

    def receive(self, frame: Frame) -> None:
        """As the core does; challenges are noted on the way."""
        self._prover.hear(frame)
        self._core.receive(frame)

    def step(self, now_us: int) -> Step:
        """The core's frames and the proof, in order of bus priority."""
        return self._proven(self._core.step(now_us))

    def shutdown(self, now_us: int) -> Step:
        """The core's last frames, proven as well."""
        return self._proven(self._core.shutdown(now_us))

    def _proven(self, step: Step) -> Step:
        proof = self._prover.prove(step.frames)
        if proof is None:
            return step
        return Step(sorted([*step.frames, proof], key=_identifier), step.events)


class VerifyingCore(AroundCore[Core]):
    """Hands its core commands that are proven, and everything else; sends challenges."""

    def __init__(self, core: Core, keys: CommandKeys, draw: Callable[[], int]) -> None:
        super().__init__(core)
        self.verifier = CommandVerifier(keys, draw)
        self._refused_reported = 0

    def receive(self, frame: Frame) -> None:
        """Commands wait here for their proof."""
        for passed in self.verifier.receive(frame):
            self._core.receive(passed)

    def step(self, now_us: int) -> Step:
        """The core's step, and a challenge where one is due."""
        step = self._core.step(now_us)
        challenge = self.verifier.challenge(now_us)
        refused = self.verifier.refused
        events = step.events
        if challenge is not None and refused > self._refused_reported:
            new, self._refused_reported = refused - self._refused_reported, refused
            events = [*events, f"{new} proofs of commands refused: forged, late or damaged"]
        return Step(step.frames if challenge is None else [*step.frames, challenge], events)
