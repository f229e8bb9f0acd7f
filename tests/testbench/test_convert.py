"""`convert`: what a viewer reads of a log is what its frames say, when it was so."""

from __future__ import annotations

import json
import re
import sys
from collections import defaultdict
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import asammdf
import mcap.reader
import numpy as np
import pyarrow.parquet as pq
import pytest

from meshpoint.bridges.sample_clock import LiveTies
from meshpoint.bridges.series import TOPICS, TimeSeries
from meshpoint.bus.logs.files import read_logs
from meshpoint.cli.main import main
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Transmitter, read_alone
from meshpoint.dbc.messages import (
    ControllerEstimates,
    EdgesLayshaftRise,
    ReferencePhase,
    SleevesMain,
)
from meshpoint.dbc.node import Node

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "viewers"
MS = 1_000
Rows = dict[str, list[tuple[int, dict[str, Any]]]]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three shifts in virtual time; the third aims."""
    path = tmp_path_factory.mktemp("convert") / "x.log"
    assert main(["simulate", "--seed", "4", "--shifts", "3", "--log", str(path)]) == 0
    return path


def converted(log: Path, ending: str) -> Path:
    path = log.with_suffix(ending)
    if not path.exists():
        assert main(["convert", str(log), "-o", str(path)]) == 0
    return path


def rows_of(path: Path) -> Rows:
    """An MCAP's rows by topic, in the file's order: ns and values."""
    found: Rows = defaultdict(list)
    with path.open("rb") as file:
        for schema, channel, message in mcap.reader.make_reader(file).iter_messages():
            values = json.loads(message.data) if schema.encoding == "jsonschema" else {}
            found[channel.topic].append((message.log_time, values))
    return found


@pytest.fixture(scope="module")
def rows(log: Path) -> Rows:
    return rows_of(converted(log, ".mcap"))


def frames(log: Path, kind: type) -> list[Any]:
    codec = next(each for each in CODECS.values() if each.message_type is kind)
    read = (read_alone(codec, frame) for _, frame in read_logs([log]))
    return [message for message in read if message is not None]


def test_a_sleeves_samples_are_all_there_a_millisecond_apart(log: Path, rows: Rows) -> None:
    sent = [x for each in frames(log, SleevesMain) for x in reversed(each.sleeve_first_second_m)]
    found = rows["/SleevesMain"]
    assert len(sent) - 10 <= len(found) <= len(sent)  # the first may be from before the log
    assert [values["sleeve_first_second_m"] for _, values in found] == sent[-len(found) :]
    assert {round((b - a) / MS) for (a, _), (b, _) in pairwise(found)} == {MS}


def test_each_tooth_edge_is_a_row_at_its_own_time(log: Path, rows: Rows) -> None:
    """As a reader of the wire contract chains them: 16 bits back from the read."""
    times: dict[int, int] = {}
    for each in frames(log, EdgesLayshaftRise):
        at_us = each.read_time_us
        for k in range(each.valid_stamps):
            at_us -= (at_us - each.timestamp_low_us[k]) & 0xFFFF
            times.setdefault((each.newest_index - k) & 0xFFFF, at_us)
    found = {values["newest_index"]: at for at, values in rows["/EdgesLayshaftRise"]}
    assert set(found) <= set(times)
    assert len(found) >= len(times) - 30  # those from before the log
    first = min(found)
    for index, at_ns in found.items():
        apart_us = (times[index] - times[first] + 2**31) % 2**32 - 2**31
        assert (at_ns - found[first]) / MS == pytest.approx(apart_us, abs=0.6)


def test_what_was_estimated_stands_beside_what_was_true_at_that_instant(
    log: Path, rows: Rows
) -> None:
    truths = {each.main_speed_rad_s for each in frames(log, ReferencePhase)}
    compared = [values for _, values in rows["/Compared"]]
    assert len(compared) > 300
    assert {each["main_speed_true_rad_s"] for each in compared} <= truths
    aimed = [each for each in compared if each["phase_rad"] is not None]
    off = [each["phase_rad"] - each["phase_true_rad"] for each in aimed]
    assert len(off) > 30
    assert np.median(np.abs(off)) < 0.01


def test_rows_stand_in_the_order_of_their_times(log: Path, rows: Rows) -> None:
    for topic, found in rows.items():
        times = [at for at, _ in found]
        assert times == sorted(times), topic
    times = pq.read_table(converted(log, ".parquet")).column("time_s").to_pylist()
    assert times == sorted(times)


def test_an_instant_is_compared_once(rows: Rows) -> None:
    """A controller estimates twice where it steps as soon as a read begins; the last counts."""
    times = [at for at, _ in rows["/Compared"]]
    assert len(set(times)) == len(times)


def test_the_last_instant_is_compared_too(log: Path, rows: Rows) -> None:
    last = frames(log, ControllerEstimates)[-1]
    assert rows["/Compared"][-1][1]["main_speed_rad_s"] == last.main_speed_rad_s


def test_edges_from_before_a_standstill_are_not_placed() -> None:
    """An interval beyond 65 ms has no room in 16 bits: only the newest edge is known then."""
    node, series = Transmitter(Node.GEARBOX_IO), TimeSeries(LiveTies())
    found = []
    for k, is_long in enumerate((False, True)):
        lows = tuple((10_000 * k + 9_000 - 1_000 * j) & 0xFFFF for j in range(27))
        edges = EdgesLayshaftRise(
            read_time_us=10_000 * (k + 1), newest_index=100 + 5 * k, valid_stamps=5,
            long_interval=is_long, timestamp_low_us=lows,
        )  # fmt: skip
        found.append(
            [each.values["newest_index"] for each in series.take(0.01 * k, node.encode(edges))]
        )
    assert found == [[96, 97, 98, 99, 100], [105]]


def test_an_mdf_of_a_log_with_a_date_begins_at_it(log: Path, tmp_path: Path) -> None:
    dated, target = tmp_path / "dated.log", tmp_path / "x.mf4"
    first_s = 1.7e9
    lines = [re.sub(r"^\(([\d.]+)\)", lambda m: f"({float(m[1]) + first_s:.6f})", line)
             for line in log.read_text().splitlines(keepends=True)[:3000]]  # fmt: skip
    dated.write_text("".join(lines))
    assert main(["convert", str(dated), "-o", str(target)]) == 0
    mdf = asammdf.MDF(target)
    assert mdf.header.start_time.timestamp() == pytest.approx(first_s, abs=0.1)
    assert 0.0 <= mdf.get("EEC1.engine_speed_rad_s").timestamps[0] < 0.1


@pytest.mark.parametrize("ending", [".mcap", ".mf4", ".parquet"])
def test_a_log_gives_the_same_bytes_whenever_it_is_converted(
    log: Path, tmp_path: Path, ending: str
) -> None:
    again = tmp_path / f"again{ending}"
    assert main(["convert", str(log), "-o", str(again)]) == 0
    first = converted(log, ending)
    files = [each for each in sorted(first.rglob("*")) if each.is_file()] or [first]
    for file in files:
        other = again / file.relative_to(first) if file != first else again
        assert other.read_bytes() == file.read_bytes(), file.name


def test_what_happened_is_told_in_words(log: Path, rows: Rows) -> None:
    assert len(rows["/events"]) > 20
    events = asammdf.MDF(converted(log, ".mf4")).get("Events").samples.tolist()
    words = [each.decode() for each in events]
    assert sum(each.startswith("driver: asks for gear") for each in words) == 3
    assert sum("tooth meets" in each for each in words) >= 3


def test_the_three_files_hold_the_same_numbers(log: Path, rows: Rows) -> None:
    mdf = asammdf.MDF(converted(log, ".mf4"))
    table = pq.read_table(converted(log, ".parquet"))
    for topic, name in (
        ("SleevesMain", "sleeve_crawl_third_m"),
        ("GearboxSensors", "brake_pressure_pa"),
        ("EEC1", "engine_speed_rad_s"),
        ("ControllerStatus", "state"),
        ("Compared", "phase_rad"),
    ):
        column = f"{topic}.{name}"
        by_mcap = np.array([values[name] for _, values in rows[f"/{topic}"]], dtype=float)
        signal = mdf.get(column, raw=True)
        at = table.column("topic").to_numpy(zero_copy_only=False) == topic
        by_table = table.column(column).to_numpy(zero_copy_only=False)[at]
        np.testing.assert_array_equal(signal.samples, by_mcap)
        np.testing.assert_array_equal(by_table, by_mcap)
        np.testing.assert_allclose(signal.timestamps, table.column("time_s").to_numpy()[at])
    assert mdf.get("GearboxSensors.brake_pressure_pa").unit == "Pa"
    assert b"InGear" in mdf.get("ControllerStatus.state").samples


def test_a_defect_ends_the_file_with_what_stands_before_it(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken, target = tmp_path / "broken.log", tmp_path / "x.parquet"
    lines = log.read_text().splitlines(keepends=True)
    broken.write_text("".join(lines[:2000]) + "(1.0 can0 nonsense\n")
    assert main(["convert", str(broken), "-o", str(target)]) == 2
    assert "line 2001" in capsys.readouterr().err
    assert pq.read_table(target).num_rows > 2000


def test_a_log_is_not_written_over_by_its_own_series(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "x.mcap"
    target.hardlink_to(log)
    before = log.read_bytes()
    assert main(["convert", str(log), "-o", str(target)]) == 2
    assert "LOG and --output name one file" in capsys.readouterr().err
    assert log.read_bytes() == before


@pytest.mark.parametrize(
    ("target", "said"),
    [("nowhere/x.parquet", "there is no folder nowhere; make it first"), (".", "is a folder")],
)
def test_where_nothing_can_be_written_is_said_before_the_log_is_read(
    target: str, said: str, tmp_path: Path, monkeypatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("x.log").write_text("nonsense\n")  # of which nothing is said
    assert main(["convert", "x.log", "-o", target]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
    assert [path.name for path in tmp_path.iterdir()] == ["x.log"]


def test_a_log_of_another_bus_leaves_no_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    foreign = tmp_path / "foreign.log"
    foreign.write_text("".join(f"({k * 0.01:.6f}) can0 123#0011223344556677\n" for k in range(50)))
    assert main(["convert", str(foreign), "-o", str(tmp_path / "x.parquet")]) == 2
    assert "of 50 frames none is a message of fd (--profile)" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["foreign.log"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["{log}", "-o", "x.csv"],
            r"x\.csv: ends in '\.csv', allowed are \.mcap, \.mf4, \.parquet",
        ),
        (["{log}", "-o", "none/x.mcap"], "none/x.mcap: there is no folder none; make it first"),
        (["-o", "x.mcap"], "-o without LOG"),
        (["missing.log", "-o", "x.mcap"], "missing.log"),
        (["{log}", "--live"], "--live with LOG"),
        (
            ["--live", "8765", "--origin", "https://a.example/"],
            "--origin https://a.example/: allow",
        ),
        (["{log}", "-o", "x.mcap", "--origin", "https://a.example"], "--origin without --live"),
    ],
)
def test_bad_input_is_named_and_leaves_no_file(
    arguments: list[str],
    said: str,
    log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["convert", *(each.format(log=log) for each in arguments)]) == 2
    assert re.search(said, capsys.readouterr().err)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("ending", "module"), [("mcap", "foxglove"), ("mf4", "asammdf")])
def test_an_extra_that_is_not_installed_is_named(
    ending: str,
    module: str,
    log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    assert main(["convert", str(log), "-o", str(tmp_path / f"x.{ending}")]) == 2
    assert f"pip install 'meshpoint[{ending}]'" in capsys.readouterr().err


def test_the_layouts_show_what_a_file_has(rows: Rows) -> None:
    """The phase with its gap, the sleeves, the valves, what happened."""
    layout = json.loads((EXAMPLES / "shift.foxglove.json").read_text())
    paths = [
        path["value"] for panel in layout["configById"].values() for path in panel.get("paths", [])
    ]
    curves = ET.parse(EXAMPLES / "shift.plotjuggler.xml").iter("curve")
    shown = {path for path in paths if path.startswith("/")}
    assert {
        curve.attrib["name"].replace("/", ".").replace(".", "/", 1) for curve in curves
    } == shown
    for path in shown:
        topic, _, name = path[1:].partition(".")
        assert name in {signal.name for signal in TOPICS[topic].signals}
        assert any(values[name] is not None for _, values in rows[f"/{topic}"])
    assert layout["configById"]["RosOut!events"]["topicToRender"] in rows
