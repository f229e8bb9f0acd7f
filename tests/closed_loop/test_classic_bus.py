"""A shift over 8-byte frames: the same cores, another wire."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import cantools
import pytest

from meshpoint.bus.classic.cores import ClassicListenerCore
from meshpoint.bus.core import Step
from meshpoint.bus.logs.limits import read_log
from meshpoint.bus.profile import WireProfile
from meshpoint.controller.settings import ControllerSettings
from meshpoint.dbc.classic.source import CLASSIC_DBC
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import FrameVerdict, Receiver
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.testbench.cli import main
from meshpoint.testbench.logs.replay import CLASSIC_LOG, LogReplay
from meshpoint.testbench.loop.simulate import Result, Setup, simulate

Run = tuple[Result, list[tuple[int, Frame]]]


@pytest.fixture(scope="module")
def run() -> Run:
    """Two shifts of the truck's box, the second one aimed; and every frame of the bus."""
    frames: list[tuple[int, Frame]] = []
    setup = Setup(
        load_sheet("truck12"),
        ControllerSettings(),
        seed=3,
        shifts=2,
        pairs=((8, 10),),
        wire=WireProfile.CLASSIC,
    )
    return simulate(setup, lambda time_us, frame: frames.append((time_us, frame))), frames


def test_the_same_core_shifts_over_eight_byte_frames(run: Run) -> None:
    result, _ = run
    assert [(row.from_, row.to, row.result) for row in result.rows] == [(8, 10, "engaged")] * 2
    assert result.rows[1].reference == "known"
    assert not result.stuck


def test_the_log_decodes_by_the_profiles_dbc_alone(run: Run) -> None:
    """Every frame has 8 bytes and an identifier of it; edges are those of the two shafts, and the
    bus is taken for less than the bound."""
    result, frames = run
    database = cantools.database.load_file(CLASSIC_DBC)
    names = set()
    for _, frame in frames:
        assert (len(frame.data), frame.is_fd) == (8, False)
        message = database.get_message_by_frame_id(frame.can_id)
        message.decode(frame.data, decode_choices=False)
        names.add(message.name)
    assert names >= {
        "SensorRead", "EdgesLayshaft", "EdgesMain", "GearboxState", "SleevesMainShort",
        "SleevesAuxShort", "SlowSensors", "ETC1", "EEC1", "ValveOrders", "ValveTime", "TSC1",
        "ControllerStatus7", "ShiftOutcome9", "ReferenceEngagement4", "BenchCommand2", "TC1",
    }  # fmt: skip
    assert 0.2 < result.bus_load < 0.6


class Ear:
    """A core that keeps what it hears."""

    def __init__(self) -> None:
        self.heard: list[Frame] = []
        self.next_step_us = 0

    def receive(self, frame: Frame) -> None:
        self.heard.append(frame)

    def step(self, now_us: int) -> Step:
        raise AssertionError(now_us)

    def shutdown(self, now_us: int) -> Step:
        raise AssertionError(now_us)


def test_a_listener_hears_sensors_commands_and_outcomes(run: Run) -> None:
    """As a shadow needs them: frames of meshpoint.dbc, whose counters go on without a gap."""
    ear = Ear()
    listener = ClassicListenerCore(ear, load_sheet("truck12"))
    for _, frame in run[1]:
        listener.receive(frame)
    receiver = Receiver(*Node)
    verdicts, kinds = Counter[FrameVerdict](), Counter[str]()
    for frame in ear.heard:
        verdict, message = receiver.receive(frame)
        verdicts[verdict] += 1
        kinds[type(message).__name__] += 1
    assert set(verdicts) == {FrameVerdict.OK}
    assert kinds["ShiftOutcome"] == 2
    assert min(kinds["ValveCommand"], kinds["EdgesLayshaftRise"], kinds["GearboxSensors"]) > 200


def test_a_replay_says_that_it_cannot_repeat_the_profile(run: Run, tmp_path: Path) -> None:
    _, frames = run
    (session,) = LogReplay(tmp_path, verify=True).run(frame for _, frame in frames[:2_000])
    assert (session.verdict.value, session.reason) == ("not verifiable", CLASSIC_LOG)


def test_the_command_line_has_the_profile(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its DBC's path and messages; what has no room in it is refused with the reason."""
    assert main(["dbc", "--path", "--profile", "classic"]) == 0
    assert capsys.readouterr().out.strip() == str(CLASSIC_DBC)
    assert main(["dbc", "ValveOrders", "--profile", "classic"]) == 0
    assert "FirstTime" in capsys.readouterr().out
    settings = tmp_path / "fused.toml"
    settings.write_text("[crossing_filter]\nfuse_input = true\n")
    log = tmp_path / "run.log"
    short = ["simulate", "--profile", "classic", "--shifts", "1", "--log", str(log)]
    for more, why in (
        (["--settings", str(settings)], "fuse_input"),
        (["--bus-load", "0.8"], "--profile fd alone"),
    ):
        assert main([*short, *more]) == 2
        assert why in capsys.readouterr().err
    assert not log.exists() or not list(read_log(log))
