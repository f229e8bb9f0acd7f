"""A plugin of pytest: it runs the tests not once, but for each mutant those that cover it.

    pytest -p forked_runs ... with MUTATION_TASK naming a JSON file

All tests are collected and all modules loaded once; each mutant then lives in a forked process,
where the code of its function is replaced, or a constant of its module. A mutant elsewhere (a
table, the fields of a class, a compiled kernel) gets a process of its own that imports the mutated
file.
"""

from __future__ import annotations

import ast
import gc
import json
import os
import resource
import signal
import subprocess
import sys
import time
import types
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Final

import pytest
from hashes import Hashes
from importers import importers_of, users_of
from kernels import is_compiled
from mutator import Mutant, Mutants, Where
from targets import NOT_IMPORTED, ROOT, TARGETS, caught_by, files_of

from meshpoint.controller.jit import DISABLED

TASK: Final = "MUTATION_TASK"
KILLED, SURVIVED, UNCOVERED, PASSED_ON = "killed", "survived", "uncovered", "passed on"
SPARE_S: Final = 1.0
TIMES: Final = 5.0
"""Beyond so many times its tests' own time, and the spare, a mutant never ends."""
WALL_TIMES: Final = 20.0
"""Nor does one that for so many times as long has used no processor at all."""
FORGET: Final = 0.9
MORE_BYTES: Final = 3 << 30
FAILED: Final = 1
RUN_AT_IMPORT: Final = frozenset({ROOT / "controller/jit.py"})
"""Files whose functions have done their work when the tests begin: they need a process of their
own."""
LONGEST_S: Final = 2.0 if DISABLED else 15.0
"""A test that takes longer (processor time) is not run for mutants,"""
TRACED: Final = 6.0
"""or so many times as long while its lines are noted."""
START_S: Final = 30.0
"""What a process of its own takes to load, at most, on a busy machine (processor time)."""


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
        self.is_last: bool = values["is_last"]
        """Whether what these tests let through survives; else others are to try it."""
        self.how: str = values["how"]
        """Whether kernels are compiled: of that the lines and times of tests depend."""
        target = next(each for each in TARGETS if each.name == self.target)
        target = target._replace(tests=tuple(values["tests"]))
        self.must = target.must
        self.files = [str(path) for path in files_of(target)]
        """All of the target: what is known of its tests serves the next run too."""
        self.hashes = Hashes(target)
        self._held_by = Hashes(target._replace(tests=tuple(values["held_by"])))
        """Of all tests that have tried what is left."""

    def tell(self, mutant: str, by: str, **values: Any) -> None:
        values = {"mutant": mutant, "by": by, **values, **self._held_by.of(mutant, by)}
        with self.results.open("a", encoding="utf-8") as file:
            file.write(json.dumps(values) + "\n")


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> bool | None:
    """In place of the run."""
    if TASK not in os.environ:
        return None
    if session.testsfailed:
        raise session.Interrupted("errors while the tests were collected")
    task = Task(Path(os.environ[TASK]))
    if not DISABLED:
        _load_kernels()
    covered = Coverage.of(task, session)
    runner = _Runner(task, session, covered)
    for name, wanted in task.wanted.items():
        source = (task.root / name).read_text(encoding="utf-8")
        mutants = Mutants(name, source)
        keep = set(wanted)
        for mutant in mutants.all:
            is_time = task.until_s is None or time.time() < task.until_s
            if mutant.name in keep and is_time:
                runner.run(mutants, mutant, task.root / name)
    return True


def _load_kernels() -> None:
    """Once for all: each process that is forked has them."""
    from meshpoint.controller.warm_up import warm_up
    from meshpoint.gearbox import load_sheet
    from meshpoint.rig_sim.presets import build_world
    from meshpoint.rig_sim.settings import RigSettings

    warm_up(baselines=True)
    build_world(load_sheet("truck12"), RigSettings())


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

    def tests_for(self, path: str, lines: range, budget_s: float, compiled: bool) -> list[str]:
        """Those that run any of these lines, or all if it is none, as many as fit the budget. What
        belongs to no function is used wherever it is imported. A compiled line is never seen to
        run: then those that run anything which imports its file."""
        if not lines:
            return self._fitting(self.seconds, budget_s)
        found = self._running(path, lines)
        if compiled and not found:
            users = importers_of(path, self.lines)
            found = {test for user in users for test in self.lines[user]}
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
        timed = _in_a_fork(lambda items=items: _run_and_note(session, items, []))
        if timed is None:
            raise session.Interrupted("the tests end their process without a mutant")
        whole = [item for item in items if item.nodeid not in timed["failed"]]
        noted = _in_a_fork(lambda items=whole: _run_and_note(session, items, task.files))
        if noted is None:
            raise session.Interrupted("the tests end their process when they are looked at")
        failed = {*timed["failed"], *noted["failed"]}
        if not failed <= {*timed["late"], *noted["late"]} and task.must:
            raise session.Interrupted(f"tests fail without a mutant: {sorted(failed)[:5]}")
        if failed:
            print("left out, they fail without a mutant, or take too long:", *sorted(failed))
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
    start = f"{task.target}-{task.how}-{task.hashes.all_code}"
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
    tracer = _Tracer(files)
    for item, following in _in_turn(items):
        seen: dict[str, set[int]] = {path: set() for path in files}
        begun_s = time.process_time()
        if files:
            tracer.begin(seen)
            sys.settrace(tracer.on_call)
        is_late: list[int] = []
        with _ended_after(LONGEST_S * (TRACED if files else 1.0), is_late):
            is_bad = _fails(session, item, following)
        sys.settrace(None)
        seconds[item.nodeid] = time.process_time() - begun_s
        failed += [item.nodeid] if is_bad or is_late else []
        late += [item.nodeid] if is_late else []
        for path, there in seen.items():
            if there:
                lines[path][item.nodeid] = sorted(there)
    return {"lines": lines, "seconds": seconds, "failed": failed, "late": late}


