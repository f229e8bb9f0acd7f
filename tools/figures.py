"""Keeps measured figures in one file, docs/figures.toml, and in the documents that show them.

    python tools/figures.py            writes the file's figures into the documents
    python tools/figures.py NAME ...   makes these measurements again first: runs each one's command
                                       and takes its figures out of the JSON that it prints
    python tools/figures.py --all      makes those again whose code has changed since, where a
                                       command gives them, and names the others

A document shows a figure between two marks, `<!-- figure: typical.phase_gap -->` and `<!-- / -->`.
In the same section it says of what code the figure is: between `<!-- as of: typical, alone_* -->`
and `<!-- / -->` stand the commit, and whether the code has changed since. The head of the file says
what an entry has.
"""

from __future__ import annotations

import datetime as dt
import fnmatch
import json
import os
import platform
import re
import shlex
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "docs" / "figures.toml"
MARK = re.compile(r"(<!-- figure: (?P<name>[\w.]+) -->)(?P<text>.*?)(<!-- / -->)")
AS_OF = re.compile(r"(<!-- as of: (?P<names>[\w*, ]+) -->)(?P<text>.*?)(<!-- / -->)")
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


def filled(
    document: str, found: Mapping[str, Mapping[str, Any]], older: Mapping[str, bool | None]
) -> str:
    """A document with its marks filled: figures, and of what code they are.

    `older`: by measurement, whether its code has changed since; None where that is not known, and
    then what the document says of it stays. A mark without a figure or a measurement is a KeyError.
    """
    figures = texts(found)

    def age(mark: re.Match[str]) -> str:
        names = named(mark["names"], found)
        if any(older[name] is None for name in names):
            return mark[0]
        return mark[1] + as_of({name: found[name] for name in names}, older) + mark[4]

    shown_figures = MARK.sub(lambda mark: mark[1] + figures[mark["name"]] + mark[4], document)
    return AS_OF.sub(age, shown_figures)


def named(patterns: str, found: Mapping[str, Any]) -> list[str]:
    """The measurements that a mark names, `*` for any letters. KeyError where there is none."""
    names = []
    for pattern in patterns.split(", "):
        matching = fnmatch.filter(found, pattern)
        if not matching:
            raise KeyError(pattern)
        names += matching
    return names


def as_of(measured: Mapping[str, Mapping[str, Any]], older: Mapping[str, bool | None]) -> str:
    """Of what code measurements are, in words. Where they are not all of one, those that are fewer
    have their names."""
    groups: dict[str, list[str]] = {}
    for name, each in measured.items():
        groups.setdefault(age_in_words(each, older[name]), []).append(f"`{name}`")
    most, *others = sorted(groups, key=lambda words: -len(groups[words]))
    return "; ".join([most, *(f"{', '.join(groups[words])} {words}" for words in others)])


def age_in_words(measurement: Mapping[str, Any], older: bool | None) -> str:
    """Of what code a measurement is: `as of commit 8f5516e (2026-11-28), not of today's code`."""
    of = f"of commit {measurement['commit']} ({measurement['date']})"
    if not older:
        return f"{of}, today's code"
    rig = measurement.get("rig")
    return f"as {of}, not of today's code" + (f": of a rig {rig}" if rig else "")


def sections(document: str) -> Iterator[str]:
    """A document in parts, each from a heading to the next."""
    yield from re.split(r"^(?=#+ )", document, flags=re.MULTILINE)


def undated(document: str, found: Mapping[str, Any]) -> set[str]:
    """Measurements whose figures a section shows without saying of what code they are."""
    missing = set()
    for section in sections(document):
        shown_ones = {mark["name"].partition(".")[0] for mark in MARK.finditer(section)}
        dated = {name for mark in AS_OF.finditer(section) for name in named(mark["names"], found)}
        missing |= shown_ones - dated
    return missing


