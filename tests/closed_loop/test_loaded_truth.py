"""The driveline while a gear is in mesh, against the rig's own truth as the gear comes out."""

from __future__ import annotations

import numpy as np
import pytest

from meshpoint.campaigns.draw import draw, upshifts
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.controller.estimate.loaded_driveline import BehindState
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile

SHEET = load_sheet("truck12")
SHIFTS = 5
LEARNED = 2
SEEDS = range(3_900_000_000, 3_900_000_004)


def released(seed: int) -> list[tuple[BehindState, float]]:
    """What was known of a typical gearbox's driveline as its gears came out, and how fast the
    vehicle was; the first shifts learn."""
    drawn = draw(seed, SHEET, Preset.TRUCK, upshifts(), SHIFTS, {}, Profile.TYPICAL)
    bench = ClosedLoop(SHEET, ControllerSettings(), Preset.TRUCK, drawn)
    observer, found = bench.controller.observer, []
    for k in range(SHIFTS):
        bench.prepare()
        bench._run(lambda: observer.layshaft.free)
        known = observer._main._before._behind  # type: ignore[union-attr]
        if k >= LEARNED and known is not None:
            found.append((known, float(bench.rig_truth.plant.y.vehicle_rad_s)))
        bench.shift()
    return found


@pytest.mark.long
def test_how_fast_the_vehicle_is_when_a_gear_comes_out_is_known_from_the_gear() -> None:
    seen = [one for seed in SEEDS for one in released(seed)]
    assert len(seen) >= (SHIFTS - LEARNED) * (len(SEEDS) - 1)
    off = np.array([abs(known.mean[3] - vehicle) for known, vehicle in seen])
    sds = np.array([np.linalg.norm(known.root[3]) for known, _ in seen])
    assert np.median(off) < 0.08
    assert np.mean(off < 3.0 * sds) > 0.8
