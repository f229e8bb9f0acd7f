"""A gearbox that stands with a gear in mesh, and whose brake comes on."""

from __future__ import annotations

import pytest

from meshpoint.bench.virtual_time import VirtualTime
from meshpoint.commission.core import CommissionCore
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import Profile, RigSettings
from meshpoint.rig_sim.truck import layout as at

SHEET = load_sheet("truck12")
BRAKED_US = 600_000
"""By then commissioning has driven the brake, as the first of all outputs."""


@pytest.mark.parametrize("seed", [2, 4, 5])
def test_the_brake_holds_a_box_that_stands_in_gear_on_a_driveline_that_swings(seed: int) -> None:
    """What pulls at the layshaft counts at the layshaft, whichever shaft leads those in mesh:
    else the brake seemed to turn it back, and to catch it, without end."""
    settings = RigSettings(
        seed=seed, main_speed_rpm=0.0, profile=Profile.TYPICAL,
        as_built={"vehicle.slope_percent": 0.0},
    )  # fmt: skip
    rig = RigCore(SHEET, settings)
    VirtualTime([CommissionCore(SHEET, consents=True), rig], [3_000, 1_000]).run(
        lambda: False, BRAKED_US
    )
    assert abs(rig.truth.speeds_rad_s[1]) < 1.0


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_what_pulls_does_not_depend_on_which_way_the_brake_pushes(sign: float) -> None:
    """The brake's torque is left out of it."""
    pulls = []
    for brake_bar in (0.0, 5.0):
        settings = RigSettings(seed=2, main_speed_rpm=0.0, profile=Profile.CLEAN)
        plant = RigCore(SHEET, settings).truth.plant
        plant.g.brake_sign = sign
        plant.y.brake_pa = plant.rig.p.air.atmosphere_pa + brake_bar * 1e5
        plant.find_torques()
        assert plant.rig.g.bodies[at.LAYSHAFT].rate != 1.0, "another shaft leads"
        pulls.append(plant.rig.torques.pull_nm)
    assert plant.rig.torques.hold_nm > 10.0
    assert pulls[1] == pytest.approx(pulls[0], abs=1e-9)
