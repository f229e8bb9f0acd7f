"""`meshpoint captures` on files made here: wheel, teeth, refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from meshpoint.bus.logs.reader import read_log
from meshpoint.cli.main import main
from meshpoint.controller.measure.clock import SensorClockEstimate
from meshpoint.controller.measure.wheel_edges import WheelEdges
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import EdgesLayshaftFall, EdgesLayshaftRise
from meshpoint.dbc.node import Node
from meshpoint.logs.capture_files import FoundWheel
from meshpoint.logs.capture_truth import true_teeth, wrong_teeth


def write_changes(
    path: Path, missing: tuple[int, ...], extra: bool = False, inverted: bool = False
) -> None:
    """An engine at 1,200 rpm whose speed swings by 2 % four times in two turns; 36 teeth."""
    rng = np.random.default_rng(5)
    pitch_s = 60.0 / 1200.0 / 36.0
    tooth = np.arange(36 * 40)
    swing = 0.02 * 36.0 / (4.0 * np.pi) * np.sin(tooth * 4.0 * np.pi / 36.0)
    rise = 1.0 + (tooth + swing) * pitch_s + 2e-6 * rng.standard_normal(tooth.size)
    present = ~np.isin(tooth % 36, missing)
    changes = [(t, 1) for t in rise[present]] + [(t + 0.45 * pitch_s, 0) for t in rise[present]]
    if extra:
        changes += [(rise[700] + 0.75 * pitch_s, 1), (rise[700] + 0.80 * pitch_s, 0)]
    lines = [f"{t:.9f},{level ^ inverted}" for t, level in sorted(changes)]
    path.write_text("time[s], level\n" + "\n".join(lines) + "\n")


def write_voltage(path: Path) -> None:
    """An inductive sensor's wave at 10 kHz on 3 V: its teeth are where it falls through."""
    time_s = np.arange(0.0, 3.0, 1e-4)
    angle = time_s * 160.0
    wave = np.where((angle % 60.0) < 58.0, 0.4 * np.sin(2.0 * np.pi * angle), 0.0)
    rng = np.random.default_rng(6)
    volt = 3.0 + wave + 0.02 * rng.standard_normal(time_s.size)
    rows = [f"{t:.4f},{v:.3f}" for t, v in zip(time_s, volt, strict=True)]
    path.write_text("t,V\n" + "\n".join(rows))


def test_wheels_are_found_and_their_patterns_predict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_changes(tmp_path / "a.csv", (34, 35))
    write_changes(tmp_path / "b.csv", (17, 34, 35), extra=True)
    write_voltage(tmp_path / "c.csv")
    assert main(["captures", str(tmp_path), "--json", "-"]) == 0
    a, b, c = json.loads(capsys.readouterr().out)["captures"]
    assert [row["wheel"] for row in (a, b, c)] == ["36-2", "36-2-1", "60-2"]
    for row in (a, b, c):
        assert (row["lost"], row["gaps_wrong"], row["doubts"]) == (0, 0, 0)
    assert a["ratio"] < 0.2
    assert a["extra_s"] == []
    assert len(b["extra_s"]) == 2
    assert b["extra_s"][0] == pytest.approx(1.0 + 700.75 / 36.0 * 0.05, abs=2e-3)


@pytest.mark.parametrize("missing", [(34, 35), (17, 34, 35)])
def test_a_wheel_whose_gap_is_high_is_numbered_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], missing: tuple[int, ...]
) -> None:
    write_changes(tmp_path / "a.csv", missing)
    write_changes(tmp_path / "b.csv", missing, inverted=True)
    assert main(["captures", str(tmp_path), "--json", "-"]) == 0
    normal, inverted = json.loads(capsys.readouterr().out)["captures"]
    for row in (normal, inverted):
        assert row["polarity"] == "both"
        assert (row["lost"], row["wrong"]) == (0, 0)
        assert row["checked"] == row["numbered"] > 0.92 * row["edges"]
        assert row["learned_rms_us"] <= 1.05 * row["turn_ago_rms_us"]
        assert row["learned_rms_us"] <= 1.05 * row["constant_speed_rms_us"]


