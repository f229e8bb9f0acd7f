"""The impact energy in a shift's row against the rig's own events on the bus, summed apart."""

from __future__ import annotations

from itertools import takewhile

import pytest

from meshpoint.bench.setup import Setup
from meshpoint.bench.simulate import simulate
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import EngagementEvent, Message, ReferenceEngagement, ShiftOutcome
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.rig_sim.settings import Profile


def is_ready(message: Message) -> bool:
    """The bench has brought the gearbox into the gear that a shift begins with."""
    return isinstance(message, ReferenceEngagement) and message.event is EngagementEvent.READY


def locks(messages: list[Message], gear: int) -> list[float]:
    """The energy lost as this gear locked, J, each time."""
    events = [m for m in messages if isinstance(m, ReferenceEngagement) and m.gear == gear]
    return [e.impact_energy_j for e in events if e.event is EngagementEvent.LOCKED]


def until_out(messages: list[Message], gear: int) -> list[Message]:
    """The messages up to where this gear is taken out again."""

    def is_in(message: Message) -> bool:
        is_of_gear = isinstance(message, ReferenceEngagement) and message.gear == gear
        return not (is_of_gear and message.event is EngagementEvent.RELEASED)

    return list(takewhile(is_in, messages))


def energies(
    seed: int, profile: Profile = Profile.TYPICAL
) -> list[tuple[float, list[float], list[float]]]:
    """Of each shift of a run: what its row says, and of its gear's locks before and after its
    end."""
    receiver, messages = Receiver(*Node), list[Message]()

    def take(_time_us: int, frame: Frame) -> None:
        message = receiver.receive(frame).message
        messages.extend([] if message is None else [message])

    settings = ControllerSettings()
    setup = Setup(load_sheet("truck12"), settings, profile=profile, seed=seed, shifts=2)
    rows = simulate(setup, take).rows
    ends = [k for k, message in enumerate(messages) if isinstance(message, ShiftOutcome)]
    said = []
    for row, end in zip(rows, ends, strict=True):
        assert row.impact_complete
        gear = DRIVE_GEARS[row.to].main
        since_ready = list(takewhile(lambda m: not is_ready(m), reversed(messages[:end])))[::-1]
        until_ready = list(takewhile(lambda m: not is_ready(m), messages[end:]))
        after = locks(until_out(until_ready, gear), gear)
        said.append((row.impact_j, locks(since_ready, gear), after))
    return said


def test_the_impact_of_a_row_is_that_of_all_locks_of_its_gear_before_and_after_its_end() -> None:
    """Also of one that has locked, gone out again and locked once more."""
    said = energies(10) + energies(20, Profile.HARSH)
    for impact_j, before, after in said:
        assert impact_j == pytest.approx(sum(before) + sum(after), abs=1e-9)
    assert any(after for _, _, after in said), "each gear locks before its end: take other seeds"
    assert any(len(before) > 1 for _, before, _ in said), "no gear locks twice: take other seeds"
