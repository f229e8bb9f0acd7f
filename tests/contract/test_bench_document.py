"""docs/bench.md: its commands can be typed as they stand, and set one bit timing."""

import re
from pathlib import Path

import can
import pytest

from meshpoint.bus.options import bus_config, classic_refusal
from meshpoint.testbench.table import COMMANDS, build_parser

DOCS = Path(__file__).parents[2] / "docs"
TEXT = (DOCS / "bench.md").read_text(encoding="utf-8")
FIRST_DAY = TEXT[TEXT.index("## First power-up") : TEXT.index("## What the guard")]
TYPED = [
    " ".join(found.split())
    for found in re.findall(
        r"`(meshpoint [^`]+)`|^    (meshpoint [^#\n]+)", FIRST_DAY, re.MULTILINE
    )
    for found in found
    if found
]
WITHOUT_BUS = ("show", "replay")


def test_the_first_day_has_commands() -> None:
    used = {command.split()[1] for command in TYPED}
    assert {"check", "commission", "controller", "request", "watch", "replay", "rig"} <= used


@pytest.mark.parametrize("command", TYPED)
def test_a_step_of_the_first_day_is_a_whole_command(command: str) -> None:
    typed = command.partition(" >")[0].replace("$BUS", "-i socketcan -c can0")
    _, name, *words = typed.split()
    assert name in COMMANDS
    build_parser(name).parse_args([name, *words])
    at_the_desk = name in ("rig", "up")
    assert at_the_desk or name in WITHOUT_BUS or "$BUS" in command


def test_every_set_up_of_a_bus_samples_at_one_point() -> None:
    lines = [line for line in TEXT.splitlines() if "dbitrate" in line and "ip link" in line]
    lines.append(classic_refusal("can0"))
    assert len(lines) == 3
    for line in lines:
        assert re.findall(r"(?<!d)sample-point ([\d.]+)", line) == ["0.8"], line
        assert re.findall(r"dsample-point ([\d.]+)", line) == ["0.8"], line


def test_the_timing_of_drivers_samples_where_the_kernels_does() -> None:
    (words,) = re.findall(r"`-i pcan (-c [^`]+)`", TEXT)
    namespace = build_parser("rig").parse_args(["rig", "-i", "pcan", *words.split()])
    timing = bus_config(namespace)["timing"]
    assert isinstance(timing, can.BitTimingFd)
    assert (timing.nom_bitrate, timing.data_bitrate) == (500_000, 2_000_000)
    assert (timing.nom_sample_point, timing.data_sample_point) == (80.0, 80.0)
    vector = next(line for line in TEXT.splitlines() if "`-i vector" in line)
    assert "--timing" in vector, "python-can's own sample points of Vector's are others"


def test_the_front_page_sends_whoever_is_at_the_bench_there() -> None:
    rows = (DOCS / "index.md").read_text(encoding="utf-8").splitlines()
    (row,) = (row for row in rows if row.startswith("| at the bench"))
    assert "(bench.md)" in row
