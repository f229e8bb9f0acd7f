"""A shift asked for soon after another: the clutch opens once it is known what the shafts carry."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from shift_box import TICK_US, Box, aimed

from meshpoint.controller.settings.settings import ControllerSettings, EngineRequests
from meshpoint.controller.shift.engine import KNOWN_MS

FOR_EVER = 10_000_000


def opens_after_ms(
    known_ms: int, twists: bool = True, settings: ControllerSettings | None = None
) -> float:
    """From the request until the clutch sets off, of a driveline that is known so much later."""
    box: Box = aimed(7, settings=settings or ControllerSettings())
    box.sequence.rings.twists = box.sequence.rings.is_beyond_noise = twists
    asked_us = box.now_us
    plain = box.snapshot

    def snapshot(**other: Any) -> Any:
        is_early = box.now_us - asked_us < 1_000 * known_ms
        loaded = SimpleNamespace(is_early=is_early, twist=lambda _: None)
        return plain(**({"loaded": loaded} | other))

    box.snapshot = snapshot  # type: ignore[method-assign]
    box.ask(9)
    for _ in range(200):
        box.step()
        shift = box.sequence.shift
        if shift is not None and shift.clutch_us is not None:
            return (shift.clutch_us - asked_us) / 1_000
    raise AssertionError("the clutch does not open")


def test_the_clutch_waits_until_the_shafts_are_known() -> None:
    at_once_ms = opens_after_ms(0)
    assert opens_after_ms(150) == pytest.approx(at_once_ms + 150, abs=TICK_US / 1_000)


def test_it_waits_no_longer_than_that_takes() -> None:
    assert opens_after_ms(FOR_EVER) == pytest.approx(KNOWN_MS, abs=3 * TICK_US / 1_000)


def test_a_rigid_driveline_is_not_waited_for_nor_one_whose_torque_is_taken_away_at_once() -> None:
    at_once = ControllerSettings(engine=EngineRequests(swing_ramp_ms=0))
    assert opens_after_ms(FOR_EVER, twists=False) == opens_after_ms(0, twists=False)
    assert opens_after_ms(FOR_EVER, settings=at_once) == opens_after_ms(0, settings=at_once)
