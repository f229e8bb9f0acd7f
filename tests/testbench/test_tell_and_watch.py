"""`tell` and `watch`: what they say of a log, in words and as a picture, is what its rows say."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from meshpoint.bus.logs.files import read_logs
from meshpoint.cli.main import main
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import (
    TC1,
    ControllerState,
    ControllerStatus,
    Engagement,
    EngagementEvent,
    FaultCode,
    GearboxSensors,
    ShiftOutcome,
    ShiftResult,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.logs.panel import HEIGHT, WIDTH, Panel
from meshpoint.logs.story import RESULTS, STATES, TRUTHS, Line, Story

SHEET = "thesis"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[dict[str, Any]]]:
    """A log of two shifts in virtual time, and its rows."""
    folder = tmp_path_factory.mktemp("tell")
    log, rows = folder / "x.log", folder / "rows.json"
    run = ["simulate", "--preset", "thesis", "--gearbox", SHEET, "--shifts", "2", "--seed", "3"]
    assert main([*run, "--log", str(log), "--json", str(rows)]) == 0
    return log, json.loads(rows.read_text())["shifts"]


def reported(log: Path) -> list[Line]:
    story = Story()
    return [line for time_s, frame in read_logs([log]) for line in story.receive(time_s, frame)]


def test_each_shift_is_reported_from_its_request_to_its_end_with_the_rows_own_figures(
    run: tuple[Path, list[dict[str, Any]]],
) -> None:
    log, rows = run
    lines = reported(log)
    requests = [line.words for line in lines if line.who == "driver"]
    assert requests == [f"asks for gear {row['to']}" for row in rows]
    ends = [line.words for line in lines if re.match(r"gear \d+ is in", line.words)]
    assert [words.split(" ms")[0] for words in ends] == [
        f"gear {row['to']} is in: {row['duration_ms']:.0f}" for row in rows
    ]
    contacts = [line for line in lines if line.words.startswith("tooth meets")]
    contacts = [line for line in contacts if line.of_request_ms is not None]
    for line, row in zip(contacts, rows, strict=True):
        assert line.words.startswith(f"tooth meets {row['contact']}")
        assert f"{row['phase_error_deg']:+.2f} deg" in line.words
        expected_ms = ((row["contact_us"] - row["request_us"]) & 0xFFFF_FFFF) / 1000
        # counted from the request on the bus, which the controller takes at its next tick
        assert expected_ms <= line.of_request_ms <= expected_ms + 11
    for end, row in zip((line for line in lines if line.words in ends), rows, strict=True):
        assert row["duration_ms"] <= (end.of_request_ms or 0.0) <= row["duration_ms"] + 25


def test_what_the_bench_does_to_the_gears_is_said_to_be_its_own(
    run: tuple[Path, list[dict[str, Any]]],
) -> None:
    lines = reported(run[0])
    is_bench, found = False, {True: 0, False: 0}
    for line in lines:
        if line.who in ("bench", "driver"):
            is_bench = line.words.startswith("puts the gearbox back")
        if "tooth meets" in line.words or "locked" in line.words:
            assert line.words.endswith(" (moved by the bench)") is is_bench, line
            found[is_bench] += 1
    assert found[True] >= 2 and found[False] >= 4


def test_a_shift_of_the_splitter_alone_is_not_said_to_lack_a_reference() -> None:
    outcome = ShiftOutcome(
        from_gear=7, to_gear=8, engagement=Engagement.SPLITTER, result=ShiftResult.ENGAGED,
        attempts=1,
    )  # fmt: skip
    sender = Transmitter(Node.TRANSMISSION_CONTROL)
    (line,) = Story().receive(0.0, sender.encode(outcome))
    assert line.words == "gear 8 is in: 0 ms, 1 firing"
    (line,) = Story().receive(0.1, sender.encode(outcome._replace(engagement=Engagement.MAIN_GEAR)))
    assert line.words.endswith("phase reference not known yet")


def test_nothing_is_lost_in_a_run_without_faults(
    run: tuple[Path, list[dict[str, Any]]],
) -> None:
    assert [line for line in reported(run[0]) if line.who == "bus"] == []


def test_a_message_that_falls_silent_is_reported_once_and_reported_again_when_it_is_back(
    run: tuple[Path, list[dict[str, Any]]],
) -> None:
    can_id = CODECS["SleevesMain"].spec.can_id
    story, lines, begin_s = Story(), [], None
    for time_s, frame in read_logs([run[0]]):
        begin_s = time_s if begin_s is None else begin_s
        away = 1.0 < time_s - begin_s < 1.3
        if not (away and frame.can_id == can_id):
            lines += story.receive(time_s, frame)
    bus = [line for line in lines if line.who == "bus"]
    assert [line.words.split(" ")[0] for line in bus] == ["SleevesMain", "SleevesMain"]
    assert "lost" in bus[0].words and "in order again" in bus[1].words
    assert 1.03 < bus[0].at_s < 1.1 and 1.3 < bus[1].at_s < 1.4


def test_a_log_whose_clock_waits_for_a_busy_machine_loses_nothing(
    run: tuple[Path, list[dict[str, Any]]],
) -> None:
    """Ten times the log's time between frames, the same sensor times inside them."""
    story, lines = Story(), []
    for time_s, frame in read_logs([run[0]]):
        lines += story.receive(10 * time_s, frame)
    assert [line for line in lines if line.who == "bus"] == []


