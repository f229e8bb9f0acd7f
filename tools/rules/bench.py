"""docs/bench.md: its commands can be typed as they stand, and set one bit timing."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Iterator

import can

from meshpoint.bus.options import bus_config, classic_refusal
from meshpoint.cli.table import COMMANDS, build_parser
from rules import ROOT

DOCS = ROOT / "docs"
PAGE = "docs/bench.md"
TEXT = (ROOT / PAGE).read_text(encoding="utf-8")
FIRST_DAY = TEXT[TEXT.index("## First power-up") : TEXT.index("## What the guard")]
TYPED = [
    " ".join(found.split())
    for found in re.findall(
        r"`(meshpoint [^`]+)`|^    (meshpoint [^#\n]+)", FIRST_DAY, re.MULTILINE
    )
    for found in found
    if found
]
ALWAYS = {"check", "commission", "controller", "request", "watch", "replay", "rig"}
"""Commands that the first day needs."""
WITHOUT_BUS = ("show", "replay")
AT_THE_DESK = ("rig", "up")
SET_UPS = 3
"""Lines that set a bus up: two of the page, and what the commands say."""


def wrong_with(command: str) -> str:
    """Why it cannot be typed as it stands; empty where it can."""
    _, name, *words = command.partition(" >")[0].replace("$BUS", "-i socketcan -c can0").split()
    if name not in COMMANDS:
        return "no such command"
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            build_parser(name).parse_args([name, *words])
    except SystemExit:
        return said.getvalue().strip()
    needs_no_bus = name in (*AT_THE_DESK, *WITHOUT_BUS)
    return "" if needs_no_bus or "$BUS" in command else "names no bus"


def commands() -> Iterator[str]:
    """What is wrong with those of the first day."""
    if missing := ALWAYS - {command.split()[1] for command in TYPED}:
        yield f"{PAGE}: the first day lacks {sorted(missing)}"
    for command in TYPED:
        if why := wrong_with(command):
            yield f"{PAGE}: `{command}`: {why}"


def sample_points() -> Iterator[str]:
    """Every set-up of a bus samples at one point, and drivers where the kernel does."""
    lines = [line for line in TEXT.splitlines() if "dbitrate" in line and "ip link" in line]
    lines.append(classic_refusal("can0"))
    if len(lines) != SET_UPS:
        yield f"{PAGE}: {len(lines)} set-ups of a bus, not {SET_UPS}"
    for line in lines:
        for point in (r"(?<!d)sample-point", "dsample-point"):
            if re.findall(rf"{point} ([\d.]+)", line) != ["0.8"]:
                yield f"{PAGE}: another sample point than 0.8: {line}"
    (words,) = re.findall(r"`-i pcan (-c [^`]+)`", TEXT)
    with contextlib.redirect_stdout(io.StringIO()):  # python-can prints a timing that it takes
        namespace = build_parser("rig").parse_args(["rig", "-i", "pcan", *words.split()])
    timing = bus_config(namespace)["timing"]
    if not isinstance(timing, can.BitTimingFd) or (
        timing.nom_bitrate, timing.data_bitrate, timing.nom_sample_point, timing.data_sample_point
    ) != (500_000, 2_000_000, 80.0, 80.0):  # fmt: skip
        yield f"{PAGE}: -i pcan {words}: {timing}"
    vector = next(line for line in TEXT.splitlines() if "`-i vector" in line)
    if "--timing" not in vector:
        yield f"{PAGE}: python-can's own sample points of Vector's are others: {vector}"


def findings() -> Iterator[str]:
    """Commands, sample points, and the way there from the front page."""
    yield from commands()
    yield from sample_points()
    rows = (DOCS / "index.md").read_text(encoding="utf-8").splitlines()
    at_the_bench = [row for row in rows if row.startswith("| at the bench")]
    if len(at_the_bench) != 1 or "(bench.md)" not in at_the_bench[0]:
        yield "docs/index.md: does not send whoever is at the bench to bench.md"
