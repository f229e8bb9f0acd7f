"""The controller's states as people read them."""

from __future__ import annotations

from meshpoint.dbc.messages import ControllerState, ControllerStatus


def state_words(state: ControllerState) -> str:
    """A state in a word or a few, for a line that says more than it."""
    if state is ControllerState.HALTED:
        return "waiting before the teeth"
    return state.name.lower().replace("_", " ")


def standing_words(status: ControllerStatus) -> str:
    """Where the controller stands: in which gear, or its state."""
    if status.state is ControllerState.IN_GEAR:
        return f"in gear {status.current_gear}"
    return state_words(status.state)
