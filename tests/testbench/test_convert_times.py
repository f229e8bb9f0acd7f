"""`convert`: values and times as other people's readers find them in the files.

The log is made here, so that it is known when each sample was taken: the sensors are read every
10 ms, their first reads wait as they do where a log begins before its nodes run freely, and every
frame comes later than it was read.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import asammdf
import mcap.reader
import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from meshpoint.bus.logs.recorder import LogWriter
from meshpoint.cli.main import main
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import (
    EdgesInputRise,
    GearboxSensors,
    ReferenceEncoder,
    ShiftPrediction,
    SleevesMain,
)
from meshpoint.dbc.node import Node
from meshpoint.dbc.truck import TRUCK_SCHEMA

START_US = (1 << 32) - 700_000
"""The sensors' clock at the first read; it wraps 0.7 s later."""
BEGUN_S = 1.7e9
READS = 200
LATE_S = 0.370
"""So late the first reads come, all at once."""
WAY_S = 0.002
"""No frame takes less from its read to the log."""
STEP_AT = 120
"""The read at whose third newest sample the layshaft begins to turn faster."""
WHOLE = 10_007
"""Samples until a sleeve is in the same place again."""
SLOW_RAD_S, FAST_RAD_S = 100.0, 150.0
Rows = list[tuple[float, dict[str, Any]]]


def read_s(number: int) -> float:
    """When a read was made, by the log's clock."""
    return BEGUN_S + 0.010 * number


def sample_s(number: int) -> float:
    """Where its samples stand in a file: the least way of a frame cannot be seen."""
    return read_s(number) + WAY_S


def speeds_rad_s(number: int) -> tuple[float, ...]:
    """Five of an encoder, newest first, 2 ms apart."""
    return tuple(FAST_RAD_S if 5 * number - k >= 5 * STEP_AT - 2 else SLOW_RAD_S for k in range(5))


def truck_frames() -> list[Frame]:
    """One of each message of the truck's other nodes, with nothing to say."""
    return [
        Frame(spec.can_id, bytes(b"\xff" * spec.length), spec.is_fd)
        for spec in TRUCK_SCHEMA.messages
    ]


def entries() -> Iterator[tuple[float, Frame]]:
    """The log: sensors, encoder, a controller that knows the sensors' clock from read 50 on."""
    io, encoder = Transmitter(Node.GEARBOX_IO), Transmitter(Node.REFERENCE)
    controller = Transmitter(Node.TRANSMISSION_CONTROL)
    yield read_s(0) + LATE_S - 0.004, a_prediction(controller, 0)
    for number in range(READS):
        at_us = (START_US + 10_000 * number) % (1 << 32)
        come_s = max(read_s(number) + WAY_S + 0.0001 * (number % 7), read_s(0) + LATE_S)
        frames = [
            io.encode(an_edge_read(at_us)),
            io.encode(a_sensor_read(at_us, supply_pa=8.0e5 + 100.0 * number)),
            encoder.encode(an_encoder_read(at_us, speeds_rad_s(number))),
        ]
        for k, frame in enumerate(frames):
            yield come_s + 0.0004 * k, frame
        stamp = at_us + 1_000 if number >= 50 else 0
        yield come_s + 0.004, a_prediction(controller, stamp)
        yield from ((come_s + 0.005, frame) for frame in truck_frames())
        if number == STEP_AT:
            yield come_s + 0.006, Frame(0x123, b"\x01\x02", is_fd=False, is_extended=False)
            sensors = io.encode(a_sensor_read(at_us, 8.0e5))
            yield come_s + 0.006, sensors._replace(data=bytes(16))


def an_edge_read(at_us: int) -> EdgesInputRise:
    return EdgesInputRise(
        read_time_us=at_us, newest_index=0, valid_stamps=0, long_interval=False,
        timestamp_low_us=(0,) * 27,
    )  # fmt: skip


def a_sensor_read(at_us: int, supply_pa: float) -> GearboxSensors:
    return GearboxSensors(sample_time_us=at_us, supply_pressure_pa=supply_pa)


def an_encoder_read(at_us: int, speeds: tuple[float, ...]) -> ReferenceEncoder:
    return ReferenceEncoder(sample_time_us=at_us, angle_rad=(0.0,) * 5, speed_rad_s=speeds)


def a_prediction(controller: Transmitter, at_us: int) -> Frame:
    return controller.encode(ShiftPrediction(decision_time_us=at_us))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("times") / "x.log"
    with LogWriter(path, flush_every_s=None) as writer:
        for time_s, frame in entries():
            writer.write(time_s, frame)
    return path


@pytest.fixture(scope="module")
def files(log: Path) -> dict[str, Path]:
    made = {ending: log.with_suffix(f".{ending}") for ending in ("mcap", "mf4", "parquet")}
    for path in made.values():
        assert main(["convert", str(log), "-o", str(path)]) == 0
    return made


