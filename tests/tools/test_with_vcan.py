"""What tools/with-vcan and examples/vcan.sh answer to a wrong call; at work they are in tests/vcan
and by `make vcan-alone`."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="SocketCAN, and so tools/with-vcan, is Linux's"
)


def run(script: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(ROOT / script), *arguments], stdin=subprocess.DEVNULL, capture_output=True, text=True,
        check=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "no command given"),
        (["--nonsense"], "unknown option --nonsense (see --help)"),
        (["--timeout", "soon", "true"], "--timeout takes a whole number, not 'soon'"),
        (["--cpus"], "--cpus needs a value"),
        (["--check", "true"], "--check runs nothing"),
        (["--keep", "/proc", "true"], "share a directory of your own"),
    ],
)
def test_what_is_wrong_with_the_call_is_said(arguments: list[str], said: str) -> None:
    done = run("tools/with-vcan", *arguments)
    assert done.returncode == 125
    assert said in done.stderr
    assert all(line.startswith("with-vcan: ") for line in done.stderr.splitlines())


def test_help_has_every_exit_code_in_80_columns() -> None:
    done = run("tools/with-vcan", "--help")
    assert done.returncode == 0
    assert max(len(line) for line in done.stdout.splitlines()) <= 80
    codes = done.stdout.split("Exit status")[1].split("Files")[0]
    assert set(re.findall(r"\b(?:12[4-7]|128\+N|[03])\b", codes)) == {
        "124", "125", "126", "127", "128+N", "0", "3",
    }  # fmt: skip


def test_the_workflow_installs_as_the_runners_user() -> None:
    """By `sudo tools/with-vcan` the guest's kernel would be fetched into root's home."""
    for name in (".github/workflows/ci.yml", "docs/ci.md", "Makefile"):
        assert not re.search(r"sudo +(\S*/)?with-vcan", (ROOT / name).read_text()), name


@pytest.mark.parametrize("arguments", [["15"], ["0"], ["four"], ["4", "out", "more"]])
def test_the_example_takes_gears_1_to_14(arguments: list[str]) -> None:
    done = run("examples/vcan.sh", *arguments)
    assert done.returncode == 2
    assert "GEAR 1 to 14" in done.stderr