def fill() -> None:
    """Writes the file's figures into the documents, and of what code they are."""
    found = measurements()
    older = {name: is_older(each) for name, each in found.items()}
    for path in documents():
        before = path.read_text(encoding="utf-8")
        after = filled(before, found, older)
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


def by_hand(measurement: Mapping[str, Any]) -> list[str]:
    """Figures of a measurement that are not in the JSON of its command."""
    return [key for key, figure in measurement["figures"].items() if "json" not in figure]


def make_all() -> bool:
    """Makes all measurements again that their commands give, but for those of today's code. Each is
    in the file once it is made, so a second run goes on with the others. Whether every command did
    its work: the next is tried where one did not."""
    found, failed = measurements(), 0
    for name, measurement in found.items():
        if is_older(measurement) is False:
            print(f"of today's code: {name}")
            continue
        without = by_hand(measurement)
        if without:
            print(f"by hand: {name}: {', '.join(without)}: {measurement['command']}")
            continue
        begun_s = time.monotonic()
        try:
            make(name)
        except subprocess.CalledProcessError as error:
            print(f"not measured: {name}: {error}", flush=True)
            failed += 1
            continue
        print(f"measured: {name}, {time.monotonic() - begun_s:.0f} s", flush=True)
    return not failed


def make(name: str) -> None:
    """Makes one measurement again and writes it into the file, each line in its place."""
    found = measurements()
    if name not in found:
        raise ValueError(f"{FILE.name}: no measurement {name}; there are {', '.join(found)}")
    measurement = found[name]
    without = by_hand(measurement)
    if without:
        raise ValueError(f"{FILE.name}: {name}: no command gives {', '.join(without)}: by hand")
    if differs("HEAD", measurement["of"]):
        raise ValueError(
            f"{FILE.name}: {name}: changes in {', '.join(measurement['of'])} that are in no "
            "commit; a measurement is of a commit"
        )
    record = run(measurement)
    lines = {key: figure | taken(record, figure) for key, figure in measurement["figures"].items()}
    new = {
        "commit": git("rev-parse", "--short=7", "HEAD"),
        "date": dt.datetime.now(dt.UTC).date(),
        "machine": f"{os.cpu_count()} processors, {platform.machine()}",
        "rig": None,
    }
    text = FILE.read_text(encoding="utf-8")
    FILE.write_text(rewritten(text, name, new, lines), encoding="utf-8")


def rewritten(
    text: str, name: str, new: Mapping[str, Any], figures: Mapping[str, Mapping[str, Any]]
) -> str:
    """The file's text with a measurement's new lines in place of those of the same keys; None takes
    a key's line out."""
    section, lines = "", []
    for line in text.splitlines():
        heading = re.fullmatch(r"\[([\w.]+)\]", line)
        section = heading[1] if heading else section
        key = line.partition(" = ")[0]
        if section == name and key in new:
            lines += [f"{key} = {toml(new[key])}"] if new[key] is not None else []
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


def is_older(measurement: Mapping[str, Any]) -> bool | None:
    """Whether the code that a measurement is of differs from what it was made of, by as much as a
    character; None where git does not know its commit."""
    return differs(measurement["commit"], measurement["of"])


def differs(commit: str, paths: list[str]) -> bool | None:
    """Whether the files of these paths differ from those of a commit, new ones counted; None where
    git does not know it."""
    if not git("rev-parse", "--verify", "--quiet", f"{commit}^{{commit}}"):
        return None
    changed = git("diff", "--name-only", commit, "--", *paths)
    return bool(changed or git("ls-files", "--others", "--exclude-standard", "--", *paths))


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
    done = True
    try:
        if sys.argv[1:] == ["--all"]:
            done = make_all()
        else:
            for each in sys.argv[1:]:
                make(each)
        fill()
    except (KeyError, ValueError, OSError, subprocess.CalledProcessError) as error:
        print(f"figures: {error}", file=sys.stderr)
        sys.exit(2)
    sys.exit(0 if done else 1)