def test_the_independent_numbering_finds_what_the_gate_has_wrong() -> None:
    """A tooth number off by one for seven teeth, as a true edge called extra made it; and a count
    that breaks inside the file is not held against anybody."""
    wheel, pitch_us = FoundWheel(36, (34, 35)), 1400.0
    tooth = np.array([k for k in range(36 * 12) if k % 36 < 34])
    rng = np.random.default_rng(3)
    rise_us = np.round((tooth + 0.03 * rng.standard_normal(tooth.size)) * pitch_us).astype(np.int64)
    true = true_teeth(rise_us, wheel, np.empty(0, np.int64))
    assert (true == tooth % 36).all()
    said = tooth.copy()
    said[200:207] -= 1
    assert wrong_teeth(said, true, 36, True) == (tooth.size, 7)
    # An edge that is extra breaks the count there, and there alone.
    more = np.insert(rise_us, 201, rise_us[200] + 600)
    found = true_teeth(more, wheel, np.empty(0, np.int64))
    known = found >= 0
    expected = np.insert(tooth % 36, 201, -2)
    assert (found[known] == expected[known]).all()
    assert known.sum() > tooth.size - 36


def test_one_bad_file_hides_no_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each file gives a row or a reason."""
    (tmp_path / "a.csv").write_text("0.1,1\n0.2,zero\n")
    write_changes(tmp_path / "b.csv", (34, 35))
    lines = [f"{0.05 * k},{k % 2}" for k in range(200)]
    (tmp_path / "c.csv").write_text("s,level\n" + "\n".join(lines))
    assert main(["captures", str(tmp_path), "--json", "-"]) == 0
    out = capsys.readouterr()
    found = json.loads(out.out)
    assert [row["file"] for row in found["captures"]] == ["b.csv"]
    assert [r["file"] for r in found["refused"]] == ["a.csv", "c.csv"]
    assert "line 2" in found["refused"][0]["reason"]
    assert "no gap" in found["refused"][1]["reason"]
    assert "a.csv: line 2" in out.err


def test_two_teeth_a_turn_are_no_wheel(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A second channel that comes every other edge."""
    lines = [f"{0.002 * k:.4f},{k % 2},{int(k % 4 < 2)}" for k in range(400)]
    (tmp_path / "two.csv").write_text("\n".join(lines))
    assert main(["captures", str(tmp_path)]) == 2
    assert "2 teeth a turn, 8 to 130 are allowed" in capsys.readouterr().err


