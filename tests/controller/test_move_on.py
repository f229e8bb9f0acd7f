"""A tooth that stands on a tooth (shift_box.py): the faces hold the gear to its sleeve until the
brake's torque breaks that."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest
from shift_box import CONTACT_M, FIRST_SECOND, LEAD_US, SHEET, UP, Box, aimed

from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.dbc.messages import ShiftResult
from meshpoint.gearbox import MainGear
from meshpoint.units import RPM

GEAR = MainGear.SECOND
HALF_GAP: float = 0.5 * SHEET.dog.backlash_rad
FACE: float = SHEET.dog.pitch_rad - SHEET.dog.backlash_rad
BRAKE = ValveName.BRAKE


@dataclass
class Pressed:
    """The shift up meets a tooth, on which it stands until the brake has so much torque."""

    holds_nm: float
    way_rad: float = 0.6 * FACE
    """From where the tooth stands to the gap."""
    box: Box = field(default_factory=lambda: aimed(*UP[:2]))
    contact_us: int = 0
    entered_us: int = 0
    slip_rad_s: float = 0.0
    """As the gap comes by."""
    pulses_us: list[tuple[int, int]] = field(default_factory=list)
    stood: list[int] = field(default_factory=list)
    """When each sleeve began to press."""

    def __post_init__(self) -> None:
        box, turned = self.box, [0.0]
        box.face = lambda _: turned[0] < self.way_rad
        box.ask(UP[2])
        pressed = False
        while box.running():
            box.step()
            self._note_pulse()
            at_face = abs(box.position_m[FIRST_SECOND] - CONTACT_M) < 1e-4
            if box.state is not State.ENGAGING or not at_face:
                if pressed and box.position_m[FIRST_SECOND] > CONTACT_M + 1e-4:
                    self.entered_us = self.entered_us or box.now_us
                pressed = pressed and at_face
                continue
            if not pressed:
                pressed, turned[0] = True, 0.0
                self.stood.append(box.now_us)
            brake_nm = SHEET.brake_nm_per_pa * box.pressure_pa
            # What is left of the braking before contact has not moved it.
            if turned[0] == 0.0 and (not self.pulses_us or brake_nm < self.holds_nm):
                box.layshaft = box.main / SHEET.main_mesh(GEAR).ratio
            else:
                self.slip_rad_s = box.slip(GEAR)
                turned[0] -= self.slip_rad_s * 0.01
        self.record = box.records[-1]

    def _note_pulse(self) -> None:
        box, command = self.box, self.box.board.command(BRAKE)
        if box.state is State.ENGAGING and self.stood and command.on:
            pulse = (command.time_us, command.until_us)
            if pulse not in self.pulses_us:
                self.pulses_us.append(pulse)


def test_a_tooth_that_stands_on_a_tooth_is_moved_on_and_the_sleeve_goes_in() -> None:
    """Not before 15 ms after contact. The air of the braking before has to be out, that of the
    pulse takes 12 ms to come. By face time alone it would have gone back after 200 ms."""
    pressed = Pressed(holds_nm=25.0)
    record = pressed.record
    assert (record.result, record.attempts, record.moves) == (ShiftResult.ENGAGED, 1, 1)
    ((on_us, _),) = pressed.pulses_us
    assert on_us - LEAD_US >= pressed.stood[0] + 15_000 - 10_000
    assert pressed.entered_us - pressed.stood[0] < 180_000
    assert not pressed.box.board.driven(BRAKE, pressed.box.now_us)


def test_a_pulse_leaves_no_more_slip_than_a_contact_is_planned_for() -> None:
    """Even where nothing holds the gear, over nearly the whole face."""
    pressed = Pressed(holds_nm=1.0, way_rad=0.9 * FACE)
    assert (pressed.record.attempts, pressed.record.moves) == (1, 1)
    assert -40.0 * RPM <= pressed.slip_rad_s < 0.0


def test_it_is_moved_on_twice_and_only_then_goes_back() -> None:
    """Held by more than the brake has at the end of its pulses. The second one waits until the air
    of the first is out."""
    pressed = Pressed(holds_nm=95.0)
    assert pressed.record.result is ShiftResult.ENDED_IN_NEUTRAL
    attempts = pressed.box.settings.limits.attempts
    assert (pressed.record.attempts, pressed.record.moves) == (attempts, 2 * attempts)
    assert len(pressed.pulses_us) == 2 * attempts
    for (_, off_us), (on_us, _) in zip(
        pressed.pulses_us[::2], pressed.pulses_us[1::2], strict=True
    ):
        assert on_us - off_us > 60_000
    assert all(5_000 <= off_us - on_us <= 22_000 for on_us, off_us in pressed.pulses_us)


def test_no_pulse_where_the_brake_might_stall_the_layshaft() -> None:
    """Its full torque takes 25 rad/s off in two time constants, down to the guard's 100 rpm."""
    box = aimed(7, 60.0)
    pressed = Pressed(holds_nm=25.0, box=box)
    assert pressed.pulses_us == []


def pulsed() -> Box:
    """A shift up whose gear stands with its sleeve on a tooth, as the pulse is commanded."""
    box = aimed(*UP[:2])
    box.face = lambda _: True
    box.ask(UP[2])
    while not (box.state is State.ENGAGING and box.board.command(BRAKE).on):
        box.step()
        if box.state is State.ENGAGING:
            box.layshaft = box.main / SHEET.main_mesh(GEAR).ratio
    return box


@pytest.mark.parametrize("entered_mm", [0.2, 0.4])
def test_a_pulse_ends_as_soon_as_the_sleeve_has_entered(entered_mm: float) -> None:
    box = pulsed()
    box.stuck = {FIRST_SECOND}
    box.position_m[FIRST_SECOND] = CONTACT_M + 1e-3 * entered_mm
    box.step()
    is_on = box.board.command(BRAKE).on
    assert is_on is (entered_mm < 0.3)


def test_a_pulse_is_withdrawn_where_the_gear_turns_before_its_air_comes() -> None:
    """The guard would take everything off: what stands no more needs no brake."""
    for slip_rpm in (3.0, -8.0):
        box = pulsed()
        box.propeller -= slip_rpm * RPM * SHEET.range_mesh(box.range).ratio
        box.step()
        assert box.board.command(BRAKE).on is (abs(slip_rpm) < 5.0)
