"""The impact energy in a shift's row against the rig's own events on the bus, summed apart."""

from __future__ import annotations

from itertools import takewhile

import pytest

from meshpoint.controller.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import EngagementEvent, Message, ReferenceEngagement, ShiftOutcome
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.testbench.loop.setup import Setup
from meshpoint.testbench.loop.simulate import simulate


def is_ready(message: Message) -> bool:
    """The bench has brought the gearbox into the gear that a shift begins with."""
    return isinstance(message, ReferenceEngagement) and message.event is EngagementEvent.READY


def locks(messages: list[Message], gear: int) -> list[float]:
    """The energy lost as this gear locked, J, each time; up to where it is taken out again."""
    events = [m for m in messages if isinstance(m, ReferenceEngagement) and m.gear == gear]
    events = list(takewhile(lambda e: e.event is not EngagementEvent.RELEASED, events))
    return [e.impact_energy_j for e in events if e.event is EngagementEvent.LOCKED]


def test_the_impact_of_a_row_is_that_of_all_locks_of_its_gear_before_and_after_its_end() -> None:
    receiver, messages = Receiver(*Node), list[Message]()

    def take(_time_us: int, frame: Frame) -> None:
        message = receiver.receive(frame).message
        messages.extend([] if message is None else [message])

    setup = Setup(load_sheet("truck12"), ControllerSettings(), seed=7, shifts=2)
    rows = simulate(setup, take).rows
    ends = [k for k, message in enumerate(messages) if isinstance(message, ShiftOutcome)]
    late = 0
    for row, end in zip(rows, ends, strict=True):
        gear = DRIVE_GEARS[row.to].main
        since_ready = list(takewhile(lambda m: not is_ready(m), reversed(messages[:end])))[::-1]
        until_ready = list(takewhile(lambda m: not is_ready(m), messages[end:]))
        before, after = locks(since_ready, gear), locks(until_ready, gear)
        assert row.impact_complete
        assert row.impact_j == pytest.approx(sum(before) + sum(after), abs=1e-9)
        late += bool(after)
    assert late > 0, "each gear of this run locks before its shift's end: take another seed"
