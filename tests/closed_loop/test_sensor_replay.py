"""Logs that our controller has not made: sensor frames alone, another bus, speeds alone."""

from __future__ import annotations

import json
import math
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from loop_bench import Loop
from page_data import page_data

from meshpoint.base.exits import Exit
from meshpoint.bus.logs.recorder import LogWriter
from meshpoint.cli.main import main
from meshpoint.controller.core.core import OWN_ADDRESS
from meshpoint.controller.settings.header import new_header
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ShiftOutcome, ShiftResult
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.replays.sensor_replay import SensorReplay

EXAMPLE = Path(__file__).parents[2] / "examples" / "other_bus"
SHEET = load_sheet("thesis")
WAITED = ("fired", "not fired")
ETC1_ID = CODECS["ETC1"].spec.can_id


def sensors_of(loop: Loop) -> list[tuple[int, Frame]]:
    return [(t, f) for t, f in loop.frames if f.can_id & 0xFF != OWN_ADDRESS]


def end_of(loop: Loop, shifts: int) -> int:
    """A while after this many shifts have ended, us."""
    ended = [t for t, message in loop.messages if isinstance(message, ShiftOutcome)]
    return ended[shifts - 1] + 300_000


def write(path: Path, frames: list[tuple[float, Frame]]) -> Path:
    with LogWriter(path, flush_every_s=None) as log:
        for time_s, frame in frames:
            log.write(time_s, frame)
    return path


