"""The mutator: each mutant differs from the product in one place, is a program, and keeps its name.

Whether the tests catch them takes a run of its own: `make mutants`.
"""

from __future__ import annotations

import ast
import sys

import pytest
from hashes import Hashes
from line_map import Coverage, Tracer, ended_after
from mutator import Mutants
from run_mutants import BEGIN, HUNK, ROOT, equivalents, main, mutants_of, stale, table
from targets import TARGETS, Target

SOURCE = '''
LIMIT_US = 40_000
TWICE_US = 2 * LIMIT_US
class Kind(IntEnum):
    A = 1
def late(now_us, heard_us, deaf=False):
    """Not 1 mutated."""
    if deaf and -heard_us:
        raise ValueError(f"{now_us + 1}")
    self.count += 1
    return now_us - heard_us >= LIMIT_US or min(now_us, 3.0) < 0
'''
EXPECTED = {
    "-: LIMIT_US = 40000 => LIMIT_US = 50000",
    "-: LIMIT_US = 40000 => LIMIT_US = 30000",
    "-: TWICE_US = 2 * LIMIT_US => TWICE_US = 2 / LIMIT_US",
    "-: TWICE_US = 2 * LIMIT_US => TWICE_US = 3 * LIMIT_US",
    "-: TWICE_US = 2 * LIMIT_US => TWICE_US = 1 * LIMIT_US",
    "-: False => True",
    "late: if deaf and -heard_us => if True",
    "late: if deaf and -heard_us => if False",
    "late: deaf and -heard_us => deaf or -heard_us",
    "late: deaf and -heard_us => deaf and heard_us",
    "late: self.count += 1 => pass",
    "late: self.count += 1 => self.count -= 1",
    "late: self.count += 1 => self.count += 2",
    "late: self.count += 1 => self.count += 0",
}
RETURNED = "late: return now_us - heard_us >= LIMIT_US or min(now_us, 3.0) < 0 => return "
EXPECTED_RETURNS = {
    "None",
    "now_us - heard_us >= LIMIT_US and min(now_us, 3.0) < 0",
    "now_us + heard_us >= LIMIT_US or min(now_us, 3.0) < 0",
    "now_us - heard_us > LIMIT_US or min(now_us, 3.0) < 0",
    "now_us - heard_us < LIMIT_US or min(now_us, 3.0) < 0",
    "now_us - heard_us >= LIMIT_US or max(now_us, 3.0) < 0",
    "now_us - heard_us >= LIMIT_US or min(now_us, 3.75) < 0",
    "now_us - heard_us >= LIMIT_US or min(now_us, 3.0) <= 0",
    "now_us - heard_us >= LIMIT_US or min(now_us, 3.0) >= 0",
    "now_us - heard_us >= LIMIT_US or min(now_us, 3.0) < 1",
}


def test_the_mutants_of_a_source_are_these() -> None:
    names = [mutant.name.removeprefix("f.py::") for mutant in Mutants("f.py", SOURCE).all]
    assert sorted(names) == sorted(EXPECTED | {RETURNED + each for each in EXPECTED_RETURNS})


def test_only_constants_that_nothing_else_in_the_body_uses_are_rebound() -> None:
    of = {mutant.name: mutant.where.constants for mutant in Mutants("f.py", SOURCE).all}
    assert of["f.py::-: LIMIT_US = 40000 => LIMIT_US = 50000"] == ()
    assert of["f.py::-: TWICE_US = 2 * LIMIT_US => TWICE_US = 3 * LIMIT_US"] == ("TWICE_US",)


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_each_mutant_is_one_change_that_is_taken_back(target: Target) -> None:
    found = mutants_of(target)
    assert sum(map(len, found.values())) > 90
    for mutants in found.values():
        assert len({mutant.name for mutant in mutants}) == len(mutants)
    name, _ = min(found.items(), key=lambda each: (not each[1], len(each[1])))
    file = Mutants(name, (ROOT / name).read_text(encoding="utf-8"))
    before = ast.dump(file.tree)
    for mutant in file.all:
        mutant.apply()
        assert ast.dump(file.tree) != before
        compile(file.tree, name, "exec")
        mutant.undo()
    assert ast.dump(file.tree) == before


def test_every_listed_mutant_exists_and_has_a_reason() -> None:
    listed = equivalents()
    assert stale(listed) == []
    assert all(len(reason) > 20 for reason in listed.values())