def test_every_state_result_and_event_has_its_words() -> None:
    assert set(STATES) == set(ControllerState)
    assert set(RESULTS) == set(ShiftResult)
    assert set(TRUTHS) == set(EngagementEvent)


@pytest.mark.parametrize(
    ("aborts", "words"),
    [
        (0, "1 firing, phase"),
        (1, "1 firing, aborted once, stood at 3.4 mm, phase"),
        (2, "1 firing, aborted twice, last stood at 3.4 mm, phase"),
        (3, "1 firing, aborted 3 times, last stood at 3.4 mm, phase"),
    ],
)
def test_the_end_of_a_shift_says_how_often_its_sleeve_was_aborted(aborts: int, words: str) -> None:
    outcome = ShiftOutcome(to_gear=3, result=ShiftResult.ENGAGED, attempts=1)
    if aborts:
        outcome = outcome._replace(aborts=aborts, halt_position_m=-3.4e-3)
    (line,) = Story().receive(0.0, Transmitter(Node.TRANSMISSION_CONTROL).encode(outcome))
    assert words in line.words


def states_told(*states: ControllerState) -> list[str]:
    """What a story says of a controller that goes through these states."""
    story, controller = Story(), Transmitter(Node.TRANSMISSION_CONTROL)
    lines: list[Line] = []
    for k, state in enumerate(states):
        status = ControllerStatus(step_number=k, step_time_us=10_000 * k, state=state)
        lines += story.receive(k / 100, controller.encode(status))
    return [line.words for line in lines]


def test_a_sleeve_that_is_stopped_and_fired_again_is_told() -> None:
    told = states_told(
        ControllerState.ENGAGING, ControllerState.HALTED, ControllerState.ENGAGING
    )  # fmt: skip
    assert told[1:] == [
        "the sleeve would meet a tooth: stops it before the teeth",
        "the sleeve is on its way",
    ]


@pytest.mark.parametrize("state", [ControllerState.STEPS_CHANGING, ControllerState.COASTING])
def test_a_sleeve_that_leaves_neutral_is_told_apart_from_the_old_gear(
    state: ControllerState,
) -> None:
    assert states_told(state, ControllerState.DISENGAGING)[1] == (
        "a sleeve has left neutral: brings it back"
    )
    assert states_told(ControllerState.CLUTCH_OPENING, ControllerState.DISENGAGING)[1] == (
        "pulls the old gear's sleeve out"
    )


def test_a_refusal_names_its_fault() -> None:
    controller = Transmitter(Node.TRANSMISSION_CONTROL)
    outcome = ShiftOutcome(to_gear=3, result=ShiftResult.REFUSED, fault=FaultCode.LOW_SUPPLY)
    lines = Story().receive(0.0, controller.encode(outcome))
    assert [line.words for line in lines] == ["gear 3 is refused (fault: low supply)"]