def replayed(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    given = ("replay", *arguments, "--gearbox", SHEET.name, "--json", "-")
    assert main(list(map(str, given))) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def etc1(input_rpm: float, output_rpm: float, source: int = OWN_ADDRESS) -> Frame:
    """A J1939-71 ETC1 with two speeds and nothing else."""
    output, shaft = round(output_rpm * 8).to_bytes(2, "little"), round(input_rpm * 8)
    data = b"\xff" + output + b"\xff\xff" + shaft.to_bytes(2, "little") + b"\xff"
    return Frame((ETC1_ID & ~0xFF) | source, data, is_fd=False)


def speeds_of_two_gears() -> list[tuple[float, Frame]]:
    """Gear 8 for 2 s, half a second on the way, gear 10 for 2 s; every 10 ms."""
    frames = []
    for k in range(450):
        time_s = 1.0 + 0.01 * k
        before, after = (SHEET.overall_ratio(DRIVE_GEARS[n]) for n in (8, 10))
        share = min(max((k - 200) / 50.0, 0.0), 1.0)
        ratio = before + (after - before) * share
        frames.append((time_s, etc1(900.0 * ratio, 900.0, source=0x77)))
    return frames


@pytest.mark.parametrize(
    ("shifted_s", "shifts"), [pytest.param(0.0, 6, marks=pytest.mark.long), (1.7e9, 2)]
)
def test_sensor_frames_alone_are_enough(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    shifted_s: float,
    shifts: int,
) -> None:
    """Every request is judged, none swallowed; no outcome of the log is anybody's; and phase
    references are learned from gears that another controller engaged."""
    loop = Loop(shifts=shifts).run(40_000_000)
    frames = [(shifted_s + t * 1e-6, frame) for t, frame in sensors_of(loop)]
    found = replayed(capsys, write(tmp_path / "a.log", frames))
    assert found["mode"] == "sensors alone"
    asked = [(row["from"], row["to"]) for row in found["decisions"]]
    assert asked == ([(8, 10), (10, 12)] * 3)[:shifts]
    for row in found["decisions"]:
        # Without a phase it waits for a small slip, and the log's gear may be in before that.
        assert row["status"] in (("fired",) if row["strategy"] == "target_phase" else WAITED)
        assert "result" not in row
        assert row["contact"] is None
    assert found["unfinished_requests"] == 0
    if shifts > 5:
        aimed = [row for row in found["decisions"] if row["strategy"] == "target_phase"]
        assert aimed[-1]["reference"] == "known"
        assert abs(aimed[-1]["predicted_phase_deg"]) < 1.5
    seen = [(s["from"], s["to"]) for s in found["shifts_by_sleeves"]]
    assert [pair for pair in seen if pair != (12, 8)] == asked
    assert found["cannot"] == [
        "no speeds of input and output shaft (ETC1): no gears by their ratio"
    ]


@pytest.mark.parametrize(
    ("attempts", "aborts", "status"),
    [(0, 0, "not fired"), (0, 2, "aborted"), (1, 0, "fired"), (1, 2, "fired")],
)
def test_a_sleeve_that_was_fired_and_stopped_is_told_from_one_that_was_not_fired(
    attempts: int, aborts: int, status: str
) -> None:
    replay = SensorReplay(new_header("test", SHEET, ControllerSettings()))
    ended = ShiftResult.ENDED_IN_NEUTRAL
    replay.outcomes.append(
        (1.0, ShiftOutcome(8, 10, result=ended, attempts=attempts, aborts=aborts))
    )
    (row,) = replay.decided()
    assert (row["status"], row["attempts"], row["aborts"]) == (status, attempts, aborts)


@pytest.mark.long
def test_a_log_that_starts_in_mid_run_is_judged_by_its_sensors(
    six_shifts: Loop, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    end_us = end_of(six_shifts, 4)
    frames = [(t * 1e-6, f) for t, f in six_shifts.frames if 2_000_000 < t <= end_us]
    found = replayed(capsys, write(tmp_path / "a.log", frames))
    assert "the log starts in mid-run" in found["why"]
    assert len(found["decisions"]) >= 2
    assert found["controller_frames"]


def test_a_log_of_speeds_alone_gives_gears_and_shifts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """J1939 only, of a transmission with another source address."""
    path = write(tmp_path / "a.log", speeds_of_two_gears())
    found = replayed(capsys, path)
    (shift,) = found["shifts_by_ratio"]
    assert (shift["from"], shift["to"]) == (8, 10)
    assert shift["left_s"] == pytest.approx(2.05, abs=0.1)
    assert shift["open_ms"] == pytest.approx(500.0, abs=120.0)
    assert found["decisions"] == []
    for word in ("layshaft edges", "sleeve positions", "pressures", "request (TC1)"):
        assert any(word in line for line in found["cannot"])
    mapped = replayed(
        capsys, path, "--dbc", EXAMPLE / "vehicle.dbc", "--map", EXAMPLE / "vehicle.toml"
    )
    assert mapped["shifts_by_ratio"] == found["shifts_by_ratio"]
    assert mapped["mapped"]["speed.input"] == mapped["mapped"]["speed.propeller"] == 450


def test_another_bus_s_edges_positions_and_pressures_become_ours(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The worked example of docs/replay.md: a layshaft of 48 teeth at 1,000 rpm, whose edge times
    wrap in mid-log, in second gear."""
    frames: list[tuple[float, Frame]] = []
    pitch_us = 60e6 / 1000.0 / SHEET.wheels.layshaft.teeth
    for k in range(4000):
        edge = (round(k * pitch_us) - 1_000_000) % (1 << 32)
        at_s = 50.0 + k * pitch_us * 1e-6
        frames.append(
            (at_s, Frame(769, edge.to_bytes(8, "little"), is_fd=False, is_extended=False))
        )
        if k % 10 == 0:
            fork = (1200).to_bytes(2, "little") + bytes(6)
            frames.append((at_s, Frame(768, fork, is_fd=False, is_extended=False)))
            air = b"\xff\xff" + bytes([80]) + b"\xff" * 5
            frames.append((at_s, Frame(0x18FEAE30, air, is_fd=False)))
    path = write(tmp_path / "a.log", frames)
    found = replayed(
        capsys, path, "--dbc", EXAMPLE / "vehicle.dbc", "--map", EXAMPLE / "vehicle.toml"
    )
    assert found["mapped"]["edge.layshaft.rise"] == 4000
    least, most = found["speeds_rpm"]["layshaft"]
    assert least == pytest.approx(1000.0, abs=3.0)
    assert most == pytest.approx(1000.0, abs=3.0)
    assert found["inputs"]["EdgesLayshaftRise"] == pytest.approx(found["seconds"] * 100, abs=3)
    assert found["inputs"]["SleevesMain"] > 0
    assert found["inputs"]["GearboxSensors"] > 0
    assert not any("layshaft edges" in line for line in found["cannot"])
    assert any("main shaft edges" in line for line in found["cannot"])


@pytest.mark.parametrize(
    ("entry", "named"),
    [
        ('message = "ETC1"\nsignal = "InputShaftSpeed"\nis = "speed.wheel"', "speed.propeller"),
        ('message = "ETC9"\nsignal = "InputShaftSpeed"\nis = "speed.input"', "ETC9"),
        ('message = "ETC1"\nsignal = "Nothing"\nis = "speed.input"', "Nothing"),
        ('message = "ETC1"\nsignal = "InputShaftSpeed"', "a key is missing"),
        ('message = "ETC1"\nsignal = "InputShaftSpeed"\nis = "speed.input"\nunit = 1', "unit"),
    ],
)
def test_a_map_that_cannot_be_used_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], entry: str, named: str
) -> None:
    log, table = write(tmp_path / "a.log", speeds_of_two_gears()[:3]), tmp_path / "map.toml"
    table.write_text(f"[[signal]]\n{entry}\n")
    command = ["replay", str(log), "--dbc", str(EXAMPLE / "vehicle.dbc"), "--map", str(table)]
    assert main(command) == 2
    error = capsys.readouterr().err
    assert "map.toml: [[signal]] 1" in error
    assert named in error


def test_a_map_without_a_dbc_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write(tmp_path / "a.log", speeds_of_two_gears()[:3])
    assert main(["replay", str(log), "--map", str(EXAMPLE / "vehicle.toml")]) == 2
    assert "--dbc and --map go together" in capsys.readouterr().err


def test_a_log_of_many_days_whose_clock_is_set_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An hour back at the end of summer time, and three days without a frame: both are reported,
    and no step is made for each 10 ms of them."""
    frames = [(t + 1e6, f) for t, f in speeds_of_two_gears()]
    later = [(t + 3 * 86_400.0 - 3_600.0, f) for t, f in frames]
    again = [(t - 3_600.0, f) for t, f in frames[:100]]
    path = tmp_path / "a.log"
    # As candump has it: python-can's writer lets no time go back.
    lines = [f"({t:.6f}) can0 {f.can_id:08X}#{f.data.hex()}" for t, f in [*frames, *again, *later]]
    path.write_text("\n".join(lines) + "\n")
    found = replayed(capsys, path)
    assert found["clock_set_back_s"] == [[4.49, pytest.approx(3604.49, abs=0.02)]]
    (silence,) = found["silent_s"]
    assert silence[1] == pytest.approx(3 * 86_400.0, abs=2.0)
    assert found["steps"] < 1_200
    assert len(found["shifts_by_ratio"]) == 3


def test_a_torn_log_gives_all_before_the_tear(
    one_shift: Loop, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = [(t * 1e-6, f) for t, f in sensors_of(one_shift)]
    path = write(tmp_path / "a.log", frames)
    content = path.read_bytes()
    path.write_bytes(content[: int(0.9 * len(content)) - 7])
    assert main(["replay", str(path), "--json", "-"]) == 2
    found = json.loads(capsys.readouterr().out)
    assert "the log ends inside this line" in found["defect"]
    assert found["decisions"][0]["to"] == 10
    assert found["seconds"] == pytest.approx(0.9 * frames[-1][0], rel=0.05)


def test_speeds_that_are_not_available_are_none() -> None:
    """J1939: the highest values say `error` and `not available`."""
    message = CODECS["ETC1"].decode(bytes.fromhex("ff" * 8))
    assert message is not None
    assert message.output_shaft_speed_rad_s is None
    assert math.isclose(
        CODECS["ETC1"].decode(etc1(1000.0, 500.0).data).input_shaft_speed_rad_s or 0.0,
        1000.0 * math.pi / 30.0,
    )


def test_ctrl_c_leaves_what_was_reported_up_to_there_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGINT in the middle of a log without our controller: exit code 130, not the whole log."""
    frames = [(k / 100, etc1(900.0, 900.0, source=0x77)) for k in range(4_000)]
    log, out = write(tmp_path / "x.log", frames), tmp_path / "out.json"
    take, taken = SensorReplay.take, [0]

    def count(self: SensorReplay, time_s: float, frame: Frame) -> None:
        taken[0] += 1
        if taken[0] == 1_200:
            os.kill(os.getpid(), signal.SIGINT)
        take(self, time_s, frame)

    monkeypatch.setattr(SensorReplay, "take", count)
    assert main(["replay", str(log), "--sensors", "--json", str(out)]) == Exit.INTERRUPTED
    values = json.loads(out.read_text())
    assert values["interrupted"] is True
    assert 1_200 <= values["frames"] < 4_000


@pytest.mark.long
def test_the_page_draws_speeds_and_gears_and_tells_no_contact_as_ours(
    six_shifts: Loop, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = [(t * 1e-6, f) for t, f in sensors_of(six_shifts)]
    page = tmp_path / "page.html"
    found = replayed(capsys, write(tmp_path / "a.log", frames), "--sensors", "--report", page)
    text = page.read_text(encoding="utf-8")
    traces = {trace["name"]: trace for trace in page_data(text)["overview"]["log"]["data"]}
    least, most = found["speeds_rpm"]["layshaft"]
    drawn = [value for value in traces["layshaft"]["y"] if value is not None]
    assert (min(drawn), max(drawn)) == (least, most)
    gears = {value for value in traces["gear by sleeves"]["y"] if value is not None}
    assert gears == {8, 10, 12}
    assert set(found["gears_by_sleeves_s"]) == {"8", "10", "12"}
    assert text.count("not reported: the gearbox of this log answered to another controller") == 6
    assert 'class="gap"' not in text
    assert 'class="tooth"' not in text
