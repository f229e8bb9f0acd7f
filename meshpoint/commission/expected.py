"""Every cyclic message that the controller needs: is it there, how often, how old, and intact."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

from meshpoint.commission.finding import Finding, Verdict
from meshpoint.dbc.classic.contract import AUX_CYCLE_MS, ENGINE_CYCLE_MS
from meshpoint.dbc.e2e import ChannelState
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ControllerStatus
from meshpoint.dbc.node import Node
from meshpoint.dbc.specs import MessageSpec
from meshpoint.logs.heard import Heard

GROUP: Final = "messages"
RATE_SHARE: Final = 0.05
"""By which a message's rate may differ from what its cycle time gives."""
EXPECTED: Final[tuple[MessageSpec, ...]] = tuple(
    codec.spec
    for codec in CODECS.values()
    if codec.spec.is_cyclic
    and Node.TRANSMISSION_CONTROL in codec.spec.receivers
    and codec.spec.sender in (Node.GEARBOX_IO, Node.ENGINE)
)


CLASSIC_SLOWER_US: Final = {"EEC1": 1000 * ENGINE_CYCLE_MS, "SleevesAux": 1000 * AUX_CYCLE_MS}
"""Cycle times of the classic profile where they are other than on CAN FD."""
CLASSIC_EXPECTED: Final[tuple[MessageSpec, ...]] = tuple(
    replace(spec, cycle_time_us=CLASSIC_SLOWER_US.get(spec.name, spec.cycle_time_us))
    for spec in EXPECTED
    if not spec.name.endswith("Fall")
)
"""What the frames of a classic bus come to: no falling edges."""


class BusSpan:
    """How long was listened, by the sensor side's own time where it speaks."""

    def __init__(self, heard: Heard) -> None:
        self._heard = heard
        self._begin_us: int | None = None

    def begin(self) -> None:
        """From the first frame on."""
        if self._begin_us is None:
            self._begin_us = self._heard.bus_us

    @property
    def seconds(self) -> float:
        """0 before the first frame."""
        return 0.0 if self._begin_us is None else (self._heard.bus_us - self._begin_us) * 1e-6


def judge_messages(
    heard: Heard, seconds: float, expected: Sequence[MessageSpec] = EXPECTED
) -> Iterator[Finding]:
    """A finding for each expected message, and one for each that is not of the contract."""
    for spec in expected:
        yield _judge(heard, spec, seconds)
    if heard.foreign:
        yield Finding(
            GROUP, "others", Verdict.NOTE,
            f"{heard.foreign} frames are not of our DBC: other nodes' on the same bus",
        )  # fmt: skip
    status = heard.messages[CODECS[ControllerStatus.__name__].spec.can_id]
    if status.frames:
        yield Finding(
            GROUP, "controller", Verdict.BAD,
            "one is at work already: end it first, or watch beside it with --shadow",
        )  # fmt: skip


def _judge(heard: Heard, spec: MessageSpec, seconds: float) -> Finding:
    message = heard.messages[spec.can_id]
    wanted_hz = 1e6 / spec.cycle_time_us
    refused = ", ".join(f"{n} {verdict.name.lower()}" for verdict, n in message.refused.items())
    good = message.frames - sum(message.refused.values())
    if not message.frames:
        return Finding(GROUP, spec.name, Verdict.BAD, f"not heard; {wanted_hz:g} a second wanted")
    if not good or message.newest_s is None:
        return Finding(
            GROUP, spec.name, Verdict.BAD,
            f"{message.frames} frames, none good ({refused}): another DBC, or another data ID",
        )  # fmt: skip
    rate_hz = good / seconds if seconds > 0.0 else 0.0
    age_ms = 1e3 * (heard.now_s - message.newest_s) * heard.pace
    state = heard.state(CODECS[spec.name].message_type)
    text = f"{rate_hz:.1f} a second, {age_ms:.0f} ms old, channel {state.name.lower()}"
    wrong = [] if state is ChannelState.VALID else [f"channel {state.name.lower()}"]
    if refused:
        text += f", refused: {refused}"
        wrong.append(f"refused: {refused}")
    if abs(rate_hz / wanted_hz - 1.0) > RATE_SHARE + 2.0 / (wanted_hz * seconds):
        text += f"; {wanted_hz:g} a second wanted"
        wrong.append(f"{rate_hz:.0f} a second, {wanted_hz:g} wanted")
    verdict = Verdict.BAD if wrong else Verdict.GOOD
    return Finding(GROUP, spec.name, verdict, text, ", ".join(wrong))
