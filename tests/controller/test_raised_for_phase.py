"""A downshift whose phase is known: raised for the brake, which then chooses the gap, and a clutch
that waits for the tooth to lie at its flank."""

from __future__ import annotations

import pytest
from shift_box import DOWN, PITCH, SHEET, Box, aimed

from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.messages import ClutchAction, ShiftResult
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.units import SECOND_US


def asked_and_braked(box: Box, target: int) -> tuple[float, bool]:
    """The highest speed (rad/s) that the engine is asked for as the plates part, and whether the
    gear is braked: the engine has come to its speed by then."""
    box.ask(target)
    asked, braked = 0.0, False
    while box.running():
        if box.step() is State.CLUTCH_PARTING:
            box.engine = box.sequence.engine_rad_s or box.engine
            box.layshaft = box.engine * SHEET.split_mesh(DRIVE_GEARS[target].split).ratio
        if box.state is State.CLUTCH_PARTING:
            asked = max(asked, box.sequence.engine_rad_s or 0.0)
        braked |= box.board.command(ValveName.BRAKE).on
    assert box.records[-1].result is ShiftResult.ENGAGED
    return asked, braked


def test_a_downshift_that_aims_is_raised_by_a_pitch_for_each_sleeve_delay_more_and_braked() -> None:
    """Drag alone brings a gap whenever it comes, the brake by when it is released."""
    gear = DRIVE_GEARS[DOWN[2]]
    over_engine = SHEET.main_mesh(gear.main).ratio * SHEET.split_mesh(gear.split).ratio
    (free, was_braked), (more, is_braked) = (
        asked_and_braked(box, DOWN[2]) for box in (Box(*DOWN[:2]).ready(), aimed(*DOWN[:2]))
    )
    assert (was_braked, is_braked) == (False, True)
    more_rad_s = SHEET.dog.pitch_rad / SHEET.sleeve.delay_s
    assert (more - free) * over_engine == pytest.approx(more_rad_s, abs=0.3)


def test_no_gear_is_raised_above_the_input_shafts_limit_for_the_brake() -> None:
    """At the speed that lets a shift to the crawl gear begin the brake's share would not fit: such
    shifts ended in neutral."""
    old, new = (SHEET.overall_ratio(DRIVE_GEARS[number]) for number in (2, 14))
    top = SHEET.limits.input_max_rad_s
    asked, _ = asked_and_braked(aimed(2, top / 1.115 * old / new), 14)
    assert asked <= top / 1.05 * (1.0 + 1e-9)


def test_the_plates_do_not_meet_before_the_tooth_lies_at_its_flank() -> None:
    """A tooth that hardly moves takes 0.1 s to its flank; an engine that caught it before struck
    with 20 to 70 J."""
    box = aimed(*DOWN[:2])
    box.ask(DOWN[2])
    box.until(State.CLUTCH_CLOSING)
    assert box.records[-1].measured_contact_us is not None
    contact_us, predictor = box.records[-1].measured_contact_us, box.sequence.free_predictor
    assert 0 < box.sequence.flank_us - contact_us <= 200_000
    # By then it lies at its flank for sure: by its phase's deviation alone one in six was struck.
    assert predictor is not None
    met, there = (
        float(predictor.trajectory(float(at_us), 1.0, 1).phase_rad[0])
        for at_us in (contact_us, box.sequence.flank_us)
    )
    off_rad = abs(there - PITCH * round(met / PITCH))
    sd_rad = predictor.phase_sd_rad(float(contact_us))
    assert off_rad > SHEET.dog.backlash_rad / 2.0 + 2.5 * sd_rad
    meeting_us = SHEET.clutch.surely_open_share * SHEET.clutch.close_delay_s * SECOND_US
    box.sequence.flank_us = round(box.now_us + meeting_us + 35_000)
    for waited_us in range(10_000, 70_000, 10_000):
        box.step()
        closes = box.sequence.clutch is ClutchAction.CLOSE
        assert closes is (waited_us >= 35_000)
