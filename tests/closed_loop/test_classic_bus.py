"""A shift over 8-byte frames: the same cores, another wire."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import cantools
import pytest

from meshpoint.bench.simulate import Result, Setup, simulate
from meshpoint.bus.classic.cores import ClassicListenerCore
from meshpoint.bus.core import Step
from meshpoint.bus.logs.reader import read_log
from meshpoint.bus.profile import WireProfile
from meshpoint.cli.main import main
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.classic.codecs import CLASSIC_CODECS, ClassicSender
from meshpoint.dbc.classic.source import CLASSIC_DBC
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import FrameVerdict, Receiver
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.replays.replay import LogReplay

Run = tuple[Result, list[tuple[int, Frame]], Path]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
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
    folder = tmp_path_factory.mktemp("classic")
    setup.header.save(folder)
    result = simulate(setup, lambda time_us, frame: frames.append((time_us, frame)), record=folder)
    return result, frames, folder


def test_the_same_core_shifts_over_eight_byte_frames(run: Run) -> None:
    result, _, _ = run
    assert [(row.from_, row.to, row.result) for row in result.rows] == [(8, 10, "engaged")] * 2
    assert result.rows[1].reference == "known"
    assert not result.stuck


def test_the_log_decodes_by_the_profiles_dbc_alone(run: Run) -> None:
    """Every frame has 8 bytes and an identifier of it; edges are those of the two shafts, and the
    bus is taken for less than the bound."""
    result, frames, _ = run
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


def verified(folder: Path, frames: Iterable[Frame]) -> str:
    """What a replay says of these frames, header and steps beside them."""
    return " | ".join(map(str, LogReplay(folder, verify=True).run(frames)))


def test_its_log_is_repeated_to_the_byte(run: Run) -> None:
    """By the record of its steps; every frame that the controller has sent is compared."""
    _, frames, folder = run
    own = sum(frame.can_id & 0xFF == 0x03 for _, frame in frames)
    text = verified(folder, (frame for _, frame in frames))
    assert text.startswith("identical: ")
    assert text.endswith(f" steps, {own} frames")


def test_a_part_of_the_log_is_verified_as_far_as_it_goes(run: Run) -> None:
    _, frames, folder = run
    some = [frame for _, frame in frames[:3_000]]
    text = verified(folder, some)
    assert text.startswith("identical: ")
    assert "the controller made " in text
    assert "mid-run" in verified(folder, some[1_500:])


def test_a_bit_that_the_controller_did_not_send_is_found(run: Run) -> None:
    """In valve orders and in a request to the engine, which has no protection; a frame more under
    the controller's address is named, not taken for its own."""
    _, frames, folder = run
    some = [frame for _, frame in frames[:3_000]]
    orders, engine = (
        next(n for n, f in enumerate(some) if f.can_id == can_id and n > first)
        for can_id, first in ((0x0CFF9103, 2_000), (0x0C000003, 1_000))
    )
    sender = ClassicSender("ValveOrders")
    sender.counter = (some[orders].data[1] - 1) % 15
    said = CLASSIC_CODECS["ValveOrders"].decode(some[orders].data)
    other = said._replace(clutch=1 if said.clutch != 1 else 2)
    changed = some.copy()
    changed[orders] = sender.frame(other)
    assert "differs at step " in verified(folder, changed)
    request = some[engine]
    wrong = request._replace(data=request.data[:-1] + bytes([request.data[-1] ^ 0x10]))
    changed = some.copy()
    changed[engine] = wrong
    assert "frame 0C000003 byte 7" in verified(folder, changed)
    text = verified(folder, [*some[:engine], wrong, *some[engine:]])
    assert text.startswith("identical")
    assert "not its own: 0C000003 (1)" in text


def test_a_sensor_frame_that_was_lost_or_changed_is_not_passed_over(run: Run) -> None:
    _, frames, folder = run
    some = [frame for _, frame in frames[:3_000]]
    read = next(n for n, f in enumerate(some) if f.can_id == 0x18FF8080 and n > 2_000)
    why = "not in the log as it received them"
    assert why in verified(folder, some[:read] + some[read + 1 :])


def test_two_runs_in_a_log_and_one_that_was_killed(run: Run) -> None:
    """Each has its record. Of the first, some of the last frames are not in the log."""
    _, frames, folder = run
    all_ = [frame for _, frame in frames]
    last = max(n for n, frame in enumerate(all_[:3_000]) if frame.can_id == 0x0CFF9103)
    (path,) = folder.glob("steps-*.jsonl")
    lines = path.read_text().splitlines(keepends=True)
    steps = sum(frame.can_id == 0x0CFF9103 for frame in all_[: last + 1])
    cut = folder / "killed"
    cut.mkdir()
    for header in folder.glob("header-*.json"):
        (cut / header.name).write_bytes(header.read_bytes())
    (cut / path.name).write_text("".join(lines[: 1 + steps]))
    first, second = verified(cut, [*all_[: last + 1], *all_[:3_300]]).split(" | ")
    assert first.startswith("identical: ")
    assert "the record of its steps ends here" in second


def test_without_its_record_a_log_is_refused_with_the_way(run: Run, tmp_path: Path) -> None:
    text = verified(tmp_path, (frame for _, frame in run[1][:2_000]))
    assert text.startswith("not verifiable")
    assert "--header-dir" in text


def test_the_command_line_has_the_profile(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its DBC's path and messages; what has no room in it is refused with the reason."""
    assert main(["show", "messages", "--path", "--profile", "classic"]) == 0
    assert capsys.readouterr().out.strip() == str(CLASSIC_DBC)
    assert main(["show", "messages", "ValveOrders", "--profile", "classic"]) == 0
    assert "FirstTime" in capsys.readouterr().out
    log = tmp_path / "run.log"
    short = ["simulate", "--profile", "classic", "--shifts", "1", "--log", str(log)]
    assert main([*short, "--bus-load", "0.8"]) == 2
    assert "--profile fd alone" in capsys.readouterr().err
    assert not log.exists() or not list(read_log(log))
