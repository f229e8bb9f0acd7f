"""The firmware between rig and bus: the bus is the same, and so are the shifts."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest
from firmware_bench import CommandBench

from meshpoint.bench.firmware_rig import FirmwareRig
from meshpoint.bench.setup import Setup
from meshpoint.bench.simulate import simulate
from meshpoint.bus.core import Core
from meshpoint.cli.main import main
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Transmitter, read_alone
from meshpoint.dbc.messages import (
    BenchAction,
    BenchCommand,
    ClutchAction,
    ClutchCommand,
    EdgesMainRise,
    ValveAction,
    ValveCommand,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.firmware import build
from meshpoint.firmware.board import Firmware
from meshpoint.firmware.native_board import NativeBoard
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import Profile, RigSettings

SHEET = load_sheet("truck12")
CYCLE_US = 10_000
MAIN_RISE, STATUS = (CODECS[each.__name__] for each in (EdgesMainRise, ValveStatus))


def bus(setup: Setup) -> list[tuple[int, Frame]]:
    """Every frame of a run, and when it was through."""
    seen: list[tuple[int, Frame]] = []
    simulate(setup, lambda time_us, frame: seen.append((time_us, frame)))
    return seen


@pytest.mark.parametrize(("profile", "seed"), [(Profile.TYPICAL, 2), (Profile.HARSH, 3)])
def test_every_frame_on_the_bus_is_the_same_with_the_firmware_and_without(
    built: bytes, profile: Profile, seed: int
) -> None:
    """The sensor clock wraps in each run, and the valves are switched to the microsecond."""
    alone = Setup(SHEET, ControllerSettings(), seed=seed, shifts=1, profile=profile)
    assert bus(replace(alone, firmware=Firmware.NATIVE)) == bus(alone)


class Driven:
    """A rig, or one with the firmware, and what it has sent."""

    def __init__(self, node: Core) -> None:
        self._node = node
        self._valves = Transmitter(Node.TRANSMISSION_CONTROL)
        self._bench = Transmitter(Node.BENCH)
        self.frames: list[Frame] = []

    def step(self, now_us: int) -> None:
        self.frames += self._node.step(now_us).frames

    def ask(self, command: ValveCommand) -> None:
        self._node.receive(self._valves.encode(command))

    def run(
        self, from_us: int, to_us: int, command: Callable[[int], ValveCommand | None],
        main_rad_s: float | None = None,
    ) -> None:  # fmt: skip
        """Commands each 10 ms, 4 ms behind the read; the bench may bring it to a speed."""
        for now_us in range(from_us, to_us, CYCLE_US):
            while self._node.next_step_us < now_us + 4_000:
                self.step(max(self._node.next_step_us, now_us))
            asked = command(now_us)
            if asked is not None:
                self.ask(asked)
                self._node.receive(self._valves.encode(ClutchCommand(action=ClutchAction.CLOSE)))
            if main_rad_s is not None:
                ask = BenchCommand(action=BenchAction.RETURN_TO_GEAR, gear=8, sequence=1,
                                   main_speed_rad_s=main_rad_s)  # fmt: skip
                self._node.receive(self._bench.encode(ask))
            self.step(now_us + 4_000)
        self.step(to_us - 1)


def both(built: bytes, settings: RigSettings) -> tuple[Driven, Driven]:
    with_firmware = FirmwareRig(RigCore(SHEET, settings), NativeBoard(built))
    return Driven(RigCore(SHEET, settings)), Driven(with_firmware)


def idle(_now_us: int) -> ValveCommand:
    return ValveCommand()


@pytest.mark.parametrize("seed", [1, 2])
def test_wheels_that_stand_and_then_turn_are_reported_as_the_rig_does(
    built: bytes, seed: int
) -> None:
    alone, firmware = both(built, RigSettings(seed=seed, main_speed_rpm=0.0))
    for each in (alone, firmware):
        each.run(0, 1_500_000, idle)
        each.run(1_500_000, 5_500_000, idle, main_rad_s=60.0)
    assert firmware.frames == alone.frames
    reads = [read_alone(MAIN_RISE, frame) for frame in firmware.frames
             if frame.can_id == MAIN_RISE.spec.can_id]  # fmt: skip
    assert {(read.stopped, read.valid_stamps == 27) for read in reads} >= {
        (True, False),
        (False, True),
    }


def test_when_commands_stop_the_firmware_ends_them_as_the_rig_does(built: bytes) -> None:
    def brake(now_us: int) -> ValveCommand | None:
        return ValveCommand(brake_action=ValveAction.ON_NOW) if now_us < 200_000 else None

    alone, firmware = both(built, RigSettings(seed=1))
    for each in (alone, firmware):
        each.run(0, 600_000, brake)
    statuses = [read_alone(STATUS, frame) for frame in firmware.frames
                if frame.can_id == STATUS.spec.can_id]  # fmt: skip
    assert statuses[15].brake_energised
    assert (statuses[-1].brake_energised, statuses[-1].expired_count) == (False, 1)
    assert firmware.frames == alone.frames


def test_steps_that_come_late_as_on_a_real_bus_switch_at_the_same_microseconds(
    built: bytes,
) -> None:
    """Up to 9 ms late; the splitter is pushed to and fro by pulses of 40 ms at sensor times."""
    rng = random.Random(48)
    alone, firmware = both(built, RigSettings(seed=1, profile=Profile.CLEAN, main_speed_rpm=0.0))
    now_us = 0
    while now_us < 2_000_000:
        for each in (alone, firmware):
            each.step(now_us)
            each.ask(pulse(now_us, first_sensor_us(each)))
        now_us += rng.randrange(500, 9_000)
    statuses = [read_alone(STATUS, frame) for frame in firmware.frames
                if frame.can_id == STATUS.spec.can_id]  # fmt: skip
    assert {(each.split_low_energised, each.split_high_energised) for each in statuses} == {
        (False, False), (True, False), (False, True),
    }  # fmt: skip
    assert firmware.frames == alone.frames


def pulse(now_us: int, sensor_us: int) -> ValveCommand:
    """One of 40 ms in each 100 ms, of either valve of the splitter by turns; commanded ahead of its
    begin and its end. sensor_us: the sensor clock at time 0."""
    begin_us = now_us // 100_000 * 100_000 + 31_234
    ends = now_us > begin_us + 20_000
    action = ValveAction.OFF_AT if ends else ValveAction.ON_AT
    at_us = (sensor_us + begin_us + 40_000 * ends) % (1 << 32)
    if begin_us // 100_000 % 2:
        return ValveCommand(split_low_action=action, split_low_time_us=at_us)
    return ValveCommand(split_high_action=action, split_high_time_us=at_us)


def first_sensor_us(driven: Driven) -> int:
    read = next(frame for frame in driven.frames if frame.can_id == MAIN_RISE.spec.can_id)
    return int(read_alone(MAIN_RISE, read).read_time_us)


def test_at_its_end_the_board_has_no_power_and_no_valve_is_driven(built: bytes) -> None:
    rig = RigCore(SHEET, RigSettings(seed=1))
    node = FirmwareRig(rig, NativeBoard(built))
    driven = Driven(node)
    driven.run(0, 200_000, lambda _: ValveCommand(brake_action=ValveAction.ON_NOW))
    last = node.shutdown(200_000)
    assert STATUS.spec.can_id in {frame.can_id for frame in last.frames}
    status = next(f for f in rig.shutdown(200_000).frames if f.can_id == STATUS.spec.can_id)
    assert not read_alone(STATUS, status).brake_energised


def test_simulate_makes_shifts_with_the_firmware(
    built: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", "--shifts", "1", "--json", "-", "--firmware", "native"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["shifts"]
    assert (row["result"], row["fault"]) == ("engaged", "none")


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["simulate", "--shifts", "1", "--firmware", "native", *arguments]) == 2
    return capsys.readouterr().err


def test_a_fault_of_the_board_itself_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "faults.toml"
    scenario.write_text('[[fault]]\nkind = "node_restart"\nat_ms = 100\n')
    said = refused(capsys, "--faults", str(scenario))
    assert "NODE_RESTART" in said and "allowed are faults of the gearbox" in said


def test_without_a_compiler_it_says_what_brings_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(build.shutil, "which", lambda _: None)
    monkeypatch.setattr(
        build, "find_spec", lambda name: None if name == "ziglang" else find_spec(name)
    )
    assert "pip install 'meshpoint[firmware]'" in refused(capsys)


def test_a_source_that_does_not_compile_is_named(built: bytes, tmp_path: Path) -> None:
    broken = tmp_path / "broken.c"
    broken.write_text("int broken(void) { return; }\n")
    with pytest.raises(build.CommandError, match=r"not compiled:\n.*broken\.c"):
        build.compiled([broken], tmp_path / "broken.so")


SENSOR_SIDE = {
    name for name in (codec.spec.name for codec in CODECS.values())
    if name.startswith(("Edges", "Sleeves", "GearboxSensors"))
}  # fmt: skip


@pytest.mark.parametrize(("image", "sent"), [("sensor", SENSOR_SIDE), ("valve", {"ValveStatus"})])
def test_each_image_sends_its_own_part_alone(built: bytes, image: str, sent: set[str]) -> None:
    options = build.IMAGES[image]
    board = NativeBoard(build.library(build.source_folder(), options))
    assert set(CommandBench(board).read()) == sent