def test_why_nothing_was_numbered(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A wheel that turns at 30 rpm may stop and turn back between two teeth."""
    slow = [f"{0.055 * (k + part):.5f},{part == 0}" for k in range(360) for part in (0, 0.5)]
    lines = [line.replace("True", "1").replace("False", "0") for line in slow]
    kept = [line for k, line in enumerate(lines) if k // 2 % 36 < 34]
    (tmp_path / "slow.csv").write_text("\n".join(kept))
    assert main(["captures", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "slow.csv" in error
    assert "too slow: a tooth takes 55.0 ms" in error


def test_columns_units_and_separators_of_other_instruments(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Remarks in front, semicolons, milliseconds, a dead channel first, a level of 0 and 5 V."""
    write_changes(tmp_path / "plain.csv", (34, 35))
    rows = (tmp_path / "plain.csv").read_text().splitlines()[1:]
    pairs = [row.split(",") for row in rows]
    lines = [f"{float(t) * 1e3:.6f};0.0;{5 * int(level)}.0" for t, level in pairs]
    head = "\ufeffsome analyser 1.0\nTime [ms];aux;wheel\n"
    (tmp_path / "other.csv").write_text(head + "\n".join(lines), encoding="utf-8")
    assert main(["captures", str(tmp_path), "--json", "-"]) == 0
    other, plain = json.loads(capsys.readouterr().out)["captures"]
    assert (other["wheel"], other["channel"]) == ("36-2", "wheel")
    for key in ("edges", "numbered", "wrong", "lost"):
        assert other[key] == plain[key]


@pytest.mark.parametrize("polarity", ["both", "inverted", "rising", "falling"])
def test_a_converted_capture_is_numbered_by_the_node(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], polarity: str
) -> None:
    """The log's frames through the node's own reading: the teeth that the capture had."""
    write_changes(tmp_path / "a.csv", (34, 35))
    log = tmp_path / "a.log"
    reported = ["--column", "1", "--teeth", "36", "--missing", "34,35", "--polarity", polarity]
    command = [
        "captures",
        str(tmp_path / "a.csv"),
        *reported,
        "--shaft",
        "layshaft",
        "-o",
        str(log),
    ]
    assert main(command) == 0
    out = capsys.readouterr().out
    assert "teeth = 36, missing = [34, 35]" in out
    receiver, clock = Receiver(Node.TRANSMISSION_CONTROL), SensorClockEstimate()
    wheel, numbered, rise = WheelEdges(36, 0.45, (34, 35), 150.0), 0, None
    for _, frame in read_log(log):
        message = receiver.receive(frame).message
        if isinstance(message, EdgesLayshaftRise):
            rise = message
        if isinstance(message, EdgesLayshaftFall) and rise is not None:
            batch = wheel.read([rise], [message], clock, message.read_time_us)
            numbered += batch.time_us.size
    assert wheel.health.counting
    assert wheel.broken == 0
    edges = 2 * 34 * 40 if polarity in ("both", "inverted") else 34 * 40
    assert numbered > 0.9 * edges
    assert f"{numbered} of {edges - (polarity != 'falling')} edges numbered" in out


def test_what_is_not_said_is_tried_and_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_voltage(tmp_path / "v.csv")
    assert main(["captures", str(tmp_path / "v.csv"), "-o", str(tmp_path / "v.log")]) == 0
    out = capsys.readouterr().out
    assert "tried: V, falling: 60-2" in out
    assert "edges: falling, wheel 60-2" in out


def test_what_is_known_of_captures_is_used_for_all_of_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a.csv", "b.csv"):
        write_changes(tmp_path / name, (34, 35))
    words = ["captures", str(tmp_path), "--polarity", "rising", "--json", "-"]
    assert main(words) == 0
    rows = json.loads(capsys.readouterr().out)["captures"]
    assert [row["polarity"] for row in rows] == ["rising", "rising"]
    (alone,) = rows[:1]
    words = [*words, "-o", str(tmp_path / "a.log")]
    words[1] = str(tmp_path / "a.csv")
    assert main(words) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["captures"] == [alone]
    assert "frames in" in err


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--teeth", "2"], "8 to 130"),
        (["--missing", "3"], "--missing without --teeth"),
        (["--teeth", "36", "--missing", "40"], "0 to 35"),
        (["--teeth", "12", "--missing", "0,4,8"], "6 are needed"),
        (["--column", "2"], "column 2, 1 to 1 are allowed"),
        (["--teeth", "60", "--missing", "58,59"], "no tooth of a 60-2 wheel numbered"),
    ],
)
def test_what_cannot_be_converted_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], named: str
) -> None:
    write_changes(tmp_path / "a.csv", (34, 35))
    command = ["captures", str(tmp_path / "a.csv"), "-o", str(tmp_path / "a.log"), *options]
    try:
        code = main(command)
    except SystemExit as end:
        code = end.code
    assert code == 2
    assert named in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("time,level\n0.1,1\n0.2,zero\n", ("line 3", "zero")),
        ("0.1,1\n0.2,0\n", ("2 lines", "8")),
        ("\n".join(f"{9 - k},{k % 2}" for k in range(9)), ("time goes back",)),
        ("\n".join(f"{k},{k % 2}" for k in range(50)), ("no gap",)),
    ],
)
def test_a_file_that_is_no_capture_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, named: tuple[str, ...]
) -> None:
    (tmp_path / "odd.csv").write_text(text)
    assert main(["captures", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    for word in ("odd.csv", *named):
        assert word in error
