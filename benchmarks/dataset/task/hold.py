"""Baseline `hold`: both shafts keep the speed that they last had (thesis 5.12).

The speed is that of production: teeth in the last 10 ms over the time they took.

    python hold.py SET -o hold.csv
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from known import Prediction, Shift, run

WINDOW_US = 10_000


def angle_deg(times_us: np.ndarray, index: np.ndarray, teeth: int, at_us: float) -> float:
    """A shaft's angle later on, at the speed of its last 10 ms."""
    start = max(0, int(np.searchsorted(times_us, times_us[-1] - WINDOW_US, side="right")) - 1)
    turned_deg = (index[-1] - index[start]) * 360.0 / teeth
    speed_deg_us = turned_deg / (times_us[-1] - times_us[start])
    return index[-1] * 360.0 / teeth + speed_deg_us * (at_us - times_us[-1])


def predict(shift: Shift, gearbox: dict[str, Any]) -> Prediction:
    """The phase at contact."""
    teeth, at_us = gearbox["wheel_teeth"], shift.contact_us
    layshaft_deg = angle_deg(*shift.edges("layshaft"), teeth["layshaft"], at_us)
    main_deg = angle_deg(*shift.edges("main"), teeth["main"], at_us)
    return Prediction(shift.phase_deg(layshaft_deg, main_deg))


if __name__ == "__main__":
    sys.exit(run(predict, __doc__))
