"""Keeps measured figures in one file, docs/figures.toml, and in the documents that show them.

    python tools/figures.py            writes the file's figures into the documents
    python tools/figures.py NAME ...   makes these measurements again first: runs each one's command
                                       and takes its figures out of the JSON that it prints

A document shows a figure between two marks, `<!-- figure: typical.aimed_gap -->` and `<!-- / -->`.
The head of the file says what an entry has.
"""

from __future__ import annotations

import datetime as dt
import json
import os
import platform
import re
import shlex
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "docs" / "figures.toml"
MARK = re.compile(r"(<!-- figure: (?P<name>[\w.]+) -->)(?P<text>.*?)(<!-- / -->)")
DIGITS = {"%": 1, "ms": 0, "J": 2, "deg": 2, "x": 2, "rpm": 0, "h": 2, "us": 2,
          "s": 0, "MB": 0, "% of a pitch": 1, "": 0}  # fmt: skip
"""Digits after the point by unit. "x" is a ratio, "" a count."""
FACTORS = {"%": 100.0}
"""From what a JSON has, a share of 1, to the unit."""
VALUES = ("rate", "mean", "ratio")
INTERVALS = ("ci95", "mean_ci95")
"""What a group of a JSON calls its value and its interval."""
RUN = {"meshpoint": ["-m", "meshpoint"], "python": []}
"""What a command may begin with, and what Python is then given."""
MARGIN_DAYS = 60
"""So long after a measurement may the code change that it is of; then it is made again."""


def measurements(file: Path = FILE) -> dict[str, dict[str, Any]]:
    """The measurements of the file by name, each with its conditions and its figures."""
    return tomllib.loads(file.read_text(encoding="utf-8"))


