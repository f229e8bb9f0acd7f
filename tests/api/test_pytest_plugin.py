"""The plugin as a user has it: other test files, run by pytest inside pytest."""

from __future__ import annotations

import dataclasses
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from _pytest.pytester import SysModulesSnapshot

import meshpoint
from meshpoint.pytest_plugin import Benches

pytest_plugins = ["pytester"]
ROOT = Path(__file__).parents[2]
TEN = ROOT / "examples" / "test_shifts.py"
HEAVY = (
    "numpy",
    "can",
    "cantools",
    "numba",
    "meshpoint.api",
    "meshpoint.base",
    "meshpoint.results",
)


@pytest.fixture
def inner(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> pytest.Pytester:
    """A folder for a user's tests; its pytest knows nothing of this one's settings."""
    monkeypatch.setenv("PYTEST_ADDOPTS", "-p no:cacheprovider -p no:xdist -p no:asyncio")
    monkeypatch.setattr(SysModulesSnapshot, "restore", forget_tests)
    return pytester


def forget_tests(_snapshot: SysModulesSnapshot) -> None:
    """pytester forgets every module that the inner pytest was first to load; numpy and numba cannot
    be loaded a second time."""
    here = Path(__file__).parent
    for name, module in list(sys.modules.items()):
        file = getattr(module, "__file__", None)
        if name.startswith("test_") and file and here not in Path(file).parents:
            del sys.modules[name]


def test_the_same_ten_tests_pass_in_virtual_time(inner: pytest.Pytester) -> None:
    shutil.copy(TEN, inner.path)
    inner.runpytest_inprocess().assert_outcomes(passed=10)


@pytest.mark.parametrize("page", ["pytest.md", "ci.md"])
def test_the_first_test_of_a_page_passes_as_it_stands_there(
    page: str, inner: pytest.Pytester
) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / page).read_text(), re.DOTALL)
    inner.makepyfile(test_of_the_page=next(text for text in blocks if "def test_" in text))
    inner.runpytest_inprocess().assert_outcomes(passed=1)


def test_the_page_names_figures_that_a_shift_has_aborts_among_them() -> None:
    page = (ROOT / "docs" / "pytest.md").read_text()
    named = set(re.findall(r"`shift\.(\w+)`", page))
    assert named >= {"contact", "attempts", "aborts", "halt_mm"}
    assert named <= {field.name for field in dataclasses.fields(meshpoint.ShiftRow)}


@pytest.mark.long
def test_the_same_ten_tests_pass_live_on_a_bus(inner: pytest.Pytester) -> None:
    """As with processes, but that the nodes need not be loaded anew (`tests/acceptance`)."""
    shutil.copy(TEN, inner.path)
    live = ["--meshpoint-backend=processes", "--meshpoint-in-process"]
    inner.runpytest_inprocess(*live).assert_outcomes(passed=10)


def test_a_failing_test_leaves_log_report_and_commands(inner: pytest.Pytester) -> None:
    inner.makepyfile(
        test_mine="""
        import pytest

        @pytest.mark.meshpoint(preset="thesis")
        def test_it(bench):
            assert bench.shift(10).contact == "nothing"

        def test_without_a_bench():
            assert 0
        """
    )
    result = inner.runpytest_inprocess("--meshpoint-out=left")
    result.assert_outcomes(failed=2)
    folder = Path("left") / "test_mine.py.test_it"
    result.stdout.fnmatch_lines(
        [
            "*- meshpoint -*",
            "at 1.* s of bus time, after 1 shift",
            f"log     {folder / 'run.log'}",
            f"report  {folder / 'report.html'}",
            f"replay  meshpoint replay {folder / 'run.log'} --verify",
        ]
    )
    assert [path.name for path in (inner.path / "left").iterdir()] == [folder.name]
    assert "gear 8 to 10" in (inner.path / folder / "report.html").read_text()
    replayed = meshpoint.replay(inner.path / folder / "run.log")
    assert replayed.verdict is meshpoint.Verification.IDENTICAL
    assert len(replayed.shifts) == 1


def test_a_bench_of_ones_own_unless_it_is_shared(inner: pytest.Pytester) -> None:
    inner.makepyfile(
        """
        import pytest

        seen = []
        pytestmark = pytest.mark.meshpoint(preset="thesis", seed=4)

        @pytest.mark.parametrize("number", [1, 2])
        def test_own(bench, number):
            bench.run_for(0.01)
            assert bench.now_s == pytest.approx(0.01)

        @pytest.mark.meshpoint(shared=True, gear=10)
        @pytest.mark.parametrize("number", [1, 2])
        def test_shared(bench, number):
            seen.append(bench)
            assert bench.gear == 10 and bench is seen[0]

        @pytest.mark.meshpoint(shared=True, gear=7)
        def test_shared_with_others(bench):
            assert bench is not seen[0]
            with pytest.raises(RuntimeError, match="closed"):
                seen[0].step()
        """
    )
    inner.runpytest_inprocess().assert_outcomes(passed=5)


def test_an_adapter_must_be_named(inner: pytest.Pytester) -> None:
    inner.makepyfile("def test_it(bench): pass")
    result = inner.runpytest_inprocess("--meshpoint-backend=adapter")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["*adapter needs --meshpoint-interface*"])


class Chosen:
    """A command line."""

    def __init__(self, **options: Any) -> None:
        usual = {"speed": 1.0, "in_process": False, "start": "rig,controller"}
        self._options = usual | options

    def getoption(self, name: str) -> Any:
        return self._options.get(name.removeprefix("--meshpoint-").replace("-", "_"))


@pytest.mark.parametrize(
    ("options", "interface", "channel", "start"),
    [
        ({"backend": "vcan"}, "socketcan", "vcan0", ("rig", "controller")),
        ({"backend": "vcan", "channel": "vcan7"}, "socketcan", "vcan7", ("rig", "controller")),
        ({"backend": "adapter", "interface": "pcan", "start": "rig"}, "pcan", None, ("rig",)),
        ({"backend": "adapter", "interface": "pcan", "start": "none"}, "pcan", None, ()),
    ],
)
def test_what_a_live_bench_is_made_with(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    options: dict[str, Any],
    interface: str,
    channel: str | None,
    start: tuple[str, ...],
) -> None:
    made: list[dict[str, Any]] = []
    monkeypatch.setattr(meshpoint, "LiveBench", lambda **given: made.append(given), raising=False)
    benches = Benches(Chosen(**options), tmp_path)
    benches.make({"seed": 7})
    assert made[0]["interface"] == interface and made[0]["channel"] == channel
    assert made[0]["start"] == start
    assert made[0]["seed"] == 7 and made[0]["log"].name == "run.log"


def test_a_run_that_asks_for_no_bench_loads_nothing() -> None:
    code = f"import sys, meshpoint.pytest_plugin; print([m for m in {HEAVY} if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
