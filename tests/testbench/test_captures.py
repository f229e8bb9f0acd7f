"""`meshpoint captures` on files made here: wheel, teeth, extra edges, refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from meshpoint.testbench.cli import main


def write_changes(path: Path, missing: tuple[int, ...], extra: bool = False) -> None:
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
    lines = [f"{t:.9f},{level}" for t, level in sorted(changes)]
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