def test_lines_of_a_change_are_read_from_its_hunks() -> None:
    text = "@@ -3,2 +5,3 @@ def f():\n@@ -9 +12 @@\n@@ -20,2 +22,0 @@\n"
    assert [(int(m[1]), int(m[2] or 1)) for m in HUNK.finditer(text)] == [(5, 3), (12, 1), (22, 0)]


def test_a_result_holds_while_its_code_and_the_test_that_caught_it_are_the_same() -> None:
    hashes = Hashes(TARGETS[0])
    mutant, test = "controller/guard/case.py::f: 1 => 2", "tests/controller/test_guard.py::test_it"
    for by in (test, "", "never ends"):
        found = {"mutant": mutant, "by": by, **hashes.of(mutant, by)}
        assert hashes.hold(found)
        for key in ("code", "tests"):
            assert not hashes.hold(found | {key: "another"})
            assert not hashes.hold({name: each for name, each in found.items() if name != key})
    caught = {"mutant": mutant, "by": test, **hashes.of(mutant, test)}
    survived = {"mutant": mutant, "by": "", **hashes.of(mutant, "")}
    hashes.all_tests = "another"
    assert hashes.hold(caught)
    assert not hashes.hold(survived)
    hashes.code["controller/guard/case.py"] = "another"
    assert not hashes.hold(caught)


def test_the_document_counts_the_mutants_that_there_are() -> None:
    """What the runs came to is written by them; how many there are and are listed is held here."""
    said = (ROOT / "docs/safety.md").read_text(encoding="utf-8").partition(BEGIN)[2]
    counts = [line.split("|")[1:4] for line in table(equivalents()).splitlines()]
    there = [line.split("|")[1:4] for line in said.strip().splitlines()[: len(counts)]]
    assert there == counts


def test_a_run_without_a_branch_to_compare_with_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--changed", "no/such-branch"]) == 0
    assert (
        capsys.readouterr().out == "no no/such-branch to compare with here: no mutants are made\n"
    )


def test_a_run_of_nothing_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--only", "no mutant is called so", "valves"]) == 0
    assert "no mutants to run\n" in capsys.readouterr().out


def test_a_constant_is_tried_by_what_runs_a_function_that_names_it() -> None:
    file = "controller/guard/own_clock.py"
    lines = {str(path): dict[str, list[int]]() for path in ROOT.glob("controller/guard/*.py")}
    used = [number for number, line in enumerate((ROOT / file).read_text().splitlines(), 1)
            if "CAUGHT_UP_US" in line and not line.startswith("CAUGHT_UP_US")]  # fmt: skip
    lines[str(ROOT / file)] = {"uses it": [used[0]], "runs another line": [1]}
    lines[str(ROOT / "controller/guard/view.py")] = {"elsewhere": [300]}
    covered = Coverage(lines, {"uses it": 1.0, "runs another line": 0.1, "elsewhere": 0.1})
    assert covered.tests_of_constants(str(ROOT / file), ["CAUGHT_UP_US"], 15.0) == ["uses it"]


def test_a_test_is_expected_to_make_what_its_file_s_tests_share() -> None:
    seconds = {"a.py::first": 4.0, "a.py::second": 0.5, "b.py::alone": 1.0}
    covered = Coverage({}, seconds)
    assert covered.expected_s(["a.py::second"]) == 4.5
    assert covered.expected_s(["a.py::first", "b.py::alone"]) == 5.0 + 5.0


def runs_often(count: int) -> int:
    """Looked at below: its last line but one is run at the end alone."""
    total = 0
    for k in range(count):
        total += k
    if total > 40:
        total = -total
    return total


def test_a_line_that_runs_once_in_a_thousand_calls_is_seen() -> None:
    """And a function all of whose lines were seen is looked at no more."""
    tracer, seen = Tracer([__file__]), {__file__: set[int]()}
    tracer.begin(seen)
    sys.settrace(tracer.on_call)
    try:
        for count in [3] * 999 + [10]:
            runs_often(count)
    finally:
        sys.settrace(None)
    code = runs_often.__code__
    lines = {line for _, _, line in code.co_lines() if line is not None} - {code.co_firstlineno}
    assert lines <= seen[__file__]

    class Frame:
        f_code = code

    assert tracer.on_call(Frame, "call", None) is None  # type: ignore[arg-type]


def test_a_test_that_takes_too_long_is_ended() -> None:
    late: list[int] = []
    with pytest.raises(pytest.skip.Exception), ended_after(0.05, late):
        while True:
            pass
    assert late
    with ended_after(30.0, late):
        pass
    assert len(late) == 1
