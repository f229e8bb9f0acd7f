"""The demo's limits: which side was late is said, and the run has failed, not its arguments."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Sequence
from pathlib import Path

import can
import pytest
from live_shift import one_shift

from meshpoint.base.errors import RunError
from meshpoint.bench import live
from meshpoint.bench.live import LiveRun, run_live
from meshpoint.bus.local.register import register_interface
from meshpoint.bus.logs.reader import read_log
from meshpoint.bus.profile import WireProfile
from meshpoint.cli.main import main
from meshpoint.controller.settings.header import new_header
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.replays.replay import LogReplay
from meshpoint.rig_sim.settings import RigSettings

SHEET = load_sheet("truck12")


def a_run(folder: Path) -> LiveRun:
    register_interface()
    channel = f"unix:{folder / 'bus.sock'}"
    return LiveRun(
        header=new_header("0", SHEET, ControllerSettings()),
        rig=RigSettings(),
        plan=[],
        log=folder / "run.log",
        open_bus=lambda: can.Bus(interface="meshpoint", channel=channel),
        speed=1.0,
        in_process=False,
    )


def nodes_that(script: str) -> object:
    async def spawn(_arguments: Sequence[str]) -> asyncio.subprocess.Process:
        return await asyncio.create_subprocess_exec(sys.executable, "-c", script)

    return spawn


def test_nodes_that_say_nothing_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "_spawn", nodes_that("import time; time.sleep(1e6)"))
    monkeypatch.setattr(live, "START_S", 1.0)
    with pytest.raises(RunError, match=r"rig and controller not heard .* start it by hand"):
        asyncio.run(run_live(a_run(tmp_path)))


def test_a_node_that_ends_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "_spawn", nodes_that("raise SystemExit(7)"))
    with pytest.raises(RunError, match="ended by itself with exit code 7"):
        asyncio.run(run_live(a_run(tmp_path)))


@pytest.mark.check
def test_a_run_that_failed_ends_with_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(live, "_spawn", nodes_that("raise SystemExit(7)"))
    assert main(["demo", "--shifts", "1", "--out", str(tmp_path / "out")]) == 1
    assert "ended by itself" in capsys.readouterr().err


def test_a_live_run_on_a_classic_bus_is_shown_and_verified(tmp_path: Path) -> None:
    """One shift, all nodes in this process: the bench hears its outcome, the log holds frames of
    8 bytes alone, and is repeated to the byte."""
    run = one_shift(tmp_path, SHEET, 1.0, WireProfile.CLASSIC)
    result = asyncio.run(run_live(run))
    assert [row.result for row in result.monitor.rows.rows] == ["engaged"]
    logged = [frame for _, frame in read_log(run.log)]
    assert not any(frame.is_fd or len(frame.data) > 8 for frame in logged)
    (session,) = LogReplay(tmp_path, verify=True).run(logged)
    assert str(session).startswith("identical: ")
    assert session.steps > 50
