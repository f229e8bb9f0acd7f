"""The guard goes on judging where the rest of the controller is wrong about time, speed or frames.

Each case breaks one thing that guard and sequence once shared; the guard has its own and blocks.
"""

from __future__ import annotations

from typing import Any

import pytest
from loop_bench import Loop

from meshpoint.controller.measure.clock import SensorClockEstimate
from meshpoint.controller.measure.inputs import EdgeSpeed
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import ControllerState, ValveAction, ValveCommand
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset

TRUCK12 = load_sheet("truck12")
State = ControllerState
FOUND_US = 50_000
STATUS_ID = CODECS["ValveStatus"].spec.can_id
DRIVING = (ValveAction.ON_NOW, ValveAction.ON_AT)


def shift(**more: Any) -> Loop:
    return Loop([(300_000, 10)], sheet=TRUCK12, preset=Preset.TRUCK, toward=10, seed=3, **more)


def rows(loop: Loop) -> set[int]:
    lines = [line for line in loop.events if "guard blocked a valve command" in line]
    return {int(line.rpartition(" ")[2]) for line in lines}


def is_driving(command: Any) -> bool:
    return type(command) is ValveCommand and any(field in DRIVING for field in command)


@pytest.mark.parametrize(
    "phase_us",
    [
        200,
        *(pytest.param(each, marks=pytest.mark.check) for each in range(1_600, 8_600, 1_400)),
        8_600,
    ],
)
def test_a_lost_valve_status_is_found_by_the_guard_within_50_ms(phase_us: int) -> None:
    """At each phase between the controller's ticks and the gearbox's reads."""
    silent = [False]
    loop = shift(
        receiving=lambda frame: [] if silent[0] and frame.can_id == STATUS_ID else [frame],
        phases_us=(phase_us, 189, 5_513),
    )
    seen = loop.watch_guard()
    heard: list[int] = []
    receive = loop.controller.receive

    def note(frame: Frame) -> None:
        if frame.can_id == STATUS_ID and not silent[0]:
            heard.append(loop.time.now_us)
        receive(frame)

    loop.controller.receive = note  # type: ignore[method-assign]
    loop.run_to_state(State.SYNCHRONISING, 2_000_000)
    assert seen[-1][1].valid
    silent[0] = True
    loop.run(loop.time.now_us + 200_000)
    lost_us = next(time_us for time_us, inputs in seen if time_us > heard[-1] and not inputs.valid)
    assert 30_000 <= lost_us - heard[-1] <= FOUND_US
    driven = [time_us for time_us, command in loop.messages if is_driving(command)]
    assert max(driven) - heard[-1] <= FOUND_US


def test_the_guard_measures_speeds_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """The speeds of the sequence are frozen in mid-shift; those the guard judges by are not."""
    loop = shift()
    seen = loop.watch_guard()
    loop.run_to_state(State.SYNCHRONISING, 2_000_000)
    before = seen[-1][1].speeds[1].omega_rad_s
    monkeypatch.setattr(EdgeSpeed, "at", lambda self, now_us: before)
    loop.run(loop.time.now_us + 60_000)
    assert seen[-1][1].speeds[1].omega_rad_s < before - 1.0


def test_the_guard_judges_channels_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """A receiver that calls every channel valid; every second frame of the positions is damaged, so
    that no sample ever gets old."""
    damaged = {CODECS[name].spec.can_id for name in ("SleevesMain", "SleevesAux")}
    bad, count = [False], [0]

    def receiving(frame: Frame) -> list[Frame]:
        count[0] += frame.can_id == STATUS_ID
        if bad[0] and frame.can_id in damaged and count[0] % 2:
            return [frame._replace(data=frame.data[:-1] + bytes([frame.data[-1] ^ 1]))]
        return [frame]

    loop = shift(receiving=receiving)
    seen = loop.watch_guard()
    loop.run_to_state(State.SYNCHRONISING, 2_000_000)
    monkeypatch.setattr(Receiver, "all_valid", lambda self, kinds: True)
    bad[0] = True
    loop.run(loop.time.now_us + 70_000)
    assert not seen[-1][1].valid


@pytest.mark.parametrize("wrong_us", [-25_000, -13_000])
def test_a_clock_that_is_not_the_sensors_drives_no_valve(
    wrong_us: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock that commands are timed by falls behind before the shift: row 19. (One that runs
    ahead makes the sequence's own inputs old.)"""
    loop = shift()
    loop.run(250_000)
    right = SensorClockEstimate.now_us
    monkeypatch.setattr(
        SensorClockEstimate, "now_us", lambda self, now_us: right(self, now_us) + wrong_us
    )
    loop.run(2_500_000)
    assert 19 in rows(loop)
    assert not any(is_driving(command) for _, command in loop.messages)
    assert loop.violations == 0


def test_clocks_agree_through_shifts_and_drift() -> None:
    loop = shift(as_built={})
    seen = loop.watch_guard()
    loop.run(3_000_000)
    errors = [abs(inputs.clock_error_us) for _, inputs in seen if inputs.valid]
    assert len(errors) > 250
    assert max(errors) <= 100