def read(path: Path, topic: str, name: str) -> Rows:
    """A topic's rows by a reader that is not ours: its time by the log's clock, and a value."""
    found: list[tuple[float, Any]]
    if path.suffix == ".mcap":
        with path.open("rb") as file:
            messages = mcap.reader.make_reader(file).iter_messages(topics=[f"/{topic}"])
            found = [(each.log_time * 1e-9, json.loads(each.data)[name]) for _, _, each in messages]
    elif path.suffix == ".mf4":
        with asammdf.MDF(path) as mdf:
            signal, begun_s = mdf.get(f"{topic}.{name}", raw=True), mdf.start_time.timestamp()
            found = list(zip(begun_s + signal.timestamps, signal.samples.tolist(), strict=True))
    else:
        table = pq.read_table(path)
        table = table.filter(pc.equal(table["topic"].cast("string"), topic))
        found = list(
            zip(table["time_s"].to_pylist(), table[f"{topic}.{name}"].to_pylist(), strict=True)
        )
    return found


ENDINGS = pytest.mark.parametrize("ending", ["mcap", "mf4", "parquet"])


@ENDINGS
def test_a_sample_stands_where_it_was_taken_however_late_its_frame(
    files: dict[str, Path], ending: str
) -> None:
    """Not by the first frame, which has waited, and not by a stamp of 0 of a controller that has
    heard no sensor yet. Each read is known by its pressure."""
    rows = read(files[ending], "GearboxSensors", "supply_pressure_pa")
    assert len(rows) > READS - 40
    for at_s, supply_pa in rows:
        number = round((supply_pa - 8.0e5) / 100.0)
        assert at_s == pytest.approx(sample_s(number), abs=2e-6)


@ENDINGS
def test_an_encoders_step_stands_at_the_sample_that_shows_it(
    files: dict[str, Path], ending: str
) -> None:
    rows = read(files[ending], "ReferenceEncoder", "speed_rad_s")
    before = [at_s for at_s, speed in rows if speed < 125.0]
    after = [at_s for at_s, speed in rows if speed > 125.0]
    assert max(before) == pytest.approx(sample_s(STEP_AT) - 0.006, abs=2e-6)
    assert min(after) == pytest.approx(sample_s(STEP_AT) - 0.004, abs=2e-6)
    assert np.diff([at_s for at_s, _ in rows]) == pytest.approx(0.002, abs=2e-6)


@ENDINGS
def test_a_decision_stands_on_the_same_axis_and_before_its_frame(
    files: dict[str, Path], ending: str
) -> None:
    """Where the controller knows no sensor clock yet, it stands where its frame came."""
    times = [at_s for at_s, _ in read(files[ending], "ShiftPrediction", "decision")]
    assert len(times) == READS + 1
    late_s = [at_s - sample_s(READS - 150 + k) for k, at_s in enumerate(times[-150:])]
    assert late_s == pytest.approx([0.001] * 150, abs=2e-6)
    assert times[0] == pytest.approx(read_s(0) + LATE_S - 0.004, abs=2e-6)


@ENDINGS
def test_the_trucks_other_messages_are_in_the_file(files: dict[str, Path], ending: str) -> None:
    names = {
        "CCVS1": "wheel_based_speed_m_s", "EBC1": "abs_active", "EBC2": "front_axle_speed_m_s",
        "HRW": "front_left_speed_m_s", "TCO1": "output_shaft_speed_rad_s",
        "VDC2": "longitudinal_acceleration_m_s2",
    }  # fmt: skip
    for topic, name in names.items():
        assert len(read(files[ending], topic, name)) == READS, topic


def test_what_is_not_in_the_file_is_said(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["convert", str(log), "-o", str(tmp_path / "x.parquet")]) == 0
    said = capsys.readouterr().err
    assert "1 frame of 1 identifier that no message here has is left out: 0x123 (1)" in said
    assert "1 frame of a wrong length, CRC or value is left out: GearboxSensors (1)" in said
    assert "samples taken before the first frame came are left out" in said
    assert "51 frames with a time of another clock than the sensors are put where" in said


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """More rows than a file takes at once; the sleeves differ, and each sample from each other."""
    path, io = tmp_path_factory.mktemp("many") / "many.log", Transmitter(Node.GEARBOX_IO)
    with LogWriter(path, flush_every_s=None) as writer:
        for number in range(5_020):
            newest = 10 * number + 9
            read = SleevesMain(
                sample_time_us=10_000 * number + 9_000,
                sensor_fault=0,
                sleeve_first_second_m=tuple(1e-6 * ((newest - k) % WHOLE) for k in range(10)),
                sleeve_crawl_third_m=tuple(-1e-6 * ((newest - k) % WHOLE) for k in range(10)),
            )
            writer.write(0.010 * number + 0.020, io.encode(read))
    return path


@pytest.mark.parametrize("ending", ["mf4", "parquet"])
def test_beyond_fifty_thousand_rows_each_column_goes_on_as_itself(many: Path, ending: str) -> None:
    path = many.with_suffix(f".{ending}")
    assert main(["convert", str(many), "-o", str(path)]) == 0
    for name, sign in (("sleeve_first_second_m", 1.0), ("sleeve_crawl_third_m", -1.0)):
        rows = read(path, "SleevesMain", name)
        assert len(rows) > 50_100
        times, values = np.array(rows).T
        number = np.round((times - times[0]) / 0.001)
        first = round(abs(values[0]) / 1e-6)
        np.testing.assert_allclose(values, sign * 1e-6 * ((number + first) % WHOLE), atol=1e-9)
        np.testing.assert_allclose(times, times[0] + 0.001 * number, atol=1e-6)
