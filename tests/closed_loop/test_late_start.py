"""A controller whose first steps came late, as on a busy machine, and took the sensor clock to be
further behind than it is: it hears that activations are refused, and looks at the clock anew."""

from __future__ import annotations

from loop_bench import Loop

from meshpoint.controller.core import ControllerCore
from meshpoint.dbc.messages import ShiftResult, ValveStatus

REQUEST_US = 60_000
LOST_US = 500_000
"""As if the clock had just been looked at then: a second later it would be again."""


def test_a_refused_activation_has_the_clock_looked_at_anew_and_the_shift_goes_on() -> None:
    loop = Loop(requests=[(REQUEST_US, 10)], phases_us=(0, 3_000, 5_000))
    core = loop.controller.core
    assert isinstance(core, ControllerCore)
    core._probe.is_armed, core._probe._probed_us = False, LOST_US
    assert loop.until(lambda: bool(loop.outcomes), 4_000_000)
    (outcome,) = loop.outcomes
    assert outcome.result is ShiftResult.ENGAGED
    assert loop.last(ValveStatus).refused_count == 1
    assert loop.time.now_us < 1_000_000, "each of its activations was refused, one after another"
