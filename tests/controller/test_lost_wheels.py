"""What the observer gives up when a wheel may have stood, or its sensor's clock is another: every
phase reference, once, and says so."""

from __future__ import annotations

import math
from typing import Any

import pytest
from wheel import capture

from meshpoint.controller.estimate.observer import Observer
from meshpoint.controller.measure.inputs import StepInputs
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.messages import (
    EdgesLayshaftFall,
    EdgesLayshaftRise,
    EdgesMainFall,
    EdgesMainRise,
    Estimator,
    ReferenceSource,
    SleevesAux,
    SleevesMain,
)
from meshpoint.gearbox import MainGear, load_sheet

SHEET = load_sheet("truck12")
BEGIN_US, CYCLE_US, TOOTH_US = 1 << 20, 10_000, 1_000
SHAFTS: dict[str, tuple[Any, Any]] = {
    "layshaft": (EdgesLayshaftRise, EdgesLayshaftFall), "main": (EdgesMainRise, EdgesMainFall),
}  # fmt: skip
LOST = "tooth numbers lost: phase references unknown again"
GEAR = MainGear.SECOND


class Gearbox:
    """Two shafts that turn evenly, a tooth a millisecond, and what the observer makes of them."""

    def __init__(self, estimator: Estimator) -> None:
        self.observer = Observer(SHEET, ControllerSettings(), estimator)
        self.edges = {name: [BEGIN_US + TOOTH_US * k for k in range(-50, 900)] for name in SHAFTS}
        self.now_us, self.events = BEGIN_US, list[str]()
        self.ahead_us = self.late_us = 0

    def run(self, seconds: float) -> Gearbox:
        for _ in range(round(1e6 * seconds / CYCLE_US)):
            self.now_us += CYCLE_US
            inputs, read_us = StepInputs(), self.now_us + self.ahead_us
            for name, kinds in SHAFTS.items():
                for kind, after_us in zip(kinds, (0, 500), strict=True):
                    seen = [each + after_us + self.ahead_us for each in self.edges[name]]
                    inputs.edges[kind].append(kind(**capture(seen, 1, read_us)))
            inputs.take(SleevesMain(sample_time_us=read_us))
            inputs.take(SleevesAux(read_us, 0, *[(SHEET.sleeve.stroke_m,) * 10] * 2))
            self.observer.take(inputs, self.now_us + self.late_us, self.events)
        return self

    @property
    def knows(self) -> bool:
        return self.observer.references.known(GEAR)


def running(estimator: Estimator = Estimator.CROSSING) -> Gearbox:
    """For a fifth of a second, with a reference."""
    box = Gearbox(estimator).run(0.2)
    box.observer.references.adopt(GEAR, 0.02, ReferenceSource.RESTORED)
    assert not box.run(0.05).events
    return box


@pytest.mark.parametrize("estimator", [Estimator.CROSSING, Estimator.THESIS, Estimator.WINDOW])
@pytest.mark.parametrize("wheel", [None, "layshaft", "main"])
def test_a_wheel_that_may_have_stood_costs_every_reference_once(
    estimator: Estimator, wheel: str | None
) -> None:
    box = running(estimator)
    if wheel is not None:
        box.edges[wheel] = [each for each in box.edges[wheel] if each <= box.now_us]
    box.run(0.2)
    assert box.knows is (wheel is None)
    assert box.events == ([] if wheel is None else [LOST])
    main = box.observer.main_at(box.now_us)
    assert (main is None) is (wheel == "main")
    if main is not None:
        pitches = main.omega_rad_s * SHEET.wheels.main.teeth / (2.0 * math.pi)
        assert pitches == pytest.approx(1e6 / TOOTH_US, rel=0.02)


def test_a_sensor_clock_that_jumps_costs_every_reference_and_all_teeth_start_anew() -> None:
    """What came in the step of the jump is of two clocks; both shafts are seen again soon."""
    box = running()
    box.ahead_us = 3_000_000
    box.run(0.01)
    assert box.events == ["sensor clock jumped: teeth and phases start anew", LOST]
    assert not box.knows
    assert box.observer.main_at(box.now_us) is None
    box.run(0.2)
    assert len(box.events) == 2
    assert box.observer.main_at(box.now_us + box.ahead_us) is not None


def test_frames_that_come_late_cost_nothing_and_are_said_once() -> None:
    """A bus or machine that is overloaded, and not another clock."""
    box = running()
    box.late_us = 700_000
    box.run(0.1)
    assert box.events == ["sensor frames come over 500 ms late: bus or machine overloaded"]
    assert box.knows
