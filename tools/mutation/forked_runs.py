"""A plugin of pytest: it runs the tests not once, but for each mutant those that cover it.

    pytest -p forked_runs ... with MUTATION_TASK naming a JSON file

All tests are collected and all modules loaded once; each mutant then lives in a forked process,
where the code of its function is replaced, or a constant of its module. A mutant elsewhere (a
table, the fields of a class) gets a process of its own that imports the mutated
file.
"""

from __future__ import annotations

import ast
import gc
import os
import subprocess
import sys
import time
import types
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, Final

import pytest
from first_failure import judge_by_first_failure
from forks import FAILED, in_a_fork, limit, used_s
from line_map import Coverage, Task, fails, in_turn, real
from mutator import Mutant, Mutants, Where
from targets import NOT_IMPORTED, ROOT, caught_by

TASK: Final = "MUTATION_TASK"
KILLED, SURVIVED, UNCOVERED = "killed", "survived", "uncovered"
SPARE_S: Final = 1.0
TIMES: Final = 5.0
"""Beyond this many times its tests' own time, and the spare, a mutant never ends."""
WALL_TIMES: Final = 20.0
"""Nor does one that for this many times as long has used no processor at all."""
START_S: Final = 30.0
"""What a process of its own takes to load, at most, on a busy machine (processor time)."""


@pytest.hookimpl(trylast=True)
def pytest_configure() -> None:
    """Before the tests are loaded: that one example fails is all that is asked."""
    judge_by_first_failure()


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> bool | None:
    """In place of the run."""
    if TASK not in os.environ:
        return None
    if session.testsfailed:
        raise session.Interrupted("errors while the tests were collected")
    task = Task(Path(os.environ[TASK]))
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
    from meshpoint.controller.run.warm_up import warm_up
    from meshpoint.gearbox import load_sheet
    from meshpoint.rig_sim.presets import build_world
    from meshpoint.rig_sim.settings import RigSettings

    warm_up(baselines=True)
    build_world(load_sheet("truck12"), RigSettings())


class _Runner:
    def __init__(self, task: Task, session: pytest.Session, covered: Coverage) -> None:
        self._task, self._session, self._covered = task, session, covered
        self._items = {item.nodeid: item for item in session.items}
        self._functions: dict[tuple[str, str, int], list[types.FunctionType]] = {}
        for each in gc.get_objects():
            if isinstance(each, types.FunctionType):
                code = each.__code__
                key = (real(code.co_filename), code.co_qualname, code.co_firstlineno)
                self._functions.setdefault(key, []).append(each)
        gc.freeze()  # a collection in a forked process would copy every page it looks at

    def run(self, mutants: Mutants, mutant: Mutant, path: Path) -> None:
        """One mutant; what came of it is reported."""
        where = mutant.where
        lines = where.lines if where.qualname else range(0)
        budget_s = self._task.budget_s
        if where.constants:
            tests = self._covered.tests_of_constants(str(path), where.constants, budget_s)
        else:
            tests = self._covered.tests_for(str(path), lines, budget_s)
        begun_s = used_s()
        if not tests:
            self._task.tell(mutant=mutant.name, outcome=UNCOVERED, by="", cpu_s=0.0)
            return
        expected_s = self._covered.expected_s(tests)
        mutant.apply()
        try:
            change = self._change(mutants, where, path)
            if change is None:
                by = self._by_itself(mutants, path, tests, expected_s)
            else:
                by = self._forked(change, tests, expected_s)
        finally:
            mutant.undo()
        cpu_s = round(used_s() - begun_s, 2)
        outcome = KILLED if by else SURVIVED
        if by in self._items:
            self._covered.note_caught(by)
        self._task.tell(mutant=mutant.name, outcome=outcome, by=by, cpu_s=cpu_s, count=len(tests))

    def _change(self, mutants: Mutants, where: Where, path: Path) -> Callable[[], None] | None:
        """What makes the mutant in a process that has loaded everything; None where that needs a
        process of its own."""
        if where.constants:
            return _rebinding(mutants, where, path)
        key = (str(path), where.qualname, where.first_line)
        is_replaced = where.is_plain and where.qualname
        functions = self._functions.get(key, []) if is_replaced else []
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
            limit(TIMES * expected_s + SPARE_S)
            change()
            for item, following in in_turn(items):
                if fails(self._session, item, following):
                    return {"by": item.nodeid}
            return {"by": ""}

        done = in_a_fork(run, WALL_TIMES * (expected_s + SPARE_S))
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
                preexec_fn=lambda: limit(TIMES * expected_s + START_S),
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return "never ends"
        if done.returncode == NOT_IMPORTED:
            raise RuntimeError(f"{path} was not imported as a mutant")
        if done.returncode == FAILED and caught_by(source).exists():
            return caught_by(source).read_text(encoding="utf-8")
        return "" if done.returncode == 0 else f"a process of its own, exit code {done.returncode}"


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
    module = next((m for m, file in named if real(file) == str(path)), None)
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
def _source_of(path: str) -> str:
    return Path(path).read_text(encoding="utf-8") if path.endswith(".py") else ""


def _imports_from(module: types.ModuleType, name: str) -> bool:
    path = getattr(module, "__file__", None) or ""
    return (
        path.startswith(str(ROOT))
        and ".venv" not in path
        and f"from {name} import" in _source_of(str(path))
    )
