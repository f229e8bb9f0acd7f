"""Logs of live runs are stamped in bus time, however it runs against the wall clock."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import can
import pytest
from live_shift import one_shift

from meshpoint.bench.live import run_live
from meshpoint.bus.clock import Clock, NodeClock
from meshpoint.bus.frames import message_of
from meshpoint.bus.logs.bus_stamps import BusStamps
from meshpoint.bus.logs.reader import read_log
from meshpoint.bus.pace import PacedClock, PaceFile
from meshpoint.cli.main import main
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox import load_sheet
from meshpoint.logs.log_clock import LogClockFit

SHEET = load_sheet("thesis")
BEGAN_S = 1.7e9


def stamps_of(clock: NodeClock, moves: Callable[[int], float]) -> list[float]:
    """What three messages are stamped with; moves(k): goes on to the k-th, and says the wall
    clock's time then, by which the bus has stamped it."""
    taken: list[can.Message] = []
    stamps = BusStamps(clock, taken.append)
    for k in range(3):
        stamps(message_of(Frame(0x18FF0180, b""), BEGAN_S + moves(k)))
    return [message.timestamp - BEGAN_S for message in taken]


def test_a_bus_time_that_waits_stamps_by_itself(tmp_path: Path) -> None:
    pace = PaceFile.create(tmp_path / "pace")

    def moves(k: int) -> float:
        pace.set_now((5_000_000, 5_010_000, 5_020_000)[k])
        return (0.0, 0.01, 0.45)[k]

    stamps = stamps_of(PacedClock(pace, "bench"), moves)
    assert stamps == pytest.approx([0.0, 0.01, 0.02], abs=1e-6)


@pytest.mark.parametrize(("speed", "last_s"), [(1.0, 0.45), (0.5, 0.225), (4.0, 1.8)])
def test_a_bus_time_of_another_speed_stamps_at_that_speed(speed: float, last_s: float) -> None:
    stamps = stamps_of(Clock(speed), lambda k: (0.0, 0.01, 0.45)[k])
    assert stamps == pytest.approx([0.0, speed * 0.01, last_s], abs=1e-6)


def test_a_live_run_s_log_is_by_the_clock_of_its_sensors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One shift with bus time at a quarter of the wall's: read by read the log goes on as the
    sensors do, and it is repeated to the byte."""
    run = one_shift(tmp_path, SHEET, 0.25)
    result = asyncio.run(run_live(run))
    assert [row.result for row in result.monitor.rows.rows] == ["engaged"]
    fit = LogClockFit()
    for time_s, frame in read_log(run.log):
        fit.take(time_s, frame)
    (part,) = fit.finish().parts
    assert part.seconds > 0.5
    assert part.kind == "alike"
    assert main(["replay", str(run.log), "--verify"]) == 0
    assert "identical: " in capsys.readouterr().out
