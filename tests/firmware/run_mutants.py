"""Small mistakes in slots, expiry and output stage, one at a time: does a test catch each?

    python tests/firmware/run_mutants.py [FILE ...]     of firmware/: valves.c outputs.c

Each mutant is compiled in a copy of the sources and run against the tests of this folder. Ends with
1 where one survives that is not listed below, and where a listed one is none any more.
"""

from __future__ import annotations

import multiprocessing
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import cantools  # noqa: F401 (imported once, before the processes that run the tests)
import pytest

import meshpoint.firmware.build
import meshpoint.rig_sim.shared.valve_drivers  # noqa: F401

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "firmware"
FILES = ("valves.c", "outputs.c")
TESTS = ("test_rules.py", "test_valve_bank.py")
SWAPS = {
    "<=": ("<",), ">=": (">",), "<": ("<=",), ">": (">=",), "==": ("!=",), "!=": ("==",),
    "&&": ("||",), "||": ("&&",), "&": ("|",), "|": ("&",), "+": ("-",), "-": ("+", ""),
    "+=": ("-=",), "++": ("--",), "true": ("false",), "false": ("true",), "~": ("",), "!": ("",),
    "<<": (">>",), ">>": ("<<",),
}  # fmt: skip
TOKEN = re.compile(r"->|<<|>>|<=|>=|==|!=|&&|\|\||\+\+|\+=|[<>&|+~!-]|\btrue\b|\bfalse\b|\b\d\w*\b")
STATEMENT = re.compile(
    r"^ {4,}(?=\S)(?!return|bool|int|uint|unsigned|const|struct|\{|\}|for|if|else).*;$"
)
LATER = "if (pending->is_set && pending->at_us {} next_us) {{"
EQUIVALENT = {
    f"valves.c: {LATER.format('<')} -> {LATER.format('<=')}": "of two equal times either will do"
}
"""Mutants that behave as the firmware does, with the reason."""
SLOW_S = 60


def mutants(text: str) -> Iterator[tuple[int, str]]:
    """Each line's number and what it is made into."""
    in_comment = False
    for number, line in enumerate(text.splitlines()):
        in_comment = (in_comment or "/*" in line) and "*/" not in line
        code, _, comment = line.partition("/*")
        if in_comment or not code.strip() or code.lstrip().startswith(("#", "*")):
            continue
        for match in TOKEN.finditer(code):
            token = match[0]
            made = SWAPS.get(token, ())
            if token[0].isdigit():
                made = (str(int(token, 0) + 1),)
            for other in made:
                yield number, code[: match.start()] + other + code[match.end() :] + comment
        if STATEMENT.match(code):
            yield number, re.sub(r"\S.*", ";", code)


def run_tests(folder: Path) -> None:
    """In a process of its own: ends with pytest's exit code."""
    os.environ["MESHPOINT_FIRMWARE_SOURCES"] = str(folder)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    tests = [str(Path(__file__).with_name(name)) for name in TESTS]
    code = pytest.main(["-q", "-x", "-p", "no:cacheprovider", "-m", "not long", *tests])
    os._exit(int(code))


def is_caught(folder: Path) -> bool:
    """Whether the firmware of these sources does not compile, fails a test, or never ends."""
    child = multiprocessing.get_context("fork").Process(target=run_tests, args=(folder,))
    child.start()
    child.join(SLOW_S)
    if child.is_alive():
        child.kill()
        child.join()
    return child.exitcode != 0


def judged(name: str) -> Iterator[tuple[str, bool]]:
    """Each mutant of a file in words, and whether it is caught."""
    lines = (SOURCES / name).read_text("utf-8").splitlines()
    for number, line in mutants("\n".join(lines)):
        with tempfile.TemporaryDirectory() as made:
            folder = Path(made) / "firmware"
            shutil.copytree(SOURCES, folder)
            mutated = [*lines[:number], line, *lines[number + 1 :]]
            (folder / name).write_text("\n".join(mutated) + "\n", "utf-8")
            words = f"{name}: {lines[number].strip()} -> {line.strip()}"
            yield words, is_caught(folder)


def main() -> int:
    survived, caught = [], 0
    for name in sys.argv[1:] or FILES:
        for words, is_killed in judged(name):
            caught += is_killed
            if not is_killed:
                survived.append(words)
                print(f"{'equivalent' if words in EQUIVALENT else 'SURVIVES'}: {words}", flush=True)
    print(f"{caught} mutants caught, {len(survived)} not")
    stale = set(EQUIVALENT) - set(survived) if not sys.argv[1:] else set()
    for words in stale:
        print(f"listed, and caught or none any more: {words}")
    return int(bool(set(survived) - set(EQUIVALENT) or stale))


if __name__ == "__main__":
    sys.exit(main())
