"""The planted bugs can be planted, and say what they break and what catches them.

Whether they are caught takes a run of the tests for each: `make planted`.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from run_planted import ROOT, Planted, planted

LEAST = 30


def test_there_are_enough() -> None:
    assert len(planted()) >= LEAST


@pytest.mark.parametrize("bug", planted(), ids=lambda bug: bug.name)
def test_a_bug_fits_the_product_as_it_is(bug: Planted) -> None:
    assert bug.breaks
    for name in bug.tests:
        assert (ROOT / name).exists()
    text = bug.path.read_text(encoding="utf-8")
    path = text.split("\n--- a/", 1)[1].split("\n", 1)[0]
    removed = [line[1:] for line in text.splitlines() if line[:1] == "-" and line[:4] != "--- "]
    product = Path(ROOT / path).read_text(encoding="utf-8").splitlines()
    assert all(line in product for line in removed), f"{path} has changed: make it anew"
    fits = subprocess.run(
        ["git", "apply", "--check", str(bug.path)], cwd=ROOT, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert fits.returncode == 0, f"{fits.stderr}: make it anew"


def test_the_runner_says_which_are_not_there() -> None:
    done = subprocess.run(
        [sys.executable, str(Path(__file__).parent / "run_planted.py"), "no_such_bug"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert "0 of 0" in done.stdout
