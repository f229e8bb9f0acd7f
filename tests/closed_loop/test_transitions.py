"""The state machine of a shift, as those see it who look on."""

from __future__ import annotations

import itertools

from loop_bench import Loop

from meshpoint.controller.shift.table import TRANSITIONS, Trigger
from meshpoint.dbc.messages import ControllerState as State


def test_who_looks_on_is_reported_every_transition_of_the_table() -> None:
    """Each begins in the state in which the one before has ended; and a command that the guard
    blocks while the sleeve is to be fired has it withdrawn, and the shift goes on."""
    loop = Loop([(300_000, 10)])
    core = loop.core
    sequence = core.sequence
    reported: list[tuple[State, Trigger]] = []
    sequence.on_transition = lambda state, trigger: reported.append((state, trigger))
    until_us = 0
    while sequence.state is not State.ENGAGING:
        until_us += 10_000
        loop.run(until_us)
        assert until_us < 3_000_000
    assert core.snapshot is not None
    count = len(reported)
    sequence.blocked(1, core.snapshot)
    assert reported[count:] == [(State.ENGAGING, Trigger.BLOCKED)]
    assert sequence.state is TRANSITIONS[State.ENGAGING, Trigger.BLOCKED]
    loop.run(until_us + 2_000_000)
    assert sequence.state is State.IN_GEAR
    for before, after in itertools.pairwise(reported):
        assert TRANSITIONS[before] is after[0]
    assert TRANSITIONS[reported[-1]] is State.IN_GEAR
    assert {state for state, _ in reported} > {State.IN_GEAR, State.SYNCHRONISING, State.ENGAGING}
