"""The pytest plugin on two processes: the same ten tests as in virtual time."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_the_same_ten_tests_pass_on_two_processes(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", "/dev/null"]
    live = ["--meshpoint-backend", "processes", "--meshpoint-out", str(tmp_path / "left")]
    ran = subprocess.run(
        [*command, *live, str(EXAMPLES / "test_shifts.py")],
        capture_output=True, text=True, cwd=tmp_path, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "10 passed" in ran.stdout
