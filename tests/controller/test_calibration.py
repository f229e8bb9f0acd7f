"""What a controller has learned, on its way to a file and back; and files that are none."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import pytest
from calibration_example import SHEET, TEXT, example
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.run.kept import MOST_KEPT, CalibrationWriter, load, read_file, save
from meshpoint.controller.settings.header import new_header
from meshpoint.controller.settings.learned import (
    BrakeRecord,
    Calibration,
    CalibrationError,
    End,
    Provenance,
    ReferenceRecords,
    SleeveRecord,
    SleeveRecords,
    WheelRecord,
    WheelRecords,
    read_calibration,
)
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox.tables import TABLE_LIMIT_BYTES
from meshpoint.results.tooth_parts import take_apart
from meshpoint.units import DEG

ERROR = st.floats(-1.0 * DEG, 1.0 * DEG)
SLEEVE = st.builds(
    SleeveRecord,
    delay_s=st.floats(0.03, 0.08),
    samples=st.floats(0.5, 60.0),
    scatter_s=st.floats(1e-4, 5e-3),
    scatter_samples=st.floats(0.5, 60.0),
)
FACTORS = st.tuples(*[st.floats(0.3, 4.0)] * 4)
SDS = st.tuples(*[st.floats(0.0, 1.0)] * 4)
BRAKE = st.builds(
    BrakeRecord,
    shifts=st.integers(1, 1000),
    gain=st.floats(0.5, 2.0),
    gain_sd=st.floats(0.0, 0.2),
    drag_nm=st.floats(-50.0, 50.0),
    drag_sd_nm=st.floats(0.0, 10.0),
    touch_pa=st.floats(0.0, 1e5),
    touch_sd_pa=st.floats(0.0, 1e5),
    sensor_lag_s=st.floats(0.0, 0.02),
    sensor_lag_sd_s=st.floats(0.0, 0.01),
    emptying=FACTORS,
    emptying_sd=SDS,
    filling=FACTORS,
    filling_sd=SDS,
    off_delay_s=st.floats(0.0, 0.1),
    off_delay_sd_s=st.floats(0.0, 0.01),
    on_delay_s=st.floats(0.0, 0.1),
    on_delay_sd_s=st.floats(0.0, 0.01),
)


def wheel(teeth: int) -> st.SearchStrategy[WheelRecord]:
    few = st.lists(ERROR, min_size=6, max_size=6)
    errors = few.map(lambda errors: tuple(errors * teeth)[: 2 * teeth])
    sd_rad, edges = st.floats(1e-5, 1e-2), st.integers(0, 10**9)
    return st.builds(WheelRecord, st.just(teeth), edges, sd_rad, errors)


OFFSET = st.one_of(st.none(), st.floats(-0.1, 0.1))
SHAPES = SHEET.wheels
CALIBRATIONS = st.builds(
    Calibration,
    format_=st.just(1),
    provenance=st.builds(
        Provenance,
        st.text(max_size=20),
        st.just(SHEET.name),
        st.just(SHEET.sha256),
        st.text(max_size=40),
        st.integers(0, 10**6),
    ),
    wheels=st.builds(WheelRecords, wheel(SHAPES.layshaft.teeth), wheel(SHAPES.main.teeth)),
    references=st.builds(ReferenceRecords, OFFSET, OFFSET, OFFSET, OFFSET),
    brake=st.one_of(st.none(), BRAKE),
    sleeves=st.builds(SleeveRecords, *[st.one_of(st.none(), SLEEVE)] * 4),
    end=st.just(End(True)),
)


@pytest.mark.check
@settings(max_examples=40, deadline=None)
@given(CALIBRATIONS)
def test_a_file_read_and_written_again_is_the_same_file(calibration: Calibration) -> None:
    """And what was read is within nine digits of what was learned."""
    written = calibration.to_text()
    read = read_calibration(written, "x.toml", SHEET)
    assert read.to_text() == written
    assert read_calibration(read.to_text(), "x.toml", SHEET) == read
    assert read.provenance == calibration.provenance
    for mine, theirs in ((read.wheels, calibration.wheels), (read.sleeves, calibration.sleeves)):
        assert repr(mine).count("None") == repr(theirs).count("None")
    learned, found = calibration.wheels.main, read.wheels.main
    assert learned is not None
    assert found is not None
    assert found.error_rad == pytest.approx(learned.error_rad, rel=5.1e-9, abs=1e-300)


@given(st.integers(0, len(TEXT) - len("\n") - 1))
def test_a_file_that_was_cut_off_anywhere_is_refused(length: int) -> None:
    with pytest.raises(CalibrationError, match=r"x\.toml"):
        read_calibration(TEXT[:length], "x.toml", SHEET)


def changed(before: str, after: str) -> Callable[[str], str]:
    def change(text: str) -> str:
        assert before in text, before
        return text.replace(before, after, 1)

    return change


BAD: dict[str, tuple[Callable[[str], str], tuple[str, ...]]] = {
    "another sheet": (
        changed(SHEET.sha256, "ab" * 32), ("provenance", "sheet_sha256", "abab", SHEET.sha256[:16])
    ),
    "another wheel": (changed("teeth = 45", "teeth = 60"), ("layshaft", "90", "120")),
    "a tooth too few": (changed("[\n    0.0, ", "[\n    "), ("layshaft", "error_deg", "89", "90")),
    "nan": (changed("[\n    0.0,", "[\n    nan,"), ("layshaft", "error_deg[0]", "nan", "5")),
    "inf": (changed("gain = 0.96", "gain = inf"), ("brake", "gain", "inf", "0.2 to 5")),
    "absurd gain": (changed("gain = 0.96", "gain = 96.0"), ("brake", "gain", "96", "0.2 to 5")),
    "absurd tooth": (changed("[\n    0.0,", "[\n    2.5,"), ("error_deg[0]", "2.5", "2 at most")),
    "absurd delay": (changed("delay_ms = 45.0", "delay_ms = 3.0"), ("second", "delay_ms", "12")),
    "a huge whole number": (changed("gain = 0.96", "gain = " + "9" * 400), ("brake", "gain")),
    "a number too long": (changed("gain = 0.96", "gain = " + "9" * 5000), ("torn",)),
    "doubt beyond the gain": (
        changed("gain_sd = 0.01", "gain_sd = 1.1"), ("gain_sd", "1.1", "0 to 1")
    ),
    "more than damped": (
        changed("damping = 0.05", "damping = 1.1"),
        ("damping", "1.1", "0.0001 to 1"),
    ),
    "a text": (changed("gain = 0.96", 'gain = "much"'), ("brake", "gain", "much")),
    "unknown key": (changed("gain = 0.96", "gian = 0.96"), ("brake", "gian", "gain")),
    "missing key": (changed("gain = 0.96\n", ""), ("brake", "gain", "missing")),
    "too few rates": (
        changed("filling = [\n    1.1, ", "filling = [\n    "), ("brake", "filling", "3", "4")
    ),
    "another format": (changed("format = 1", "format = 2"), ("format", "2")),
    "a table in a list": (changed("[wheels]", "[[wheels]]"), ("wheels", "table")),
    "references alone": (
        lambda text: text[: text.index("[wheels]")] + text[text.index("[references]") :],
        ("references", "teeth"),
    ),
    "deep": (lambda text: text + "x = " + "[" * 3000, ("torn",)),
    "not complete": (changed("complete = true", "complete = false"), ("complete", "true")),
    "empty": (lambda text: "", ("format", "missing")),
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_file_is_refused_by_name_kept_aside_and_the_start_is_cold(
    kind: str, tmp_path: Path
) -> None:
    change, named = BAD[kind]
    path, content = tmp_path / "box.toml", change(TEXT)
    path.write_text(content, encoding="utf-8")
    loaded = load(path, SHEET)
    assert loaded.calibration is None
    assert loaded.writable
    for word in ("refused", "box.toml", "cold start", *named):
        assert word in loaded.line
    assert not path.exists()
    assert (tmp_path / "box.toml.refused").read_text(encoding="utf-8") == content


@pytest.mark.parametrize(
    "content", [bytes(range(256)), b"#" * (TABLE_LIMIT_BYTES + 1), TEXT.encode("utf-16")],
    ids=["binary", "too large", "utf-16"],
)  # fmt: skip
def test_a_file_that_is_no_text_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "box.toml"
    path.write_bytes(content)
    loaded = load(path, SHEET)
    assert loaded.calibration is None
    assert "refused" in loaded.line
    assert (tmp_path / "box.toml.refused").read_bytes() == content


def test_refused_files_never_overwrite_each_other(tmp_path: Path) -> None:
    """And when nobody has looked for a hundred of them, nothing is renamed nor written any more."""
    path = tmp_path / "box.toml"
    for number in range(MOST_KEPT):
        path.write_text(f"bad {number}")
        assert load(path, SHEET).writable
    assert len({kept.read_text() for kept in tmp_path.iterdir()}) == MOST_KEPT
    path.write_text("the last one")
    loaded = load(path, SHEET)
    assert not loaded.writable
    assert "nothing will be written" in loaded.line
    assert path.read_text() == "the last one"


def test_no_file_is_a_cold_start_and_says_so(tmp_path: Path) -> None:
    loaded = load(tmp_path / "none.toml", SHEET)
    assert (loaded.calibration, loaded.writable) == (None, True)
    assert "cold start" in loaded.line


def test_a_file_is_replaced_as_a_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "box.toml"
    save(path, example())
    assert path.read_text(encoding="utf-8") == TEXT
    assert list(tmp_path.iterdir()) == [path]
    # A folder in the way of the new file: the old one stays as it was.
    (tmp_path / ".box.toml.new").mkdir()
    writer = CalibrationWriter(path, SHEET, threaded=False)
    line = writer(example())
    assert line is not None
    assert "box.toml: cannot be written" in line
    assert writer(example()) is None, "reported once"
    assert path.read_text(encoding="utf-8") == TEXT


def test_saving_does_not_write_to_where_a_planted_link_points(tmp_path: Path) -> None:
    target = tmp_path / "precious"
    target.write_text("kept", encoding="utf-8")
    (tmp_path / ".box.toml.new").symlink_to(target)
    path = tmp_path / "box.toml"
    save(path, example())
    assert target.read_text(encoding="utf-8") == "kept"
    assert path.read_text(encoding="utf-8") == TEXT
    assert not path.is_symlink()
    assert sorted(tmp_path.iterdir()) == [path, target]


@pytest.mark.parametrize("threaded", [False, True])
def test_what_the_next_start_would_refuse_is_not_written(tmp_path: Path, threaded: bool) -> None:
    path = tmp_path / "box.toml"
    save(path, example())
    writer = CalibrationWriter(path, SHEET, threaded)
    drifted = BrakeRecord(**(vars(example().brake) | {"gain": math.nan}))
    bad = Calibration(**(vars(example()) | {"brake": drifted}))
    line = writer(bad) or writer.close()
    assert line is not None
    assert "brake: gain" in line
    assert read_file(path, SHEET).to_text() == TEXT


@given(
    wider=st.floats(-1.0, 1.0), ripple=st.floats(0.01, 1.0), at=st.integers(0, 44),
    own=st.integers(0, 89),
)  # fmt: skip
def test_a_wheel_taken_apart_gives_what_it_was_made_of(
    wider: float, ripple: float, at: int, own: int
) -> None:
    turn = 2.0 * math.pi
    errors = [
        ripple * math.cos((k // 2 - at) * turn / 45) + (wider / 2 if k % 2 else -wider / 2)
        for k in range(90)
    ]
    parts = take_apart(errors)
    assert (parts.wider_rad, parts.eccentricity_rad) == pytest.approx((wider, ripple), abs=1e-12)
    assert parts.eccentric_tooth == at
    assert parts.pitch_worst_rad < 1e-12
    errors[own] += 0.1
    assert take_apart(errors).pitch_worst_rad == pytest.approx(0.1, rel=0.1)


def test_brake_scatter_and_swing_are_carried_over_a_restart() -> None:
    header = new_header("0.1.0", SHEET, ControllerSettings(), example())
    kept = ControllerCore(header).calibration("later")
    given = example()
    assert kept.brake is not None
    assert given.brake is not None
    assert set(vars(kept.brake)) == set(vars(given.brake))
    for name, figure in vars(given.brake).items():
        assert getattr(kept.brake, name) == pytest.approx(figure), name
    assert kept.noise is not None
    assert given.noise is not None
    assert vars(kept.noise) == pytest.approx(vars(given.noise))
    assert kept.swings.low is None
    assert kept.swings.high is not None
    assert given.swings.high is not None
    assert kept.swings.high.has_lash
    assert kept.swings.high.natural_rad_s == pytest.approx(given.swings.high.natural_rad_s)
