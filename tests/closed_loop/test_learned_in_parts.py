"""What a shift teaches of brake, scatter, friction and swing takes longer to work out than a tick:
it is learned in parts, one a step, once the new gear is in mesh."""

from __future__ import annotations

from dataclasses import astuple
from typing import NamedTuple

import pytest
from loop_bench import Loop

from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.learned import BrakeRecord, NoiseRecord, SwingRecord
from meshpoint.dbc.messages import EngagementEvent, ReferenceEngagement
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile

LIMIT_US, LONGEST_US = 10_000_000, 500_000
ASK_US, STEP_US = 600_000, 10_000
PARTS = 3


class Taught(NamedTuple):
    """What a calibration has of brake, scatter and swing."""

    brake: BrakeRecord | None
    noise: NoiseRecord | None
    swing: SwingRecord | None


def taught(core: ControllerCore) -> Taught:
    known = core.calibration("a test")
    return Taught(known.brake, known.noise, known.swings.high)


def locked() -> Loop:
    """One shift, up to the lock of its gear."""
    loop = Loop(
        requests=[(ASK_US, 10)], toward=10, sheet=load_sheet("truck12"), preset=Preset.TRUCK,
        profile=Profile.CLEAN,
    )  # fmt: skip
    assert loop.until(
        lambda: loop.seen(ReferenceEngagement, event=EngagementEvent.LOCKED), LIMIT_US
    )
    return loop


def numbers(record: BrakeRecord | NoiseRecord | SwingRecord | None) -> list[float]:
    assert record is not None
    parts = [value if isinstance(value, tuple) else (value,) for value in astuple(record)]
    return [float(value) for part in parts for value in part]


def test_brake_scatter_and_swing_are_learned_in_steps_of_their_own() -> None:
    loop, found = locked(), set[Taught]()
    locked_us = loop.time.now_us
    while None in taught(loop.core):
        loop.run(loop.time.now_us + STEP_US)
        found.add(taught(loop.core))
        assert loop.time.now_us < locked_us + LONGEST_US
    assert len(found) >= PARTS


def test_a_controller_that_is_shut_down_at_once_has_learned_what_it_would_have() -> None:
    at_once, later = locked(), locked()
    for loop in (at_once, later):
        loop.run(loop.time.now_us + 2 * STEP_US)
    assert None in taught(at_once.core)
    at_once.core.shutdown(at_once.time.now_us)
    later.run(later.time.now_us + LONGEST_US)
    for one, other in zip(taught(at_once.core), taught(later.core), strict=True):
        assert numbers(one) == pytest.approx(numbers(other), rel=1e-3)
