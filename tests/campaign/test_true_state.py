"""`true_state` knows all but chance: what is left of its error is the scatter of the delay."""

from __future__ import annotations

import pytest
from campaigns import small_spec

from meshpoint.campaigns.run import run_one
from meshpoint.campaigns.spec import TRUE_STATE, Job
from meshpoint.controller.settings.settings import ControllerSettings, Prices, Window
from meshpoint.rig_sim.settings import Preset

RPM_TO_DEG_PER_MS = 6e-3


@pytest.mark.parametrize(
    ("preset", "seeds"),
    [
        (Preset.THESIS, (1,)),
        (Preset.TRUCK, (3,)),
        pytest.param(Preset.THESIS, (3,), marks=pytest.mark.long),
        pytest.param(Preset.TRUCK, (4, 5), marks=pytest.mark.long),
    ],
)
def test_true_state_misses_by_the_scatter_of_the_delay_alone(
    preset: Preset, seeds: tuple[int, ...]
) -> None:
    # Energy at 5 ms/J: the slip at contact is then large against what the brake's rest takes of it
    # within the scatter.
    settings = ControllerSettings(prices=Prices(energy_s_per_j=0.005))
    spec = small_spec(preset, strategies=(), learn=1, judged=2, settings=settings)
    noise_limit_ms = 5.0 if preset is Preset.THESIS else 3.0
    for seed in seeds:
        result = run_one(spec, Job(seed))
        assert result.error is None
        for record in result.records:
            assert record.strategy == TRUE_STATE
            assert record.contact == "gap"
            assert record.pitch_deg == pytest.approx(360.0 / spec.sheet.dog.teeth)
            assert record.phase_error_deg is not None
            assert record.slip_rpm is not None
            assert record.predicted_phase_deg is not None
            # A sleeve that was stopped and fired again has the chance of those valves, too.
            switches = 1 + record.aborts
            most_deg = abs(record.slip_rpm) * RPM_TO_DEG_PER_MS * noise_limit_ms * switches
            off_deg = record.phase_error_deg - record.predicted_phase_deg
            assert abs(off_deg) < 1.2 * most_deg + 0.03


@pytest.mark.long
def test_in_the_thesis_its_error_is_slip_times_what_the_delay_was_off() -> None:
    """With the brake released early, so that the slip at contact is that of the way there."""
    window = Window(aim_slip_rad_s=1.5, aim_time_constants=3.0)
    spec = small_spec(strategies=(), learn=0, judged=4, settings=ControllerSettings(window=window))
    mean_ms = spec.sheet.sleeve.delay_s * 1e3
    for record in run_one(spec, Job(11)).records:
        assert record.phase_error_deg is not None
        assert record.slip_rpm is not None
        assert record.delay_ms is not None
        assert record.predicted_phase_deg is not None
        late_deg = record.slip_rpm * RPM_TO_DEG_PER_MS * (record.delay_ms - mean_ms)
        expected = record.predicted_phase_deg + late_deg
        assert record.phase_error_deg == pytest.approx(expected, abs=0.06)
