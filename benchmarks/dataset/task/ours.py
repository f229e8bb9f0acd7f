"""Baseline `ours`: what meshpoint's controller had predicted itself, as it said on the bus.

Its newest prediction of a contact is of the contact that it expected; the slip it expected moves
the phase to the contact that came. Where it had predicted none yet, or none with a standard
deviation of less than half a pitch, its newest estimate of phase and slip is held.

    python ours.py SET -o ours.csv
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from known import Prediction, Shift, run

DEG_US_A_RPM = 6e-6
"""Degrees in a microsecond at one revolution a minute."""


def predict(shift: Shift, gearbox: dict[str, Any]) -> Prediction:  # noqa: ARG001
    """The phase at contact."""
    said, pitch = shift.tables.get("predictions", {}), shift.row["pitch_deg"]
    if (number := _newest(said, pitch)) is not None:
        newest, from_us = _row(said, number), "contact_us"
    else:
        estimates = shift.tables["estimates"]
        newest, from_us = _row(estimates, np.flatnonzero(estimates["phase_known"])[-1]), "time_us"
    moved_deg = newest["slip_rpm"] * DEG_US_A_RPM * (shift.contact_us - newest[from_us])
    phase = newest["phase_deg"] + moved_deg
    return Prediction(phase - pitch * np.floor(phase / pitch + 0.5), newest["phase_sd_deg"])


def _newest(said: dict[str, np.ndarray], pitch_deg: float) -> int | None:
    """The newest prediction that says something of a contact's phase."""
    if not said:
        return None
    sd = said["phase_sd_deg"]
    of_use = np.flatnonzero((sd > 0.0) & (sd < 0.5 * pitch_deg) & ~np.isnan(said["contact_us"]))
    return int(of_use[-1]) if of_use.size else None


def _row(columns: dict[str, np.ndarray], number: int) -> dict[str, Any]:
    return {name: of[number] for name, of in columns.items()}


if __name__ == "__main__":
    sys.exit(run(predict, __doc__))