@contextmanager
def _ended_after(longest_s: float, late: list[int]) -> Iterator[None]:
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


class _Tracer:
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
        there = self._seen[_real(code.co_filename)]

        def on_line(frame: types.FrameType, event: str, argument: Any) -> Any:
            there.add(frame.f_lineno)
            left.discard(frame.f_lineno)
            return on_line

        return on_line

    def _lines_of(self, code: types.CodeType) -> frozenset[int]:
        if code not in self._lines:
            is_ours = _real(code.co_filename) in self._files
            lines = (line for _, _, line in code.co_lines() if line is not None)
            head = code.co_firstlineno  # of a function no line that is run, but of its decorators
            self._lines[code] = frozenset(lines) - {head} if is_ours else frozenset()
        return self._lines[code]


class _Runner:
    def __init__(self, task: Task, session: pytest.Session, covered: Coverage) -> None:
        self._task, self._session, self._covered = task, session, covered
        self._items = {item.nodeid: item for item in session.items}
        self._functions: dict[tuple[str, str, int], list[types.FunctionType]] = {}
        for each in gc.get_objects():
            if isinstance(each, types.FunctionType):
                code = each.__code__
                key = (_real(code.co_filename), code.co_qualname, code.co_firstlineno)
                self._functions.setdefault(key, []).append(each)
        gc.freeze()  # a collection in a forked process would copy every page it looks at

    def run(self, mutants: Mutants, mutant: Mutant, path: Path) -> None:
        """One mutant; what came of it is told."""
        where = mutant.where
        at_import = path in RUN_AT_IMPORT
        lines = where.lines if where.qualname and not at_import else range(0)
        compiled = is_compiled(path.read_text(encoding="utf-8"), where) and not DISABLED
        budget_s = self._task.budget_s
        if where.constants:
            tests = self._covered.tests_of_constants(str(path), where.constants, budget_s)
        else:
            tests = self._covered.tests_for(str(path), lines, budget_s, compiled)
        begun_s = _used_s()
        if not tests:
            outcome = UNCOVERED if self._task.is_last else PASSED_ON
            self._task.tell(mutant=mutant.name, outcome=outcome, by="", cpu_s=0.0)
            return
        expected_s = self._covered.expected_s(tests)
        mutant.apply()
        try:
            change = self._change(mutants, where, path)
            if change is None or at_import:
                by = self._by_itself(mutants, path, tests, expected_s)
            else:
                by = self._forked(change, tests, expected_s)
        finally:
            mutant.undo()
        cpu_s = round(_used_s() - begun_s, 2)
        outcome = KILLED if by else SURVIVED if self._task.is_last else PASSED_ON
        if by in self._items:
            self._covered.note_caught(by)
        self._task.tell(mutant=mutant.name, outcome=outcome, by=by, cpu_s=cpu_s, count=len(tests))

    def _change(self, mutants: Mutants, where: Where, path: Path) -> Callable[[], None] | None:
        """What makes the mutant in a process that has loaded everything; None where that needs a
        process of its own."""
        if where.constants:
            return _rebinding(mutants, where, path)
        key = (str(path), where.qualname, where.first_line)
        may_be_given = where.is_plain or (
            DISABLED and is_compiled(path.read_text(encoding="utf-8"), where)
        )
        functions = self._functions.get(key, []) if may_be_given and where.qualname else []
        if not functions:
            return None
        code = _code_of(mutants, path, where.qualname, where.first_line)

        def replace() -> None:
            for function in functions:
                function.__code__ = code

        return replace

    def _forked(self, change: Callable[[], None], tests: list[str], expected_s: float) -> str:
        items = [self._items[test] for test in tests]

        def run() -> dict[str, Any]:
            _limit(TIMES * expected_s + SPARE_S)
            change()
            for item, following in _in_turn(items):
                if _fails(self._session, item, following):
                    return {"by": item.nodeid}
            return {"by": ""}

        done = _in_a_fork(run, WALL_TIMES * (expected_s + SPARE_S))
        return "never ends, or ends the process" if done is None else str(done["by"])

    def _by_itself(self, mutants: Mutants, path: Path, tests: list[str], expected_s: float) -> str:
        source = self._task.results.with_suffix(".mutant.py")
        source.write_text(ast.unparse(mutants.tree), encoding="utf-8")
        caught_by(source).unlink(missing_ok=True)
        environment = {key: value for key, value in os.environ.items() if key != TASK}
        environment |= {"MUTATED_FILE": str(path), "MUTATED_SOURCE": str(source)}
        try:
            done = subprocess.run(
                [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider",
                 "--assert=plain", "-p", "mutated_import", *tests],
                env=environment, cwd=self._task.root, stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL, check=False,
                timeout=WALL_TIMES * (expected_s + START_S),
                preexec_fn=lambda: _limit(TIMES * expected_s + START_S),
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return "never ends"
        if done.returncode == NOT_IMPORTED:
            raise RuntimeError(f"{path} was not imported as a mutant")
        if done.returncode == FAILED and caught_by(source).exists():
            return caught_by(source).read_text(encoding="utf-8")
        return "" if done.returncode == 0 else f"a process of its own, exit code {done.returncode}"


def _used_s() -> float:
    """Processor time of this process and of those it has waited for."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def _code_of(mutants: Mutants, path: Path, qualname: str, first_line: int) -> types.CodeType:
    module = compile(mutants.tree, str(path), "exec")

    def search(code: types.CodeType) -> Iterator[types.CodeType]:
        for each in code.co_consts:
            if isinstance(each, types.CodeType):
                if each.co_qualname == qualname and each.co_firstlineno == first_line:
                    yield each
                yield from search(each)

    return next(search(module))


def _rebinding(mutants: Mutants, where: Where, path: Path) -> Callable[[], None] | None:
    """Gives the constants their other values, in their module and where they were imported."""
    named = ((m, getattr(m, "__file__", None) or "") for m in list(sys.modules.values()))
    module = next((m for m, file in named if _real(file) == str(path)), None)
    if module is None:
        return None
    statement = next(s for s in mutants.tree.body if s.lineno == where.lines.start)
    code = compile(ast.Module([statement], []), str(path), "exec")

    def rebind() -> None:
        before = {name: vars(module)[name] for name in where.constants}
        exec(code, vars(module))
        for other in list(sys.modules.values()):
            if other is module or not _imports_from(other, module.__name__):
                continue
            for name, value in before.items():
                if vars(other).get(name, module) is value:
                    setattr(other, name, vars(module)[name])

    return rebind


@cache
def _real(path: str) -> str:
    """The file itself, where a package is linked to its place."""
    return os.path.realpath(path)


@cache
def _source_of(path: str) -> str:
    return Path(path).read_text(encoding="utf-8") if path.endswith(".py") else ""


def _imports_from(module: types.ModuleType, name: str) -> bool:
    path = getattr(module, "__file__", None) or ""
    return (
        path.startswith(str(ROOT))
        and ".venv" not in path
        and f"from {name} import" in _source_of(str(path))
    )


def _in_turn(items: list[pytest.Item]) -> Iterator[tuple[pytest.Item, pytest.Item | None]]:
    """Each with the one after it, so that what they share is made once."""
    for k, item in enumerate(items):
        yield item, items[k + 1] if k + 1 < len(items) else None


def _fails(session: pytest.Session, item: pytest.Item, following: pytest.Item | None) -> bool:
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


def _limit(cpu_s: float) -> None:
    used = resource.getrusage(resource.RUSAGE_SELF)
    until = int(used.ru_utime + used.ru_stime + cpu_s) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (until, until + 5))
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * resource.getpagesize() + MORE_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def _in_a_fork(run: Callable[[], dict[str, Any]], wall_s: float | None = None) -> Any:
    """What `run` returns in a process of its own; None if that has ended otherwise."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        status = FAILED
        try:
            os.close(reader)
            os.setpgid(0, 0)
            nothing = os.open(os.devnull, os.O_RDWR)
            for number in (0, 1, 2):
                os.dup2(nothing, number)
            text = json.dumps(run()).encode()
            with os.fdopen(writer, "wb") as pipe:
                pipe.write(text)
            status = 0
        finally:
            os._exit(status)
    os.close(writer)
    text = _read(reader, child, wall_s)
    _, status = os.waitpid(child, 0)
    return json.loads(text) if status == 0 and text else None


def _used_by(process: int) -> float:
    """Processor time of a process so far."""
    fields = Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _read(reader: int, child: int, wall_s: float | None) -> bytes:
    import select

    text, until_s = b"", None if wall_s is None else time.monotonic() + wall_s
    used_s = 0.0
    while True:
        left_s = None if until_s is None else max(0.0, until_s - time.monotonic())
        if not select.select([reader], [], [], left_s)[0]:
            before_s, used_s = used_s, _used_by(child)
            if wall_s is not None and used_s > before_s:
                until_s = time.monotonic() + wall_s  # it is the machine that is busy
                continue
            os.killpg(child, signal.SIGKILL)
            break
        part = os.read(reader, 1 << 16)
        if not part:
            break
        text += part
    os.close(reader)
    return text
