"""Which tests run which lines, and how long they take: the map by which tests are chosen."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
import types
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Final

import pytest
from forks import in_a_fork
from hashes import Hashes
from importers import users_of
from targets import TARGETS

FORGET: Final = 0.9
LONGEST_S: Final = 15.0
"""A test that takes longer (processor time) is not run for mutants,"""
TRACED: Final = 6.0
"""or this many times as long while its lines are noted."""


class Task:
    """What to do, from the file; and what came of it, to a file beside it, a line a mutant."""

    def __init__(self, path: Path) -> None:
        values = json.loads(path.read_text(encoding="utf-8"))
        self.root = Path(values["root"])
        self.wanted: dict[str, list[str]] = values["mutants"]
        """Names, by file."""
        self.budget_s: float = values["budget_s"]
        self.map_path = Path(values["map"])
        self.results = Path(values["results"])
        self.until_s: float | None = values["until_s"]
        """After this time (time.time()) no mutant is begun."""
        self.target: str = values["target"]
        target = next(each for each in TARGETS if each.name == self.target)
        self.files = [str(path) for path in target.paths()]
        """All of the target: what is known of its tests serves the next run too."""
        self.hashes = Hashes(target)

    def tell(self, mutant: str, by: str, **values: Any) -> None:
        values = {"mutant": mutant, "by": by, **values} | self.hashes.of(mutant, by)
        with self.results.open("a", encoding="utf-8") as file:
            file.write(json.dumps(values) + "\n")


class Coverage:
    """Which lines of the mutated files each test runs, and how long it takes (processor time)."""

    def __init__(self, lines: dict[str, dict[str, list[int]]], seconds: dict[str, float]) -> None:
        self.lines = {
            path: {test: set(there) for test, there in by_test.items()}
            for path, by_test in lines.items()
        }
        self.seconds = seconds
        self._caught: Counter[str] = Counter()

    @classmethod
    def of(cls, task: Task, session: pytest.Session) -> Coverage:
        """From what earlier runs have left of tests that are the same, and by running the others
        twice: for the lines, and for the time."""
        if not task.map_path.exists():
            values = _known(task)
            _note_all(task, session, values)
            task.map_path.write_text(json.dumps(values), encoding="utf-8")
        values = json.loads(task.map_path.read_text(encoding="utf-8"))
        return cls(values["lines"], values["seconds"])

    def tests_for(self, path: str, lines: range, budget_s: float) -> list[str]:
        """Those that run any of these lines, or all if it is none, as many as fit the budget. What
        belongs to no function is used wherever it is imported."""
        found = self._running(path, lines) if lines else self.seconds
        return self._fitting(found, budget_s)

    def tests_of_constants(self, path: str, names: Iterable[str], budget_s: float) -> list[str]:
        """Those that run a function which names one of these constants of the file."""
        users = users_of(path, names, self.lines)
        found = {test for user, lines in users for test in self._running(user, lines)}
        return self._fitting(found, budget_s) or self._fitting(self.seconds, budget_s)

    def expected_s(self, tests: Iterable[str]) -> float:
        """What these tests take, at most. The first of a file makes what the file's tests share,
        whichever was the first while times were taken."""
        files = {test.split("::")[0] for test in tests}
        shared = dict.fromkeys(files, 0.0)
        for test, taken_s in self.seconds.items():
            file = test.split("::")[0]
            if file in shared:
                shared[file] = max(shared[file], taken_s)
        return sum(self.seconds[test] for test in tests) + sum(shared.values())

    def _running(self, path: str, lines: range) -> set[str]:
        by_test = self.lines.get(path, {})
        return {test for test, there in by_test.items() if not there.isdisjoint(lines)}

    def _fitting(self, tests: Iterable[str], budget_s: float) -> list[str]:
        """The shortest, and of these what has caught a mutant before at first: it is the likeliest
        to catch the next."""
        chosen, sum_s = [], 0.0
        for test in sorted(tests, key=lambda test: (self.seconds[test], test)):
            sum_s += self.seconds[test]
            if chosen and sum_s > budget_s:
                break
            chosen.append(test)
        return sorted(chosen, key=lambda test: -self._caught[test])

    def note_caught(self, test: str) -> None:
        """This test has caught a mutant; what it has caught of late counts most."""
        for each in self._caught:
            self._caught[each] *= FORGET
        self._caught[test] += 1.0


def _note_all(task: Task, session: pytest.Session, values: dict[str, Any]) -> None:
    """Runs the tests of which nothing is known, a file at a time: a run that is ended has kept
    what it knows of the others."""
    by_file: dict[str, list[pytest.Item]] = {}
    for item in session.items:
        if item.nodeid not in values["seconds"] and item.nodeid not in values["failed"]:
            by_file.setdefault(item.nodeid.split("::")[0], []).append(item)
    so_far = task.map_path.with_suffix(f".{os.getpid()}.map.json")
    for items in by_file.values():
        timed = in_a_fork(lambda items=items: _run_and_note(session, items, []))
        if timed is None:
            raise session.Interrupted("the tests end their process without a mutant")
        whole = [item for item in items if item.nodeid not in timed["failed"]]
        noted = in_a_fork(lambda items=whole: _run_and_note(session, items, task.files))
        if noted is None:
            raise session.Interrupted("the tests end their process when they are looked at")
        failed = {*timed["failed"], *noted["failed"]}
        if not failed <= {*timed["late"], *noted["late"]}:
            raise session.Interrupted(f"tests fail without a mutant: {sorted(failed)[:5]}")
        if failed:
            print("left out, they take too long:", *sorted(failed))
        for path, by_test in noted["lines"].items():
            values["lines"].setdefault(path, {}).update(_without(failed, by_test))
        values["seconds"] |= _without(failed, timed["seconds"])
        values["failed"] = sorted({*values["failed"], *failed})
        so_far.write_text(json.dumps(values), encoding="utf-8")
    so_far.unlink(missing_ok=True)


def _without(failed: set[str], by_test: dict[str, Any]) -> dict[str, Any]:
    return {test: each for test, each in by_test.items() if test not in failed}


def _known(task: Task) -> dict[str, Any]:
    """Of the maps of the same code, what they have of test files that are the same."""
    known: dict[str, Any] = {"lines": {}, "seconds": {}, "failed": []}
    start = f"{task.target}-{task.hashes.all_code}"
    for path in sorted(task.map_path.parent.glob(f"{start}-*.map.json"), key=_written_s):
        values = _of_these_tests(task, json.loads(path.read_text(encoding="utf-8")))
        for file, by_test in values["lines"].items():
            known["lines"].setdefault(file, {}).update(by_test)
        known["seconds"] |= values["seconds"]
        known["failed"] = sorted({*known["failed"], *values["failed"]})
    return known | {"tests": task.hashes.tests}


def _written_s(path: Path) -> float:
    return path.stat().st_mtime


def _of_these_tests(task: Task, values: dict[str, Any]) -> dict[str, Any]:
    """What a map has of test files that are the same now."""
    same = {name for name, hashed in values["tests"].items()
            if task.hashes.tests.get(name) == hashed}  # fmt: skip

    def kept(by_test: dict[str, Any]) -> dict[str, Any]:
        return {test: each for test, each in by_test.items() if test.split("::")[0] in same}

    lines = {path: kept(by_test) for path, by_test in values["lines"].items()}
    failed = [test for test in values["failed"] if test.split("::")[0] in same]
    return {"lines": lines, "seconds": kept(values["seconds"]), "failed": failed}


def _run_and_note(
    session: pytest.Session, items: list[pytest.Item], files: list[str]
) -> dict[str, Any]:
    """These tests: the lines they run of these files, their times, and those that failed."""
    lines: dict[str, dict[str, list[int]]] = {path: {} for path in files}
    seconds: dict[str, float] = {}
    failed: list[str] = []
    late: list[str] = []
    tracer = Tracer(files)
    for item, following in in_turn(items):
        seen: dict[str, set[int]] = {path: set() for path in files}
        begun_s = time.process_time()
        if files:
            tracer.begin(seen)
            sys.settrace(tracer.on_call)
        is_late: list[int] = []
        with ended_after(LONGEST_S * (TRACED if files else 1.0), is_late):
            is_bad = fails(session, item, following)
        sys.settrace(None)
        seconds[item.nodeid] = time.process_time() - begun_s
        failed += [item.nodeid] if is_bad or is_late else []
        late += [item.nodeid] if is_late else []
        for path, there in seen.items():
            if there:
                lines[path][item.nodeid] = sorted(there)
    return {"lines": lines, "seconds": seconds, "failed": failed, "late": late}


@contextmanager
def ended_after(longest_s: float, late: list[int]) -> Iterator[None]:
    """Ends a test after so much processor time, and adds to `late`."""

    def end(number: int, frame: types.FrameType | None) -> None:
        late.append(number)
        raise pytest.skip.Exception("too long")  # hypothesis does not try this again

    before = signal.signal(signal.SIGPROF, end)
    signal.setitimer(signal.ITIMER_PROF, longest_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


class Tracer:
    """Notes the lines that are run of these files. A function all of whose lines have been seen in
    a test is looked at no more in it: a closed loop calls most of them for each step."""

    def __init__(self, files: list[str]) -> None:
        self._files = frozenset(files)
        self._lines: dict[types.CodeType, frozenset[int]] = {}
        """Of each function's code; none where it is of another file."""
        self._left: dict[types.CodeType, set[int]] = {}
        self._seen: dict[str, set[int]] = {}

    def begin(self, seen: dict[str, set[int]]) -> None:
        """A test: the lines go here."""
        self._seen, self._left = seen, {}

    def on_call(self, frame: types.FrameType, event: str, argument: Any) -> Any:
        code = frame.f_code
        left = self._left.get(code)
        if left is None:
            left = self._left[code] = set(self._lines_of(code))
        if not left:
            return None
        there = self._seen[real(code.co_filename)]

        def on_line(frame: types.FrameType, event: str, argument: Any) -> Any:
            there.add(frame.f_lineno)
            left.discard(frame.f_lineno)
            return on_line

        return on_line

    def _lines_of(self, code: types.CodeType) -> frozenset[int]:
        if code not in self._lines:
            is_ours = real(code.co_filename) in self._files
            lines = (line for _, _, line in code.co_lines() if line is not None)
            head = code.co_firstlineno  # of a function no line that is run, but of its decorators
            self._lines[code] = frozenset(lines) - {head} if is_ours else frozenset()
        return self._lines[code]


def in_turn(items: list[pytest.Item]) -> Iterator[tuple[pytest.Item, pytest.Item | None]]:
    """Each with the one after it, so that what they share is made once."""
    for k, item in enumerate(items):
        yield item, items[k + 1] if k + 1 < len(items) else None


def fails(session: pytest.Session, item: pytest.Item, following: pytest.Item | None) -> bool:
    """Whether a test that is run now fails."""
    failed: list[str] = []

    class Watch:
        def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
            if report.failed:
                failed.append(report.nodeid)

    watch = Watch()
    session.config.pluginmanager.register(watch)
    try:
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
    finally:
        session.config.pluginmanager.unregister(watch)
    return bool(failed)


@cache
def real(path: str) -> str:
    """The file itself, where a package is linked to its place."""
    return os.path.realpath(path)
