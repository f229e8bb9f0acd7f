"""What a controller learns of a gearbox is what the gearbox has, to within what it says of it; it
is the same after a restart, and a shift that failed teaches nothing of sleeves and phases."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from typing import Any

import pytest
from loop_bench import Loop
from recorded_runs import RUNS, AnyVersion, Transcript, frame_of, transcript_of

from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.learned import Calibration, read_calibration
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ControllerState, RigFault, ShiftResult
from meshpoint.gearbox import load_sheet
from meshpoint.results.rows import RowCollector
from meshpoint.rig_sim.settings import Preset, Profile

SHEET = load_sheet("truck12")
SHIFTS, LIMIT_US = 8, 60_000_000
COMES_TO_REST_US = 60_000
"""A sleeve that has been pulled into neutral stands there by then."""
SURE = 3.5
"""Nothing is further off than this many of the deviations that are stated with it."""


def a_loop(**other: Any) -> Loop:
    """Shifts 8 to 10 of one gearbox."""
    usual = {"sheet": SHEET, "preset": Preset.TRUCK, "profile": Profile.CLEAN, "seed": 3,
             "shifts": SHIFTS, "pairs": ((8, 10),), "toward": 10}  # fmt: skip
    return Loop(**(usual | other))  # type: ignore[arg-type]


def calibration(loop: Loop) -> Calibration:
    core = loop.controller.core
    assert isinstance(core, ControllerCore)
    return core.calibration("a test")


STEADY = {
    "sheet.layshaft_inertia_factor": 1.0,
    "sheet.input_inertia_factor": 1.0,
    "disc.fade_per_k": 0.0,
    "disc.fade_per_1000_rpm": 0.0,
}
"""A brake whose torque over the inertia is the sheet's times one factor, hot or cold."""


@pytest.mark.parametrize("gain", [0.85, pytest.param(1.15, marks=pytest.mark.long)])
def test_the_brake_and_the_sleeve_are_learned_to_within_what_is_said_of_them(gain: float) -> None:
    loop = a_loop(as_built=STEADY | {"sheet.brake_torque_factor": gain})
    loop.run(LIMIT_US)
    learned, shifts = calibration(loop), RowCollector(SHEET)
    assert learned.brake is not None
    assert abs(learned.brake.gain - gain) < SURE * learned.brake.gain_sd
    assert learned.brake.gain_sd < 0.06
    for _, message in loop.messages:
        shifts.take(message)
    delays_ms = [row.delay_ms for row in shifts.rows if row.delay_ms is not None]
    true_s, sleeve = 1e-3 * sum(delays_ms) / len(delays_ms), learned.sleeves.second
    assert sleeve is not None
    assert len(delays_ms) >= SHIFTS - 2
    assert abs(sleeve.delay_s - true_s) < SURE * sleeve.scatter_s / math.sqrt(sleeve.samples)
    assert abs(sleeve.delay_s - true_s) < abs(SHEET.sleeve.delay_s - true_s) + 1e-3


@pytest.fixture(scope="module")
def of_two_shifts() -> Loop:
    """Two of three shifts are over; who goes on from there takes a copy."""
    loop = a_loop(shifts=3)
    loop.until(lambda: len(loop.outcomes) == 2, LIMIT_US)
    return loop


@pytest.mark.parametrize(
    ("state", "fault"),
    [
        (ControllerState.SYNCHRONISING, RigFault.SLEEVE_JAMMED),
        (ControllerState.SYNCHRONISING, RigFault.HALL_DROPOUT),
        (ControllerState.CLUTCH_OPENING, RigFault.CLUTCH_STUCK),
    ],
)
def test_a_shift_that_failed_teaches_nothing_of_sleeves_and_phases(
    of_two_shifts: Loop, state: ControllerState, fault: RigFault
) -> None:
    """What was known as it failed is left as it was: by two shifts before, and by the sleeve's way
    out of the old gear."""
    loop = copy.deepcopy(of_two_shifts)
    loop.run_to_state(ControllerState.NEUTRAL, LIMIT_US)
    loop.run_to_state(state, LIMIT_US)
    if state is ControllerState.SYNCHRONISING:
        loop.run(loop.time.now_us + COMES_TO_REST_US)
    before = calibration(loop)
    loop.fault(fault, 2 if fault is RigFault.HALL_DROPOUT else 0)
    loop.until(lambda: len(loop.outcomes) == 3, LIMIT_US)
    assert loop.outcomes[-1].result is not ShiftResult.ENGAGED
    after = calibration(loop)
    assert after.sleeves == before.sleeves
    assert before.sleeves.second is not None
    if fault is not RigFault.HALL_DROPOUT:  # without a sensor its count is lost, and phases with it
        assert after.references == before.references


COMMANDS = tuple(f"> {CODECS[name].spec.can_id:08X}" for name in
                 ("ValveCommand", "ClutchCommand", "TSC1"))  # fmt: skip


def commands(core: ControllerCore, heard: list[str]) -> list[str]:
    """What a controller commands that hears this. It reports more, some of it to the last digit."""
    reported = Transcript(core)
    for line in heard:
        sign, text = line.split(" ")
        reported.receive(frame_of(text)) if sign == "<" else reported.step(int(text))
    return [line for line in reported.lines if line.startswith(COMMANDS)]


def test_restored_from_its_file_a_controller_commands_what_it_does_with_what_was_learned(
    of_two_shifts: Loop,
) -> None:
    """The bus of a recorded run, heard by one that was given the figures and by one that has read
    their nine digits."""
    loop = copy.deepcopy(of_two_shifts)
    loop.run(LIMIT_US)
    learned = calibration(loop)
    read = read_calibration(learned.to_text(), "box.toml", SHEET)
    cold = RUNS["typical_1"].header
    heard = [line for line in transcript_of("typical_1") if line[0] in "<@"]
    given, again, without = (
        commands(ControllerCore(AnyVersion(**vars(replace(cold, calibration=each)))), heard)
        for each in (learned, read, None)
    )
    assert len(given) > 100
    assert again == given
    assert without != given
