"""A quiet node is waited for by its own time and by bus time, never by the wall clock."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import time

import pytest

from meshpoint.bench.compiling import FIRST_LINE, KERNELS, Progress, why_compiled
from meshpoint.bench.node_patience import (
    NODE_QUIET_US,
    SHIFT_SILENCE_US,
    Heard,
    OwnTime,
    Taken,
    no_shift,
    not_started,
    taken,
)
from meshpoint.bus.slowness import times_slower


def test_a_node_without_a_processor_is_given_more_time() -> None:
    own = OwnTime()
    for _ in range(1000):
        own.look(Taken(1.0, "R"), 0.05)
    assert own.seconds == pytest.approx(0.05)  # the first look has nothing to compare with


def test_a_node_that_works_is_charged_what_it_used() -> None:
    own = OwnTime()
    for k in range(101):
        own.look(Taken(0.01 * k, "R"), 0.05)
    assert own.seconds == pytest.approx(0.05 + 1.0)


def test_a_node_that_asks_for_no_processor_hangs_and_is_charged_all() -> None:
    own = OwnTime()
    for _ in range(100):
        own.look(Taken(1.0, "S"), 0.05)
    assert own.seconds == pytest.approx(5.0)


def test_where_the_system_does_not_tell_all_time_counts() -> None:
    own = OwnTime()
    for _ in range(100):
        own.look(None, 0.05)
    assert own.seconds == pytest.approx(5.0)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux says what a process has had")
def test_the_kernel_tells_what_a_process_has_had() -> None:
    before = taken(os.getpid())
    begun_s = time.process_time()
    while time.process_time() - begun_s < 0.1:
        pass
    after = taken(os.getpid())
    assert before is not None and after is not None
    assert after.processor_s > before.processor_s
    assert taken(2**22 + 1) is None


def test_a_machine_that_computes_slowly_is_given_more_time() -> None:
    readings = iter([5.0, 5.0 + 0.12, 7.0, 7.0 + 1e-6])
    assert times_slower(lambda: next(readings)) == pytest.approx(120.0)
    assert times_slower(lambda: next(readings)) == 1.0
    assert 1.0 <= times_slower() < 1000.0


def test_the_side_that_is_silent_is_named() -> None:
    heard = Heard()
    assert heard.missing() == ["rig", "controller"]
    heard.frames["rig"] = 1
    assert heard.missing() == ["controller"]
    for now_us in range(0, 2 * NODE_QUIET_US, 10_000):
        heard.frames["rig"] += 1
        heard.frames["controller"] += now_us == 0
        heard.look(now_us)
    assert heard.silent(2 * NODE_QUIET_US) == ["controller"]


def test_a_limit_that_runs_out_says_which_side_and_what_to_do() -> None:
    assert "controller not heard" in not_started(["controller"], 2400.0)
    assert "2400 s of time to run" in not_started(["controller"], 2400.0)
    assert "meshpoint controller" in not_started(["controller"], 120.0)
    seconds = SHIFT_SILENCE_US // 1_000_000
    assert f"{seconds} s of bus time: rig silent" in no_shift(["rig"], paced=True)
    assert "--wall-clock" in no_shift([], paced=False)
    assert "--wall-clock" not in no_shift([], paced=True)


def test_compiling_is_shown_and_nothing_without_it() -> None:
    out = io.StringIO()
    progress = Progress(out, total=4)
    progress.take("rig_sim.parts.cylinder.run_ahead")
    progress.close()
    assert out.getvalue() == ""
    progress.count("rig_sim.truck.kernels.advance")
    progress.count("controller.measure.gate_kernels.gate_edges")
    progress.take("controller.measure.gate_kernels.gate_edges")
    progress.take("controller.measure.gate_kernels.gate_edges")  # by another process too
    progress.close()
    lines = out.getvalue().splitlines()
    assert lines[0].startswith("compiling kernels, once on this machine")
    assert "about ten seconds" not in lines[0], "beside other work it takes several times that"
    assert lines[-1].startswith("compiling kernels [##########..........] 2 of 4, ")
    assert lines[-1].endswith(" s, done")
    assert progress.compiled == 2


def test_on_a_terminal_it_is_shown_what_is_compiled_now_in_one_line() -> None:
    out = io.StringIO()
    progress = Progress(out, rewrites=True, total=3)
    for number in range(9):
        progress.count(f"rig_sim.truck.kernels.advance_{number}")
    shown = out.getvalue().split("\r\033[K")
    assert shown[2].endswith(" s: advance_0, advance_1")
    assert all(len(line) < 80 and "\n" not in line for line in shown[2:])


@pytest.mark.parametrize(
    ("came", "served", "said"),
    [
        (False, ((3, 11),), ""),
        (True, ((3, 9), (3, 10)), "are for Python 3.9 to 3.10"),
        (True, (sys.version_info[:2],), "python -m meshpoint.constraints"),
    ],
)
def test_it_is_said_why_the_wheels_kernels_do_not_serve(
    came: bool, served: tuple[tuple[int, int], ...], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("meshpoint.kernels.folder.has_shipped", lambda: came)
    monkeypatch.setattr("meshpoint.kernels.cache.has_shipped", lambda: came)
    monkeypatch.setattr("meshpoint.kernels.cache.SERVED", served)
    assert said in why_compiled() and bool(said) == bool(why_compiled())
    assert max(map(len, (FIRST_LINE + why_compiled()).splitlines())) < 100


def test_as_many_kernels_are_counted_as_there_are() -> None:
    """Those that keep what is compiled of them; the bar ends where it should."""
    script = """
import gc
from meshpoint.kernels.cache import KernelCache
import meshpoint.controller.run.warm_up, meshpoint.rig_sim.presets
print(sum(isinstance(each, KernelCache) for each in gc.get_objects()))
"""
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert int(found.stdout) == sum(KERNELS.values()), found.stderr
