"""The frames by which a step is visible: what they say of gears, slip and phase while a shift is
under way and between shifts, and of this step and the one before."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from test_shift_states import PITCH, SHEET, UP, Box, aimed

from meshpoint.controller.header import new_header
from meshpoint.controller.report.reporter import ETC2_EVERY, Reporter
from meshpoint.controller.settings import ControllerSettings
from meshpoint.dbc.messages import (
    ETC1,
    ETC2,
    ControllerEstimates,
    ControllerStatus,
    FaultCode,
    J1939Measured,
    ShiftOutcome,
    ShiftPrediction,
)
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox import MainGear
from meshpoint.gearbox.gears import DRIVE_GEARS


class Reported:
    """A reporter beside a box; its frames are left as messages."""

    def __init__(self, box: Box) -> None:
        self.box, self.header = box, new_header("1.2.3", SHEET, ControllerSettings())
        self.has_main = self.has_layshaft = True
        observer: Any = SimpleNamespace(
            clock=SimpleNamespace(latest_us=0),
            view=box.view,
            layshaft=SimpleNamespace(free=True),
            references=box.references,
            layshaft_at=lambda _: box.snapshot().layshaft.latest() if self.has_layshaft else None,
            main_at=lambda _: box.snapshot().main if self.has_main else None,
        )
        self.reporter = Reporter(self.header, observer, box.sequence)

    def step(self) -> dict[type, Any]:
        """One step of both; the messages by kind."""
        self.box.step()
        return self.frames()

    def frames(self) -> dict[type, Any]:
        sender: Any = SimpleNamespace(encode=lambda message: message, unread=lambda *_: None)
        found = self.reporter.frames(sender, self.box.snapshot())
        kinds = {type(message): message for message in found}
        assert len(kinds) == len(found)
        return kinds

    def status(self, now_us: int = 0, lateness_us: int = 0, blocks: int = 0) -> ControllerStatus:
        receiver: Any = SimpleNamespace(
            e2e_errors=3, format_errors=5, foreign_frames=70_000, invalid_channels=9
        )
        return self.reporter.status(now_us, lateness_us, 11, 0xABCD, receiver, blocks)


def test_in_gear_the_truck_reads_its_gear_and_both_speeds() -> None:
    box = aimed(*UP[:2])
    reported = Reported(box).step()
    etc1 = reported[ETC1]
    assert (etc1.driveline_engaged, etc1.shift_in_process) == (J1939Measured.YES, J1939Measured.NO)
    assert etc1.output_shaft_speed_rad_s == pytest.approx(box.propeller)
    assert etc1.input_shaft_speed_rad_s == pytest.approx(UP[1])
    assert (reported[ETC2].selected_gear, reported[ETC2].current_gear) == (UP[0], UP[0])
    assert reported[ETC2].actual_ratio == SHEET.overall_ratio(DRIVE_GEARS[UP[0]])
    assert ShiftPrediction not in reported
    assert ShiftOutcome not in reported


def test_during_a_shift_the_gear_asked_for_is_selected_and_none_is_in_between() -> None:
    box = aimed(*UP[:2])
    reported = Reported(box)
    reported.frames()
    box.ask(UP[2])
    predictions = outcomes = 0
    while box.running():
        found = reported.step()
        shifting = box.state is not State.IN_GEAR
        assert (found[ETC1].shift_in_process is J1939Measured.YES) is shifting
        assert found[ETC1].driveline_engaged is J1939Measured.NO
        predictions += ShiftPrediction in found
        outcomes += ShiftOutcome in found
        gear = box.view.gear_number
        known = found[ETC1].output_shaft_speed_rad_s is not None
        assert known is (gear > 0)
        if box.sequence.shift is not None:
            status = reported.status()
            assert (status.target_gear, status.current_gear) == (UP[2], gear)
            assert status.state is box.state
            slip = found[ControllerEstimates].slip_rad_s
            assert slip == pytest.approx(box.slip(MainGear.SECOND))
            phase = found[ControllerEstimates].phase_rad
            off = math.remainder(phase - box.phase(MainGear.SECOND), PITCH)
            assert off == pytest.approx(0.0, abs=1e-9)
            assert found[ControllerEstimates].phase_known
        if ETC2 in found:
            assert found[ETC2].selected_gear == UP[2] or not box.running()
            assert found[ETC2].current_gear == (gear if gear >= 0 else None)
    assert outcomes == 1
    assert predictions > 10


def test_neutral_is_gear_0_selected_and_in() -> None:
    box = aimed(*UP[:2])
    reported = Reported(box)
    box.lost = FaultCode.POSITION_STALE
    box.position_m = dict.fromkeys(box.position_m, 0.0)
    found = reported.step()
    assert (found[ETC2].selected_gear, found[ETC2].current_gear) == (0, 0)
    assert found[ETC2].actual_ratio is None
    status = reported.status()
    assert (status.target_gear, status.current_gear) == (0, 0)
    assert found[ControllerEstimates].slip_rad_s == 0.0
    assert not found[ControllerEstimates].phase_known


def test_the_gear_is_reported_every_tenth_step() -> None:
    reported = Reported(aimed(*UP[:2]))
    for step in range(25):
        assert (ETC2 in reported.step()) is (step % ETC2_EVERY == 0)
        reported.status()


@pytest.mark.parametrize("missing", ["has_main", "has_layshaft"])
def test_without_a_shaft_neither_slip_nor_phase_is_reported(missing: str) -> None:
    reported = Reported(aimed(*UP[:2]))
    setattr(reported, missing, False)
    found = reported.step()
    estimates = found[ControllerEstimates]
    assert (estimates.slip_rad_s, estimates.phase_known) == (0.0, False)
    assert (found[ETC1].output_shaft_speed_rad_s is None) is (missing == "has_main")
    assert (found[ETC1].input_shaft_speed_rad_s is None) is (missing == "has_layshaft")


def test_the_phase_is_as_sure_as_both_shafts_and_the_reference() -> None:
    box = aimed(*UP[:2])
    reported = Reported(box).step()[ControllerEstimates]
    main, layshaft = box.snapshot().main, box.snapshot().layshaft.latest()
    assert main is not None
    ratio = SHEET.main_mesh(MainGear.FIRST).ratio
    expected = math.hypot(ratio * layshaft.theta_sd_rad, main.theta_sd_rad)
    assert reported.phase_sd_rad == pytest.approx(expected)


def test_a_status_tells_of_its_step_and_of_the_one_before() -> None:
    box = aimed(*UP[:2])
    reported = Reported(box)
    reported.step()
    first = reported.status(1_000, 7)
    assert (first.step_number, first.step_time_us, first.previous_step_time_us) == (0, 1_000, 0)
    assert (first.consumed_count, first.consumed_crc) == (11, 0xABCD)
    assert (first.previous_consumed_count, first.previous_consumed_crc) == (0, 0)
    assert (first.step_lateness_us, first.cold_start) == (7, True)
    assert (first.e2e_errors, first.format_errors) == (3, 5)
    assert first.foreign_frames == 70_000 & 0xFFFF
    assert first.invalid_channels == 9
    assert first.reference_known == 15
    assert first.run_hash_low + (first.run_hash_high << 32) == reported.header.run_hash
    second = reported.status(11_000, 90_000, 65_540)
    assert (second.step_number, second.step_time_us) == (1, 11_000)
    assert second.previous_step_time_us == 1_000
    assert (second.previous_consumed_count, second.previous_consumed_crc) == (11, 0xABCD)
    assert second.step_lateness_us == 65_535, "as late as can be said"
    assert second.guard_blocks == 4
    assert (second.active_fault, second.strategy) == (
        FaultCode.NONE,
        reported.header.settings.strategy,
    )
    other = new_header("9.9.9", SHEET, ControllerSettings())
    reported.reporter.change_header(other)
    third = reported.status()
    assert third.run_hash_low + (third.run_hash_high << 32) == other.run_hash