def test_frames_that_are_not_ours_or_damaged_tell_nothing_and_raise_nothing() -> None:
    story = Story()
    good = Transmitter(Node.GEARBOX_IO).encode(ValveStatus(brake_energised=True))
    damaged = Frame(good.can_id, bytes(good.data[:-1]) + b"\xff", good.is_fd, True)
    for frame in (damaged, Frame(0x123, b"", False, False), Frame(good.can_id, b"")):
        assert story.receive(0.0, frame) == []
    assert story.heard.foreign == 1


def test_json_has_a_line_for_each_event(
    run: tuple[Path, list[dict[str, Any]]], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["tell", str(run[0]), "--json", "--only", "driver", "truth"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {line["who"] for line in lines} == {"driver", "truth"}
    assert all(set(line) == {"at_s", "of_request_ms", "who", "words"} for line in lines)


def test_a_terminal_s_lines_fit_into_its_width_and_a_pipe_has_one_line_an_event(
    run: tuple[Path, list[dict[str, Any]]],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert main(["tell", str(run[0])]) == 0
    piped = capsys.readouterr().out.splitlines()
    monkeypatch.setenv("TTY_COMPATIBLE", "1")  # as rich is told that it writes to a terminal
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("NO_COLOR", "1")
    assert main(["tell", str(run[0])]) == 0
    shown = [re.sub(r"\x1b\[[0-9;]*m", "", line) for line in capsys.readouterr().out.splitlines()]
    assert max(map(len, piped)) > 80 >= max(map(len, shown))
    assert len(shown) > len(piped)
    joined = " ".join(" ".join(shown).split())
    assert joined == " ".join(" ".join(piped).split())


def test_a_torn_log_is_reported_up_to_its_defect_and_ends_with_2(
    run: tuple[Path, list[dict[str, Any]]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = run[0].read_text().splitlines(keepends=True)
    torn = tmp_path / "torn.log"
    torn.write_text("".join(text[: len(text) // 2]) + "(12.5) vcan0 18FF")
    assert main(["tell", str(torn)]) == 2
    said = capsys.readouterr()
    assert "asks for gear" in said.out
    assert "torn.log" in said.err


def picture(panel: Panel) -> list[str]:
    return [line.plain for line in panel.lines()]


def test_the_picture_fits_a_terminal_of_80_by_24_at_every_moment(
    run: tuple[Path, list[dict[str, Any]]],
) -> None:
    panel = Panel(load_sheet(SHEET), "x" * 30)
    assert len(picture(panel)) == HEIGHT
    for k, (time_s, frame) in enumerate(read_logs([run[0]])):
        panel.receive(time_s, frame)
        if k % 200 == 0:
            lines = picture(panel)
            assert len(lines) == HEIGHT
            assert max(map(len, lines)) <= WIDTH


def test_the_picture_shows_the_gear_the_air_and_how_the_shifts_ended(
    run: tuple[Path, list[dict[str, Any]]],
) -> None:
    log, rows = run
    panel = Panel(load_sheet(SHEET), "log")
    for time_s, frame in read_logs([log]):
        panel.receive(time_s, frame)
    text = "\n".join(picture(panel))
    assert f"gear   {rows[-1]['to']}  in gear" in text
    for row in rows:
        assert f"{row['from']}-{row['to']} {row['duration_ms']:.0f} ms {row['contact']}" in text


@pytest.mark.parametrize(("clutch", "brake_pa"), [(0.0, 1e5), (0.5, 3.2e5), (1.0, 8.6e5)])
def test_the_air_line_shows_what_the_sensors_say(clutch: float, brake_pa: float) -> None:
    panel = Panel(load_sheet(SHEET), "log")
    sensors = GearboxSensors(
        brake_pressure_pa=brake_pa, supply_pressure_pa=9e5, clutch_position_fraction=clutch
    )
    panel.receive(0.0, Transmitter(Node.GEARBOX_IO).encode(sensors))
    text = "\n".join(picture(panel))
    assert f"brake {brake_pa / 1e5:4.1f} bar(a)  supply  9.0 bar(a)  oil" in text
    assert f"clutch {100 * clutch:3.0f} % closed" in text


def test_a_sleeve_that_stands_before_the_teeth_is_in_the_picture_s_gear_line() -> None:
    panel = Panel(load_sheet(SHEET), "log")
    status = ControllerStatus(state=ControllerState.HALTED, current_gear=0, target_gear=10)
    panel.receive(0.0, Transmitter(Node.TRANSMISSION_CONTROL).encode(status))
    assert "gear   N -> 10  waiting before the teeth" in "\n".join(picture(panel))


def test_a_silent_bus_lets_messages_grow_old_and_red() -> None:
    panel = Panel(load_sheet(SHEET), "bus")
    rig, controller = Transmitter(Node.GEARBOX_IO), Transmitter(Node.TRANSMISSION_CONTROL)
    for k in range(10):
        panel.receive(k / 100, rig.encode(GearboxSensors(sample_time_us=10_000 * k)))
        panel.receive(k / 100, controller.encode(ControllerStatus(step_time_us=10_000 * k)))
    assert panel.heard.valid(GearboxSensors)
    panel.heard.idle(1.0)
    assert not panel.heard.valid(GearboxSensors)
    assert panel.heard.age_s(GearboxSensors) == pytest.approx(0.91)
    aged = next(line for line in panel.lines() if "GearboxSensors" in line.plain)
    assert any("red" in str(span.style) for span in aged.spans)


def test_requests_of_the_same_gear_are_reported_once_until_the_shift_has_ended() -> None:
    story, bench = Story(), Transmitter(Node.BENCH)
    for k in range(5):
        story.receive(k / 10, bench.encode(TC1(requested_gear=5)))
    done = Transmitter(Node.TRANSMISSION_CONTROL).encode(
        ShiftOutcome(to_gear=5, result=ShiftResult.ENGAGED)
    )
    assert len(story.receive(1.0, done)) == 1
    assert len(story.receive(1.1, bench.encode(TC1(requested_gear=5)))) == 1


def in_a_terminal(*arguments: str) -> tuple[int, str]:
    """The command on a pseudo-terminal of 80 x 24: exit code, and all that it wrote."""
    pty = pytest.importorskip("pty", reason="no pseudo-terminals on this system")
    master, slave = pty.openpty()
    size = {"COLUMNS": "80", "LINES": "24", "TERM": "xterm-256color"}
    with subprocess.Popen(
        [sys.executable, "-m", "meshpoint", *arguments],
        stdin=slave, stdout=slave, stderr=slave, env={**os.environ, **size},
    ) as process:  # fmt: skip
        os.close(slave)
        parts = []
        while True:
            try:
                part = os.read(master, 65536)
            except OSError:  # the other end has gone
                break
            if not part:
                break
            parts.append(part)
        code = process.wait()
    os.close(master)
    return code, b"".join(parts).decode()


def test_in_a_real_terminal_it_draws_on_a_screen_of_its_own_and_leaves_the_last_picture(
    run: tuple[Path, list[dict[str, Any]]],
) -> None:
    code, text = in_a_terminal("watch", str(run[0]), "--speed", "0", "--gearbox", SHEET)
    assert code == 0
    assert "\x1b[?1049h" in text and "\x1b[?1049l" in text
    after = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", text.split("\x1b[?1049l")[-1])
    rows = run[1]
    assert f"gear   {rows[-1]['to']}  in gear" in after
    assert max(len(line.rstrip("\r")) for line in after.split("\n")) <= WIDTH


def test_a_log_that_is_missing_is_an_error_and_nothing_else(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["tell", str(tmp_path / "none.log")]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert "none.log: cannot be read" in said.err


@pytest.mark.parametrize("command", ["watch", "tell"])
@pytest.mark.parametrize("name", ["bus.log", "bus", "nowhere.log"])
def test_of_what_cannot_be_read_at_all_nothing_but_that_is_said(
    command: str, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for pipe in ("bus.log", "bus"):
        os.mkfifo(tmp_path / pipe)
    assert main([command, str(tmp_path / name)]) == 2
    out, err = capsys.readouterr()
    (line,) = err.splitlines()
    assert not out
    assert line.startswith(f"meshpoint {command}: error: {tmp_path / name}: ")
