"""A firing that the valve side refused, because it heard of it too late: the sleeve is fired anew
at once, and does not wait for a contact that cannot come."""

from __future__ import annotations

import pytest
from loop_bench import Loop

from meshpoint.controller.core.core import ControllerCore
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver, Transmitter
from meshpoint.dbc.messages import (
    ControllerState,
    ShiftOutcome,
    ShiftResult,
    ValveAction,
    ValveCommand,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset

MAIN_VALVES = range(3, 7)
"""Of the nine valves, those that move the main box's sleeves."""
LATE_US = 3_000
"""The valve side refuses an activation that it first hears of more than 2 ms late."""
TOOTH_US = 200_000
"""By then a firing has been refused, seen to be, and the next gap has come by."""


class HeldUp:
    """On the way to the valve side: the first firing of a sleeve is heard too late."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._receiver, self._transmitter = Receiver(*Node), Transmitter(Node.TRANSMISSION_CONTROL)
        self.fired: list[int] = []
        """Activation times of sleeves in the controller's commands, each reported once."""

    def __call__(self, frame: Frame) -> list[Frame]:
        message = self._receiver.receive(frame).message
        if type(message) is not ValveCommand:
            return [frame]
        said = list(message)
        for valve in MAIN_VALVES if self._is_pushing else ():
            if said[valve] is ValveAction.ON_AT:
                time_us = said[valve + 9]
                if time_us not in self.fired:
                    self.fired.append(time_us)
                if time_us == self.fired[0] and self._sensor_us < time_us + LATE_US:
                    said[valve] = ValveAction.OFF_NOW
        return [self._transmitter.encode(ValveCommand._make(said))]

    @property
    def _controller(self) -> ControllerCore:
        return self._loop.core

    @property
    def _is_pushing(self) -> bool:
        """Whether a sleeve that is driven now is pushed into a gear, not pulled out of one."""
        return self._controller.sequence.state in (
            ControllerState.COASTING,
            ControllerState.ENGAGING,
        )

    @property
    def _sensor_us(self) -> int:
        assert self._controller.snapshot is not None
        return self._controller.snapshot.now_us


@pytest.mark.parametrize(
    ("preset", "sheet"), [(Preset.THESIS, "thesis"), (Preset.TRUCK, "truck12")]
)
def test_a_refused_firing_is_followed_by_another_at_once(preset: Preset, sheet: str) -> None:
    loop = Loop(requests=[(300_000, 10)], sheet=load_sheet(sheet), preset=preset, toward=10)
    held_up = HeldUp(loop)
    loop.rig.receiving = held_up
    loop.until(lambda: loop.last(ShiftOutcome) is not None, 5_000_000)
    assert max(status.refused_count for status in loop.of(ValveStatus)) == 1
    assert loop.last(ShiftOutcome).result is ShiftResult.ENGAGED, "\n".join(loop.events)
    first_us, second_us = held_up.fired[:2]
    assert 0 < (second_us - first_us) % (1 << 32) < TOOTH_US
