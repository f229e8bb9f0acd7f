"""One statement for each bug that was planted from outside and that the suite once let live.

`tests/planted/` has the bugs themselves.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from test_strategy import DELAY_US, GEAR, MAIN, MOTION, RATIO, VALVE_US, learned, predictor_at

from meshpoint.controller.measure.wheel_edges import WheelEdges
from meshpoint.controller.models.layshaft import BrakeInput, LayshaftState
from meshpoint.controller.plan.gear_predictor import GearPredictor
from meshpoint.controller.plan.strategist import make_strategy
from meshpoint.controller.plan.target_phase import TERMS
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import ClutchAction, ClutchCommand, EdgesMainRise, GearboxSensors
from meshpoint.dbc.node import Node
from meshpoint.gearbox import Sleeve, Split, load_sheet
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import RigSettings
from meshpoint.rig_sim.truck.as_built import draw_as_built
from meshpoint.rig_sim.truck.position_sensors import PositionSensors

SHEET, TRUCK12 = load_sheet("thesis"), load_sheet("truck12")


def test_a_trajectory_goes_through_each_single_prediction() -> None:
    layshaft = LayshaftState(0.0, 1.0, (MAIN.omega_rad_s + 3.0) / RATIO, 0.0, 1e-3, 0.05, 1e3)
    predictor = GearPredictor(
        GEAR, RATIO, layshaft, MAIN, BrakeInput(VALVE_US), MOTION, learned(0.2), DELAY_US, 1e-3,
        DELAY_US - 12_000, 0.3,
    )  # fmt: skip
    trajectory = predictor.trajectory(60_000.0, 5_000.0, 20)
    alone = [predictor.phase_and_slip(60_000.0 + 5_000.0 * k) for k in range(20)]
    assert trajectory.phase_rad == pytest.approx([phase for phase, _ in alone], abs=1e-6)
    assert trajectory.slip_rad_s == pytest.approx([slip for _, slip in alone], abs=1e-6)


def test_the_price_of_energy_is_that_of_the_layshafts_energy() -> None:
    """A slip at the gear is slip / i at the layshaft, whose inertia takes the impact."""
    settings = ControllerSettings()
    strategy: Any = make_strategy(SHEET, settings.with_strategy("target_phase"))
    terms = strategy._terms(predictor_at(20.0)).view(TERMS)[0]
    slip_rad_s = 2.5
    energy_j = 0.5 * SHEET.inertia_kgm2(Split.HIGH) * (slip_rad_s / RATIO) ** 2
    expected_s = settings.prices.energy_s_per_j * energy_j
    assert terms.energy_s3_rad2 * slip_rad_s**2 == pytest.approx(expected_s, rel=1e-6)


@pytest.mark.parametrize("slip_rpm", [0.0, 25.0, 60.0])
def test_the_sleeves_scatter_spreads_the_phase_by_the_slip(slip_rpm: float) -> None:
    predictor, at_us = predictor_at(slip_rpm), 1_000.0
    known = predictor.estimate_variance(at_us) + predictor.reference_variance
    added = predictor.phase_sd_rad(at_us) ** 2 - known
    expected = (predictor.slip_rad_s(at_us) * SHEET.sleeve.delay_sd_s) ** 2
    assert added == pytest.approx(expected, rel=1e-3, abs=1e-12)


class _Clock:
    jumps = 0

    def stamp(self, stamp: int, now_us: int) -> int:
        return stamp


def test_a_wheel_without_an_edge_for_66_ms_has_stood() -> None:
    """Its newest 16 bits cannot be placed any more: the tooth numbers are lost."""
    wheel, interval_us = TRUCK12.wheels.main, 2_000
    for pause_us, lost in ((60_000, 0), (80_000, 1)):
        reader, clock = WheelEdges.of(wheel), _Clock()
        newest_us, index = 1_000_000, 500
        for _ in range(200):
            newest_us += 5 * interval_us
            index += 5
            stamps = tuple((newest_us - interval_us * back) & 0xFFFF for back in range(27))
            frame = EdgesMainRise(newest_us, index & 0xFFFF, 27, False, False, False, stamps)
            reader.read([frame], [], clock, newest_us)  # type: ignore[arg-type]
        assert reader.newest is not None
        read_us = newest_us + pause_us
        frame = frame._replace(read_time_us=read_us, stopped=pause_us > 65_535)
        reader.read([frame], [], clock, read_us)  # type: ignore[arg-type]
        assert (reader.broken, reader.newest is None) == (lost, bool(lost))


@pytest.mark.parametrize("name", list(Sleeve))
def test_a_position_sensor_is_off_by_the_same_moving_and_standing(name: Sleeve) -> None:
    sensors = PositionSensors(draw_as_built(5, {"position.offset_mm": 0.5}))
    sensors.lie(name, 2e-3)
    still = np.mean([sensors.read(name, (3e-3,) * 10, 1_000 * k) for k in range(50)])
    moving = np.mean(
        [sensors.read(name, (3e-3 + 1e-9, *(3e-3,) * 9), 1_000 * k) for k in range(50)]
    )
    assert moving == pytest.approx(still, abs=1e-6)
    assert still - 3e-3 > 1e-3


def test_a_clutch_without_commands_opens_by_itself() -> None:
    """100 ms after the last command, and then the way it takes."""
    rig = RigCore(TRUCK12, RigSettings(seed=2, main_speed_rpm=600.0))
    sender, positions = Transmitter(Node.TRANSMISSION_CONTROL), []
    for step in range(70):
        if step < 20:
            rig.receive(sender.encode(ClutchCommand(action=ClutchAction.CLOSE)))
        frames = rig.step(10_000 * step).frames
        positions += [
            message.clutch_position_fraction
            for frame in frames
            if isinstance(message := _decoded(frame), GearboxSensors)
        ]
    assert positions[25] == 1.0
    assert positions[-1] == 0.0


def _decoded(frame: Any) -> Any:
    from meshpoint.dbc.layout import CODECS

    codec = next(c for c in CODECS.values() if c.spec.can_id == frame.can_id)
    return codec.decode(frame.data)
