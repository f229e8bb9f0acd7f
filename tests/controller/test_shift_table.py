"""The table of the shift sequence: no state without a way in, none without a way out."""

from __future__ import annotations

import pytest

from meshpoint.controller.shift.table import TRANSITIONS, Trigger
from meshpoint.dbc.messages import ControllerState as State

RESTING = {State.IN_GEAR, State.NEUTRAL}


def reachable(start: State, avoid: frozenset[Trigger] = frozenset()) -> set[State]:
    found, todo = {start}, [start]
    while todo:
        state = todo.pop()
        for (from_, trigger), to in TRANSITIONS.items():
            if from_ is state and trigger not in avoid and to not in found:
                found.add(to)
                todo.append(to)
    return found


def test_every_state_can_be_reached_and_every_trigger_is_used() -> None:
    assert reachable(State.STARTING) == set(State)
    assert {trigger for _, trigger in TRANSITIONS} == set(Trigger)


@pytest.mark.parametrize("state", State)
def test_every_state_leads_to_rest(state: State) -> None:
    assert reachable(state) & RESTING


@pytest.mark.parametrize(
    "state", sorted(set(State) - RESTING - {State.STARTING, State.CLUTCH_CLOSING})
)
def test_a_shift_that_fails_comes_to_rest_without_trying_for_ever(state: State) -> None:
    """From every state of a shift GAVE_UP, or the way to a state that has it, leads to rest with
    no further engagement."""
    again = frozenset({Trigger.FIRED, Trigger.ENGAGED, Trigger.REQUESTED, Trigger.BRAKE_RELEASED})
    assert reachable(state, again) & RESTING


def test_the_controller_never_goes_back_to_starting() -> None:
    assert State.STARTING not in TRANSITIONS.values()


def test_a_sleeve_is_fired_only_after_the_clutch_was_open_and_the_box_in_neutral() -> None:
    """The order of thesis 2.2: without these triggers the gear is out of reach. The brake's release
    may follow the firing, planned with it; that it comes before contact is the guard's row 5."""
    for missing in (Trigger.CLUTCH_OPEN, Trigger.MAIN_BOX_NEUTRAL):
        assert State.ENGAGING not in reachable(State.IN_GEAR, frozenset({missing}))
