"""The notebooks of examples/ run and say what they are kept with; tools/notebooks.py keeps the same
bytes each time."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    """tools/notebooks.py, in a process of its own: a kernel's client warns of much."""
    command = [sys.executable, str(ROOT / "tools" / "notebooks.py"), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=1200)


def notebook(path: Path, *cells: str) -> Path:
    """A notebook without outputs."""
    made = [
        {"cell_type": "code", "id": f"c{number}", "source": cell, "metadata": {},
         "outputs": [], "execution_count": None}
        for number, cell in enumerate(cells)
    ]  # fmt: skip
    path.write_text(json.dumps({"cells": made, "metadata": {}, "nbformat": 4, "nbformat_minor": 5}))
    return path


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_says_what_it_is_kept_with(path: Path) -> None:
    done = run("--check", path)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_kept_notebook_has_pictures_and_nothing_of_the_machine_that_ran_it(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert path.stat().st_size < 1_000_000
    assert '"image/png"' in text
    kept = json.loads(text)
    assert set(kept["metadata"]["language_info"]) == {"name"}, "no version"
    for cell in kept["cells"]:
        assert cell["metadata"] == {}, "no times"
        cell.pop("source")
        for output in cell.get("outputs", ()):
            output.get("data", {}).pop("image/png", None)
    assert not re.search(r"/(home|root|tmp|work|usr)\b|0x[0-9a-f]{6}", json.dumps(kept))


def test_it_keeps_the_same_bytes_each_time(tmp_path: Path) -> None:
    draw = "import matplotlib.pyplot as plt\nplt.plot([1, 3])\nplt.show()"
    path = notebook(tmp_path / "a.ipynb", "print('one')\nprint('two')", draw)
    assert run(path).returncode == 0
    first = path.read_bytes()
    assert b'"image/png"' in first
    assert run(path).returncode == 0
    assert path.read_bytes() == first


def test_a_cell_that_fails_is_named_and_nothing_is_written(tmp_path: Path) -> None:
    path = notebook(tmp_path / "a.ipynb", "1", "1 / 0")
    before = path.read_bytes()
    done = run(path)
    assert done.returncode == 1
    assert "a.ipynb: cell 1: ZeroDivisionError: division by zero" in done.stderr
    assert path.read_bytes() == before


def test_another_text_than_the_kept_one_is_named(tmp_path: Path) -> None:
    path = notebook(tmp_path / "a.ipynb", "print('gap')")
    assert run(path).returncode == 0
    path.write_text(path.read_text().replace("print('gap')", "print('tooth')"))
    before = path.read_bytes()
    done = run("--check", path)
    assert done.returncode == 1
    assert "-cell 0: gap" in done.stderr and "+cell 0: tooth" in done.stderr
    assert path.read_bytes() == before
