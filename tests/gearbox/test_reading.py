"""Files that people name: regular files only, bounded, quickly refused."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.studies.settings import load_study_settings
from meshpoint.bus.command_keys import load_keys
from meshpoint.bus.logs.reader import read_log
from meshpoint.bus.options import add_bus_arguments, bus_config
from meshpoint.campaigns.baseline import read_outcomes
from meshpoint.campaigns.columns import ShiftColumns
from meshpoint.campaigns.stored import read_shifts
from meshpoint.controller.run.kept import read_file
from meshpoint.controller.settings.header import header_name, load_header
from meshpoint.controller.settings.settings import load_settings
from meshpoint.controller.settings.strategy_file import read_source
from meshpoint.gearbox.sheet import load_sheet
from meshpoint.gearbox.tables import TABLE_LIMIT_BYTES, TableError, load_toml
from meshpoint.logs.capture_files import read_columns
from meshpoint.logs.logged_frames import expected_frames
from meshpoint.replays.compare_command import load_record
from meshpoint.rig_sim.truck.as_built import load_as_built
from meshpoint.rig_sim.truck.scenario import load_scenario

AT_ONCE_S = 5.0
"""On a busy machine; they hung, or took 15 s."""


def configured_bus(path: Path) -> None:
    """A command with `--config FILE`."""
    parser = argparse.ArgumentParser()
    add_bus_arguments(parser)
    bus_config(parser.parse_args(["--config", f"{path}/default"]))


def reported_of(path: Path) -> None:
    """What `replay` and `identify` do first: about how many frames there are."""
    assert expected_frames([path]) is None
    list(read_log(path))


READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "settings": ("a.toml", load_settings),
    "data sheet": ("a.toml", load_sheet),
    "calibration": ("a.toml", lambda path: read_file(path, None)),
    "as built": ("a.toml", load_as_built),
    "as built of a run": ("a.json", load_as_built),
    "scenario": ("a.toml", load_scenario),
    "study settings": ("a.toml", load_study_settings),
    "capture": ("a.csv", read_columns),
    "run header": (header_name(7), lambda path: load_header(path.parent, 7)),
    "strategy": ("a.py", lambda path: read_source(f"{path}:Own")),
    "keys": ("a.toml", load_keys),
    "python-can configuration": ("a.conf", configured_bus),
    "JSON record": ("a.json", load_record),
    "part of a campaign": ("a.parquet", lambda path: read_shifts(path, ShiftColumns())),
    "table of a campaign": ("a.parquet", lambda path: read_outcomes([path], "target_phase")),
    "log whose length is reported": ("a.log", reported_of),
    "candump log": ("a.log", lambda path: list(read_log(path))),
    "BLF log": ("a.blf", lambda path: list(read_log(path))),
    "ASC log": ("a.asc", lambda path: list(read_log(path))),
    "packed log": ("a.log.gz", lambda path: list(read_log(path))),
}

readers = pytest.mark.parametrize("reader", READERS)


def refused_at_once(reader: str, path: Path) -> str:
    """What is said of the file; the process ends by a signal where it hangs."""
    begin_s = time.monotonic()
    with pytest.raises(Exception, match=path.name) as caught:
        READERS[reader][1](path)
    assert type(caught.value).__name__.endswith("Error")
    assert type(caught.value).__module__.startswith("meshpoint.")
    assert time.monotonic() - begin_s < AT_ONCE_S
    return str(caught.value)


@pytest.mark.timeout(30)
@readers
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
def test_a_pipe_is_not_waited_for(reader: str, tmp_path: Path) -> None:
    path = tmp_path / READERS[reader][0]
    os.mkfifo(path)
    assert "is a pipe" in refused_at_once(reader, path)
    assert "allowed is a regular file" in refused_at_once(reader, path)


@pytest.mark.timeout(30)
@readers
@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no such device here")
def test_a_device_is_not_read(reader: str, tmp_path: Path) -> None:
    path = tmp_path / READERS[reader][0]
    path.symlink_to("/dev/zero")
    assert "is a device" in refused_at_once(reader, path)
    assert "allowed is a regular file" in refused_at_once(reader, path)


@readers
def test_a_folder_is_no_file(reader: str, tmp_path: Path) -> None:
    path = tmp_path / READERS[reader][0]
    path.mkdir()
    assert "is a directory" in refused_at_once(reader, path)


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    "content",
    [
        ".".join(["a"] * 50_000) + " = 1",
        " . ".join(["a"] * 50_000) + " = 1",
        '."b".'.join(["'a'"] * 20_000) + " = 1",
        "[" + ".".join(["a"] * 50_000) + "]",
        "x = {" + ".".join(["a"] * 50_000) + " = 1}",
        "\n".join(f"a{n}.b.c = 1" for n in range(18_000)),
        "\n".join(f"[[a.b{n}]]" for n in range(20_000)),
        "a" * 250_000 + " = 1",
        '"' * 250_000,
        "a " * 120_000,
        "x = " + "[" * 100_000,
    ],
    ids=[
        "dots", "spaced", "quoted", "header", "inline", "keys", "tables", "word", "quotes", "words",
        "nested",
    ],
)  # fmt: skip
def test_toml_made_to_take_long_takes_no_time(content: str, tmp_path: Path) -> None:
    path = tmp_path / "slow.toml"
    path.write_text(content)
    begin_s = time.process_time()  # however long the machine does something else
    with pytest.raises(TableError, match=r"slow\.toml"):
        load_settings(path)
    assert time.process_time() - begin_s < AT_ONCE_S


def test_a_dotted_key_of_usual_length_and_a_text_with_dots_are_read(tmp_path: Path) -> None:
    path = tmp_path / "usual.toml"
    path.write_text('a.b.c = 1\nnumbers = [0.1, 0.2, 0.3]\nx = "a ... of 1.2.3.4"\n# ...........\n')
    assert load_toml(path)["a"] == {"b": {"c": 1}}


def test_a_file_that_is_too_large_is_reported_with_its_size(tmp_path: Path) -> None:
    path = tmp_path / "large.toml"
    path.write_bytes(b"#" * (TABLE_LIMIT_BYTES + 1))
    with pytest.raises(TableError, match=f"{TABLE_LIMIT_BYTES + 1} bytes, allowed are"):
        load_toml(path)
