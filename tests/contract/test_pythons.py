"""The Pythons that are named are those that are run; the controller's bytes are the same in all."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from meshpoint.kernels.cache import SERVED

ROOT = Path(__file__).parents[2]
NAMED = re.compile(r"Programming Language :: Python :: (3\.\d+)")
HERE = "{}.{}".format(*sys.version_info)


def classified() -> list[str]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    found = [NAMED.fullmatch(each) for each in project["classifiers"]]
    return [each[1] for each in found if each]


def run(*command: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command, cwd=ROOT, env=os.environ | variables, capture_output=True, text=True
    )


def test_what_is_named_is_started_and_the_next_one_before_it_is_named() -> None:
    started = run("tools/test-pythons", "--list").stdout.split()
    assert len(classified()) >= 3
    assert started[:-1] == classified()
    assert int(started[-1].split(".")[1]) == int(started[-2].split(".")[1]) + 1
    workflows = ROOT / ".github" / "workflows"
    everywhere = (workflows / "everywhere.yml").read_text(encoding="utf-8")
    (matrix,) = re.findall(r"^ +python: \[(.*)\]$", everywhere, re.MULTILINE)
    assert re.findall(r"3\.\d+", matrix) == started
    assert "run: tools/test-pythons --whole dist/*.whl" in everywhere
    for caller in ("ci.yml", "release.yml"):
        text = (workflows / caller).read_text(encoding="utf-8")
        assert "uses: ./.github/workflows/everywhere.yml\n" in text
    assert "\nbeside pythons\n" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")


def test_a_wheels_kernels_serve_what_is_named() -> None:
    assert ["{}.{}".format(*each) for each in SERVED] == classified()


def test_a_python_that_is_not_here_is_said_and_running_none_is_a_failure() -> None:
    done = run("tools/test-pythons", "README.md", "3.99")
    assert done.stdout == "Python 3.99: not on this machine, not run\n"
    assert done.returncode == 1, done.stderr


@pytest.fixture
def shims(tmp_path: Path) -> str:
    """A path with a command that fails where another version is chosen, and pyenv, which has it."""
    home = tmp_path / "pyenv" / "versions" / f"{HERE}.9" / "bin"
    home.mkdir(parents=True)
    (home / "python").symlink_to(sys.executable)
    commands = tmp_path / "bin"
    commands.mkdir()
    for name, text in ((f"python{HERE}", "exit 127"), ("pyenv", f"echo {tmp_path}/pyenv")):
        (commands / name).write_text(f"#!/bin/sh\n{text}\n")
        (commands / name).chmod(0o755)
    return os.pathsep.join((str(commands), os.environ["PATH"]))


def test_a_python_behind_shims_is_found(shims: str, tmp_path: Path) -> None:
    found = run("tools/python-of", HERE, PATH=shims, PYTHON="false")
    assert found.returncode == 0
    assert Path(found.stdout.strip()) == tmp_path / "pyenv" / "versions" / f"{HERE}.9/bin/python"
    assert run("tools/python-of", "3.99", PATH=shims).returncode == 3


WHOLE = {
    "controller/guard/own_speed.py: sum(took_us)",
    "controller/estimate/reference.py: sum((1 << gear - 1 for gear in self._offset_rad))",
    "controller/sleeve/driven.py: sum((one.time_us <= switch.time_us for one in self.switches))",
}
"""Sums of integers."""


def test_the_controller_adds_no_floats_by_sum() -> None:
    """From Python 3.12 on `sum` compensates: the last bit is another than in 3.11. That of
    `math.fsum` is the same in all."""
    found = {
        f"{path.relative_to(ROOT)}: {ast.unparse(node)}"
        for path in (ROOT / "controller").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and ast.unparse(node.func) in ("sum", "statistics.mean")
    }
    assert found == WHOLE
