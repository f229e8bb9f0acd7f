"""The figures of the estimators, side by side on the same edges."""

from __future__ import annotations

from meshpoint.bench.simulate import Setup, simulate
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim import Preset, RigCore, RigSettings

SHEET = load_sheet("thesis")
WRAPS_EARLY = 3
"""A seed whose sensor clock wraps before the first shift."""


def test_every_estimator_is_scored_though_the_clock_wraps_before_the_first_shift() -> None:
    rig = RigCore(SHEET, RigSettings(seed=WRAPS_EARLY, preset=Preset.THESIS))
    wraps_us = (1 << 32) - rig.truth.clock_start_us
    result = simulate(Setup(SHEET, ControllerSettings(), Preset.THESIS, WRAPS_EARLY, shifts=3))
    assert (result.rows[0].request_us - rig.truth.clock_start_us) % (1 << 32) > wraps_us
    window, thesis, crossing = (result.estimation[n] for n in ("window", "thesis", "crossing"))
    assert thesis["speed_rms_rpm"] < window["speed_rms_rpm"]
    assert thesis["angle_rms_deg"] < window["angle_rms_deg"]
    assert crossing["speed_rms_rpm"] < 1.0
