"""A calibration file with everything in it, and the data sheet that it is of."""

from __future__ import annotations

import math

from meshpoint.controller.settings.learned import (
    BrakeRecord,
    Calibration,
    End,
    NoiseRecord,
    Provenance,
    ReferenceRecords,
    SleeveRecord,
    SleeveRecords,
    SwingRecord,
    SwingRecords,
    WheelRecord,
    WheelRecords,
)
from meshpoint.gearbox import load_sheet
from meshpoint.units import DEG

SHEET = load_sheet("thesis")


def example() -> Calibration:
    """One with everything in it."""
    sleeve = SleeveRecord(0.045, 6.5, 0.0012, 10.0)
    four = (1.1, 0.9, 1.0, 1.2)
    sds = (0.1,) * 4
    pattern = tuple(0.05 * DEG * math.sin(7.0 * k) for k in range(90))
    return Calibration(
        format_=1,
        provenance=Provenance("0.1.0", SHEET.name, SHEET.sha256, "one evening", 12),
        wheels=WheelRecords(
            WheelRecord(45, 6895, 1e-4, pattern), WheelRecord(45, 5466, 1e-4, pattern)
        ),
        references=ReferenceRecords(second_rad=0.05, third_rad=-0.03),
        brake=BrakeRecord(12, 0.96, 0.01, -6.0, 0.5, 8e3, 5e3, 3.2e-3, 1e-3, four, sds, four,
                          sds, 0.0098, 1e-4, 0.0083, 2e-4),
        noise=NoiseRecord(12, 8e-6, 0.1, 9e-6, 0.1, 1.2, 0.2, 0.03, 0.2, 0.09, 0.3),
        swings=SwingRecords(high=SwingRecord(5, 120.0, 0.01, 0.05, 0.1, 1.0, 0.3, 0.1, 0.2, 0.2,
                            0.3, 2.0, 0.3, True, 0.01, 0.05)),
        sleeves=SleeveRecords(second=sleeve),
        end=End(True),
    )  # fmt: skip


TEXT = example().to_text()