def texts(found: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Each figure as documents show it, by `MEASUREMENT.FIGURE`."""
    return {
        f"{name}.{key}": shown(figure)
        for name, measurement in found.items()
        for key, figure in measurement["figures"].items()
    }


def shown(figure: Mapping[str, Any]) -> str:
    """A figure as documents show it: `86.5 % (84.6 to 88.2)`, `474 ms`, `1.76`, `12`."""
    unit = figure["unit"]
    digits = figure.get("digits", DIGITS[unit])
    value = f"{figure['value']:,.{digits}f}"
    value += f" {unit}" if unit not in ("", "x") else ""
    if "interval" not in figure:
        return value
    low, high = (f"{end:,.{digits}f}" for end in figure["interval"])
    return f"{value} ({low} to {high})"


def documents() -> Iterator[Path]:
    """README and every page below docs/."""
    yield ROOT / "README.md"
    yield from sorted((ROOT / "docs").rglob("*.md"))


def filled(document: str, figures: Mapping[str, str]) -> str:
    """A document with its marks filled. A mark without a figure in the file is a KeyError."""
    return MARK.sub(lambda mark: mark[1] + figures[mark["name"]] + mark[4], document)


def fill() -> None:
    """Writes the file's figures into the documents."""
    figures = texts(measurements())
    for path in documents():
        before = path.read_text(encoding="utf-8")
        after = filled(before, figures)
        if after != before:
            path.write_text(after, encoding="utf-8")
            print(f"filled: {path.relative_to(ROOT)}")


# ------------------------------------------------------------ made again ----


def at(record: Any, path: str) -> Any:
    """What is at a dotted path of a JSON; numbers count in lists."""
    for key in path.split("."):
        record = record[int(key)] if isinstance(record, list) else record[key]
    return record


def taken(record: Any, figure: Mapping[str, Any]) -> dict[str, Any]:
    """The value of a figure, and its interval where the JSON has one."""
    found = at(record, figure["json"])
    factor = FACTORS.get(figure["unit"], 1.0)
    digits = figure.get("digits", DIGITS[figure["unit"]]) or None
    if not isinstance(found, dict):
        return {"value": round(found * factor, digits)}
    value = next(found[key] for key in VALUES if key in found)
    new = {"value": round(value * factor, digits)}
    ends = next((found[key] for key in INTERVALS if key in found), None)
    return new | ({"interval": [round(end * factor, digits) for end in ends]} if ends else {})


def run(measurement: Mapping[str, Any]) -> Any:
    """The JSON that the command of a measurement prints."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "given.toml"
        file.write_text(measurement.get("file", ""), encoding="utf-8")
        words = shlex.split(re.sub(r"\bFILE\b", file.as_posix(), measurement["command"]))
        if words[0] not in RUN or words[-2:] != ["--json", "-"]:
            raise ValueError(
                f"{FILE.name}: {measurement['command']}: allowed is meshpoint|python ... --json -"
            )
        done = subprocess.run(  # noqa: S603
            [sys.executable, *RUN[words[0]], *words[1:]],
            check=True, stdout=subprocess.PIPE, cwd=ROOT,
        )  # fmt: skip
    return json.loads(done.stdout)


def git(*words: str) -> str:
    """What git says; nothing where there is no git or no repository."""
    try:
        done = subprocess.run(  # noqa: S603
            ["git", *words],  # noqa: S607
            check=True, capture_output=True, text=True, cwd=ROOT,
        )  # fmt: skip
    except (OSError, subprocess.CalledProcessError):
        return ""
    return done.stdout.strip()


def make(name: str) -> None:
    """Makes one measurement again and writes it into the file, each line in its place."""
    found = measurements()
    if name not in found:
        raise ValueError(f"{FILE.name}: no measurement {name}; there are {', '.join(found)}")
    measurement = found[name]
    without = [key for key, figure in measurement["figures"].items() if "json" not in figure]
    if without:
        raise ValueError(f"{FILE.name}: {name}: no command gives {', '.join(without)}: by hand")
    record = run(measurement)
    lines = {key: figure | taken(record, figure) for key, figure in measurement["figures"].items()}
    new = {
        "commit": git("rev-parse", "--short=7", "HEAD"),
        "date": dt.datetime.now(dt.UTC).date(),
        "machine": f"{os.cpu_count()} processors, {platform.machine()}",
    }
    text = FILE.read_text(encoding="utf-8")
    FILE.write_text(rewritten(text, name, new, lines), encoding="utf-8")


def rewritten(
    text: str, name: str, new: Mapping[str, Any], figures: Mapping[str, Mapping[str, Any]]
) -> str:
    """The file's text with a measurement's new lines in place of those of the same keys."""
    section, lines = "", []
    for line in text.splitlines():
        heading = re.fullmatch(r"\[([\w.]+)\]", line)
        section = heading[1] if heading else section
        key = line.partition(" = ")[0]
        if section == name and key in new:
            lines.append(f"{key} = {toml(new[key])}")
        elif section == f"{name}.figures" and key in figures:
            lines.append(f"{key} = {toml(figures[key])}")
        else:
            lines.append(line)
    return "\n".join(lines) + "\n"


def toml(value: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {toml(each)}" for key, each in value.items()) + "}"
    return value.isoformat() if isinstance(value, dt.date) else json.dumps(value)


# ------------------------------------------------------------------- age ----


def code_changed(paths: list[str]) -> dt.date | None:
    """When any of these paths was last changed; None where git does not know it."""
    if git("rev-parse", "--is-shallow-repository") != "false":
        return None
    day = git("log", "-1", "--format=%cs", "--", *paths)
    return dt.date.fromisoformat(day) if day else None


def is_too_old(measured: dt.date, changed: dt.date | None) -> bool:
    """Whether the code changed longer after a measurement than the margin allows."""
    return changed is not None and (changed - measured).days > MARGIN_DAYS


if __name__ == "__main__":
    try:
        for each in sys.argv[1:]:
            make(each)
        fill()
    except (KeyError, ValueError, OSError, subprocess.CalledProcessError) as error:
        print(f"figures: {error}", file=sys.stderr)
        sys.exit(2)
