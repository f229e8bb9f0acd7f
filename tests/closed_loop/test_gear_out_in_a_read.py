"""A gear comes out in the middle of a sensors' read: the edges before it are of driven shafts."""

from __future__ import annotations

import numpy as np

from meshpoint.campaigns.draw import draw, upshifts
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.controller.estimate.observer import Observer
from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile

SEED = 900_000_003
"""Gear 13 to 1: behind the low range the driveline swings most."""
SWINGS = {"driveline.stiffness_nm_rad": 20_000.0, "driveline.damping_nms": 20.0}


def test_a_linear_driveline_is_found_to_swing_by_itself_and_by_no_noise() -> None:
    """Propeller shaft and vehicle are a damped oscillator here, and nothing else moves the main
    shaft in neutral. Edges of the gear still in mesh, taken for those of a free shaft, are off by
    up to a degree and count as noise, then of 0.15 to 0.37 rad2/s3."""
    sheet = load_sheet("truck12")
    drawn = draw(SEED, sheet, Preset.TRUCK, upshifts(), 8, SWINGS, Profile.CLEAN)
    loop = ClosedLoop(sheet, ControllerSettings(), Preset.TRUCK, drawn)
    reported = [loop.shift() for _ in drawn.plan]
    observer: Observer = loop.controller.observer
    swing = observer.swings().low
    assert swing is not None
    assert max(swing.noise_rad2_s3, swing.shaft_noise_rad2_s3) < 0.05
    predicted = [row.predicted_phase_sd_deg for row in reported if row is not None]
    last = [sd_deg for sd_deg in predicted if sd_deg is not None][-1]
    # Of it a tenth of a degree and more is the phase reference's own.
    assert last < 0.65


def test_a_batch_of_edges_is_split_at_a_time_and_keeps_every_edge_once() -> None:
    edges = EdgeBatch(
        np.array([1.0, 2.0, 4.0]), np.array([0.1, 0.2, 0.4]), np.array([7, 8, 9]),
        np.array([0, 1, 0]),
    )  # fmt: skip
    for time_us, count in ((0.5, 0), (2.0, 2), (3.0, 2), (9.0, 3)):
        before, after = edges.split(time_us)
        assert before.time_us.tolist() == edges.time_us[:count].tolist()
        for whole, *parts in zip(edges, before, after, strict=True):
            assert np.concatenate(parts).tolist() == whole.tolist()
