"""Both ends of an authenticated command link, without I/O.

The receiver draws a challenge now and then. The sender answers with message authentication codes:
AES-128-CMAC over identifier and bytes of a command, the challenge and a counter that rises within
it, cut to 8 bytes, all commands of a step in one frame behind them. A command frame is held until
its proof comes, and is thrown away without: it never reaches the receiver's own checks. So what is
forged, changed, sent again or sent late changes nothing there, not even a counter.

No clock and no memory over a restart are needed: whichever side restarts, the next challenge makes
both agree.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from hmac import compare_digest
from typing import Any, Final, NamedTuple

from meshpoint.bus.authentication.frames import CHALLENGE, PROOF
from meshpoint.bus.command_keys import CommandKeys, KeysError
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS

CHALLENGE_EVERY_US: Final = 50_000
"""A command is taken at most this long, twice, after its challenge was drawn."""
MAC_BYTES: Final = 8
CHALLENGE_BITS: Final = 64
MAX_COUNTER: Final = 0xFFFF
HELD: Final = 4
"""Frames of one command that may wait for a proof; the oldest goes first."""
VALVES: Final = CODECS["ValveCommand"].spec.can_id
CLUTCH: Final = CODECS["ClutchCommand"].spec.can_id
ENGINE: Final = CODECS["TSC1"].spec.can_id
COMMANDS: Final = (ENGINE, VALVES, CLUTCH)
"""By bus priority."""


class _Challenge(NamedTuple):
    number: int
    value: int


class _Macs:
    """Makes the codes. KeysError where the package for it is not installed."""

    def __init__(self, keys: CommandKeys) -> None:
        try:
            from cryptography.hazmat.primitives.ciphers.algorithms import AES
            from cryptography.hazmat.primitives.cmac import CMAC
        except ImportError as error:
            raise KeysError(
                "keys need the package cryptography: pip install meshpoint[authentication]"
            ) from error
        self._begun = {can_id: CMAC(AES(key)) for can_id, key in keys.by_id.items()}

    def of(self, frame: Frame, challenge: _Challenge, counter: int) -> int:
        """The code of a command frame for a challenge and a counter."""
        mac = self._begun[frame.can_id].copy()
        mac.update(
            frame.can_id.to_bytes(4, "little")
            + bytes([frame.is_fd, challenge.number])
            + challenge.value.to_bytes(8, "little")
            + counter.to_bytes(2, "little")
            + frame.data
        )
        return int.from_bytes(mac.finalize()[:MAC_BYTES], "little")


class CommandProver:
    """The sender's end."""

    def __init__(self, keys: CommandKeys) -> None:
        self._macs = _Macs(keys)
        self._challenge: _Challenge | None = None
        self._counter = 0
        self._frames = 0

    def hear(self, frame: Frame) -> None:
        """Any frame of the bus; a challenge is noted."""
        message = CHALLENGE.decode(frame)
        if message is not None:
            challenge = _Challenge(message.challenge_number, message.challenge)
            if challenge != self._challenge:
                self._challenge, self._counter = challenge, 0

    def prove(self, frames: Sequence[Frame]) -> Frame | None:
        """The frame that proves the commands among these; None where there is none, and before the
        first challenge."""
        commands = {frame.can_id: frame for frame in frames if frame.can_id in COMMANDS}
        challenge = self._challenge
        if challenge is None or not commands or self._counter == MAX_COUNTER:
            return None
        self._counter += 1
        macs = {
            can_id: self._macs.of(frame, challenge, self._counter)
            for can_id, frame in commands.items()
        }
        message = PROOF.message(
            valve_proven=VALVES in macs,
            clutch_proven=CLUTCH in macs,
            engine_proven=ENGINE in macs,
            challenge_number=challenge.number,
            proof_counter=self._counter,
            valve_mac=macs.get(VALVES, 0),
            clutch_mac=macs.get(CLUTCH, 0),
            engine_mac=macs.get(ENGINE, 0),
        )
        self._frames += 1
        return PROOF.encode(self._frames - 2, message)


class CommandVerifier:
    """The receiver's end. `draw` gives 64 random bits."""

    def __init__(self, keys: CommandKeys, draw: Callable[[], int]) -> None:
        self._macs = _Macs(keys)
        self._draw = draw
        self._challenges: list[_Challenge] = []
        """The newest, and the one before."""
        self._counters: dict[int, int] = {}
        """The last counter that was proven, by the challenge's number."""
        self._held: dict[int, deque[Frame]] = {can_id: deque(maxlen=HELD) for can_id in COMMANDS}
        self._due_us: int | None = None
        self._drawn = 0
        self.proven = 0
        """Commands passed on."""
        self.refused = 0
        """Proofs that held for no challenge, no counter or no command."""

    def challenge(self, now_us: int) -> Frame | None:
        """A new challenge to be sent, where one is due."""
        if self._due_us is not None and now_us < self._due_us:
            return None
        self._due_us = now_us + CHALLENGE_EVERY_US
        new = _Challenge(self._drawn & 0xFF, self._draw())
        self._drawn += 1
        self._challenges = [new, *self._challenges[:1]]
        numbers = {challenge.number for challenge in self._challenges}
        self._counters = {n: c for n, c in self._counters.items() if n in numbers}
        message = CHALLENGE.message(challenge_number=new.number, challenge=new.value)
        return CHALLENGE.encode(self._drawn - 2, message)

    def receive(self, frame: Frame) -> list[Frame]:
        """The frames to take for this one: itself, unless it is a command, which is held; those
        that a proof proves."""
        held = self._held.get(frame.can_id)
        if held is not None:
            if frame.is_extended:
                held.append(frame)
            return []
        if frame.can_id != PROOF.can_id:
            return [frame]
        message = PROOF.decode(frame)
        return [] if message is None else self._judge(message)

    def _judge(self, proof: Any) -> list[Frame]:
        challenge = self._challenge_of(proof)
        if challenge is None:
            self.refused += 1
            return []
        passed = []
        for can_id, is_there, mac in (
            (ENGINE, proof.engine_proven, proof.engine_mac),
            (VALVES, proof.valve_proven, proof.valve_mac),
            (CLUTCH, proof.clutch_proven, proof.clutch_mac),
        ):
            if is_there:
                found = self._find(can_id, mac, challenge, proof.proof_counter)
                passed += [] if found is None else [found]
        if passed:
            self._counters[challenge.number] = proof.proof_counter
            self.proven += len(passed)
        else:
            self.refused += 1
        return passed

    def _challenge_of(self, proof: Any) -> _Challenge | None:
        """The challenge a proof may answer: its counter must be new, and once the newest has been
        answered the one before is over."""
        for index, challenge in enumerate(self._challenges):
            if challenge.number == proof.challenge_number:
                over = index == 1 and self._challenges[0].number in self._counters
                is_new = proof.proof_counter > self._counters.get(challenge.number, 0)
                return challenge if is_new and not over else None
        return None

    def _find(self, can_id: int, mac: int, challenge: _Challenge, counter: int) -> Frame | None:
        """The held frame that the code is of; it and the older ones are held no more."""
        held, wanted = self._held[can_id], mac.to_bytes(MAC_BYTES, "little")
        for index in range(len(held) - 1, -1, -1):
            code = self._macs.of(held[index], challenge, counter)
            if compare_digest(code.to_bytes(MAC_BYTES, "little"), wanted):
                frame = held[index]
                for _ in range(index + 1):
                    held.popleft()
                return frame
        return None
