"""--calibration and `meshpoint show calibration`, as they are used."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from meshpoint.cli.main import main

SIMULATE = [
    "simulate",
    "--gearbox",
    "thesis",
    "--as-built",
    "clean",
    "--seed",
    "3",
    "--shifts",
    "2",
]


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What two shifts have taught."""
    path = tmp_path_factory.mktemp("calibration") / "box.toml"
    assert main([*SIMULATE, "--calibration", str(path), "--json", str(path.with_name("j"))]) == 0
    return path


def test_the_first_run_is_a_cold_start_and_the_same_file_gives_the_same_bytes(
    learned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rows, log and the file that comes of it; and a log that began warm can be verified."""
    cold = json.loads(learned.with_name("j").read_text())
    assert cold["cold_start"] is True
    assert cold["summary"]["reference_known"] == 0.0
    runs = []
    for name in "ab":
        folder = tmp_path / name
        folder.mkdir()
        path, log = folder / "box.toml", folder / "run.log"
        path.write_bytes(learned.read_bytes())
        assert main([*SIMULATE, "--calibration", str(path), "--json", "-", "--log", str(log)]) == 0
        out = capsys.readouterr()
        assert "learned over 2 shifts" in out.err
        runs.append((json.loads(out.out), path.read_bytes(), log.read_bytes()))
        assert sorted(file.suffix for file in folder.iterdir()) == [".json", ".log", ".toml"]
    assert runs[0] == runs[1]
    assert runs[0][0]["cold_start"] is False
    assert runs[0][1] != learned.read_bytes()
    assert main(["replay", str(tmp_path / "a" / "run.log"), "--verify"]) == 0


def test_a_refused_file_is_named_kept_and_the_run_goes_on_cold(
    learned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "box.toml"
    torn = learned.read_bytes()[:1000]
    path.write_bytes(torn)
    assert main([*SIMULATE, "--calibration", str(path), "--json", str(tmp_path / "j")]) == 0
    err = capsys.readouterr().err
    for word in ("calibration refused", "box.toml", "torn", "box.toml.refused", "cold start"):
        assert word in err
    assert (tmp_path / "box.toml.refused").read_bytes() == torn
    assert (tmp_path / "j").read_bytes() == learned.with_name("j").read_bytes()
    assert path.read_bytes() == learned.read_bytes()


def test_show_tells_people_and_programs_what_was_learned(
    learned: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["show", "calibration", str(learned)]) == 0
    shown = capsys.readouterr().out
    for words in ("over 2 shifts", "data sheet thesis", "layshaft", "second", "eccentricity"):
        assert words in shown
    assert main(["show", "calibration", str(learned), "--json", "-"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["provenance"]["shifts"] == 2
    assert len(values["wheels"]["main"]["error_rad"]) == 90
    assert 0.0 < values["tooth_parts"]["layshaft"]["eccentricity_rad"] < 0.002


def test_show_says_why_a_controller_would_refuse_it(
    learned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And leaves the file where it is."""
    bad = tmp_path / "bad.toml"
    bad.write_text(learned.read_text().replace("teeth = 45", "teeth = 46", 1))
    for arguments, words in (
        ([str(bad)], ("bad.toml", "layshaft", "error_deg holds 90", "92")),
        ([str(learned), "--gearbox", "truck12"], ("box.toml", "sheet_sha256", "truck12")),
        ([str(tmp_path / "none.toml")], ("none.toml", "cannot be read")),
    ):
        assert main(["show", "calibration", *arguments]) == 2
        err = capsys.readouterr().err
        for word in words:
            assert word in err
    assert bad.exists()


def test_a_folder_is_no_calibration_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*SIMULATE, "--calibration", str(tmp_path)]) == 2
    assert "is a folder" in capsys.readouterr().err
