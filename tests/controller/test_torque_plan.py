"""The plan by which the engine's torque is taken away."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from meshpoint.controller.shift.engine import unload

DECAY_S = 0.1
LEFT_NM = 2_730.0


def swings_down() -> Any:
    """A driveline whose swing dies away by itself, whatever the engine is asked for. To wait until
    t costs t, and 2 ms for each Nm that is left: least after 0.4 s."""
    return SimpleNamespace(
        state=np.eye(6)[0],
        left_nm=LEFT_NM * np.eye(5, 6),
        coasting_nm=0.0,
        within=lambda seconds: np.diag([math.exp(-seconds / DECAY_S), *np.ones(6)]),
    )


@pytest.mark.parametrize("step_ms", [5, 10, 20])
def test_it_looks_as_far_ahead_whatever_its_steps_are(step_ms: int) -> None:
    """Red before: of 5 ms it looked 0.3 s ahead, of 20 ms 1.2 s."""
    plan = unload(swings_down(), 0.0, 1e-3 * step_ms, 1, None)
    assert plan is not None
    assert step_ms * (plan.steps - 1) == 400
    assert plan.left_nm == pytest.approx(LEFT_NM * math.exp(-1e-3 * step_ms * plan.steps / DECAY_S))
