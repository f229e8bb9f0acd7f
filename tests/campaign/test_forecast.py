"""The plant run ahead for `true_state`: one time or many, it is the same forecast."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from meshpoint.campaigns.forecast import BRANCH_SAMPLES, SOON_SAMPLES, Forecast, Path
from meshpoint.gearbox import MainGear, load_sheet
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import Preset, Profile, RigSettings
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.plant import TruckPlant

CLOCK_START_US = 1_234


@pytest.fixture(scope="module")
def forecast() -> tuple[Forecast, float]:
    """Of a truck in its old gear, and the instant it begins at."""
    sheet = load_sheet("truck12")
    rig = RigCore(sheet, RigSettings(preset=Preset.TRUCK, profile=Profile.CLEAN, seed=5))
    plant = rig.truth.plant
    assert plant is not None
    plant.coast()
    start = plant.snapshot()
    ahead = Forecast(plant, start, MainGear.THIRD, sheet.dog.pitch_rad, CLOCK_START_US)
    return ahead, start.time_us + CLOCK_START_US


@given(
    on_ms=st.floats(0.0, 40.0),
    braked_ms=st.floats(1.0, 380.0),
    after_ms=st.floats(-30.0, 300.0),
    is_released=st.booleans(),
)
def test_one_time_alone_is_forecast_as_among_many(
    forecast: tuple[Forecast, float],
    on_ms: float,
    braked_ms: float,
    after_ms: float,
    is_released: bool,
) -> None:
    ahead, start_us = forecast
    # whole steps of 20 ms: each brake command of its own is a plant run of its own
    on_us = start_us + 1_000.0 * round(on_ms / 20.0) * 20
    release_us = on_us + 1_000.0 * braked_ms
    brake = np.array([[on_us, release_us], [1.0, 0.0]] if is_released else [[release_us], [0.0]])
    at_us = max(start_us, release_us + 1_000.0 * after_ms)
    many = ahead.trajectory(brake, np.array([at_us, at_us + 5_000.0]), True)
    assert ahead.after_release(brake, at_us) == (many[0][0], many[1][0])


def coasting() -> tuple[TruckPlant, float]:
    """A truck in no gear, and its pitch."""
    sheet = load_sheet("truck12")
    settings = RigSettings(preset=Preset.TRUCK, profile=Profile.CLEAN, seed=6)
    plant = RigCore(sheet, settings).truth.plant
    assert plant is not None
    plant.coast()
    return plant, sheet.dog.pitch_rad


@pytest.mark.parametrize("on_ms", [0.0, 120.0, 600.0])
def test_a_branch_in_one_go_is_the_plant_stepped_from_sample_to_sample(on_ms: float) -> None:
    plant, pitch = coasting()
    trunk = Path(plant, plant.snapshot(), MainGear.SECOND, ((0.0, 1.0),), pitch)
    start = trunk.snapshot(round(on_ms / 4.0))
    let_go = ((start.time_us, 0.0),)
    stepped = Path(plant, start, MainGear.SECOND, let_go, pitch)
    at_once = Path(plant, start, MainGear.SECOND, let_go, pitch, keeps=False)
    stepped.extend(BRANCH_SAMPLES)
    at_once.extend(SOON_SAMPLES)
    at_once.extend(BRANCH_SAMPLES)
    assert at_once.phase == stepped.phase
    assert at_once.slip == stepped.slip


@pytest.mark.parametrize("keeps", [True, False])
def test_a_forecast_goes_on_past_teeth_that_rub_or_leave_their_span(keeps: bool) -> None:
    """A sleeve stood tooth on tooth as the forecast began: nobody acts on what happens in it, so
    the teeth had the same speed for ever, and it never ended."""
    plant, pitch = coasting()
    gear = MainGear.SECOND
    plant.y.speed_rad_s[at.LAYSHAFT] = plant.main_rad_s / plant.ratio(gear) + 0.5
    plant.rub(at.FACE_FIRST_SECOND, at.MAIN_BOX, plant.ratio(gear), 500.0)
    span = (plant.y.phase_rad[1] - 1e-3, plant.y.phase_rad[1] + 1e-3)
    plant.watch(0, gear, span, with_lash=False)
    path = Path(plant, plant.snapshot(), gear, (), pitch, keeps=keeps)
    path.extend(25)
    assert path.slip[0] > 0.3 > 0.01 > min(path.slip)
