"""`simulate --bus-load`: frames come when the bus lets them, within the bounds, and shifts work."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from meshpoint.base.exits import Exit
from meshpoint.bench.loaded_bus import own_load
from meshpoint.bench.simulate import Setup, simulate
from meshpoint.bus.simulated.core import QueueOrder
from meshpoint.bus.simulated.filler import FillerTraffic, draw_filler
from meshpoint.bus.simulated.frame_bits import BitTiming
from meshpoint.cli.main import main
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.schema import SCHEMA
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset

OURS = {spec.can_id for spec in SCHEMA.messages}


def setup(load: float, order: QueueOrder = QueueOrder.FIFO, shifts: int = 2) -> Setup:
    return Setup(
        load_sheet("thesis"), ControllerSettings(), Preset.THESIS, seed=3, shifts=shifts,
        bus_load=load, bus_queue=order,
    )  # fmt: skip


@pytest.mark.parametrize("load", [pytest.param(0.8, marks=pytest.mark.long), 0.9])
def test_the_load_is_the_one_asked_for_and_responses_are_within_their_bounds(load: float) -> None:
    frames: list[tuple[int, Frame]] = []
    result = simulate(
        setup(load, QueueOrder.PRIORITY, shifts=1),
        lambda time_us, frame: frames.append((time_us, frame)),
    )
    assert result.bus_load == pytest.approx(load, abs=0.03)
    assert [row.result for row in result.rows] == ["engaged"]
    assert result.bus is not None
    assert result.bus["refused"] == 0
    responses = result.bus["worst_response_ms"]
    assert {"ValveCommand", "EdgesMainRise", "ControllerStatus"} <= set(responses)
    for name, figures in responses.items():
        assert figures["bound"] is None or figures["measured"] <= figures["bound"], name
    assert responses["EdgesMainRise"]["bound"] is not None
    others = [frame for _, frame in frames if frame.can_id not in OURS]
    assert len(others) > 0.02 * len(frames)


def test_a_queue_in_order_works_as_well() -> None:
    result = simulate(setup(0.8, shifts=1))
    assert [row.result for row in result.rows] == ["engaged"]
    assert result.bus is not None
    assert result.bus["queue_order"] == "fifo"


def test_a_load_below_our_own_adds_nothing() -> None:
    result = simulate(setup(0.3, shifts=1))
    assert result.bus is not None
    assert result.bus["other_messages"] == 0
    assert result.bus_load == pytest.approx(own_load(), abs=0.03)


def test_the_same_seed_gives_the_same_traffic() -> None:
    timing = BitTiming()
    drawn = [draw_filler(5, 0.2, timing) for _ in range(2)]
    assert drawn[0] == drawn[1] != draw_filler(6, 0.2, timing)
    taken = [FillerTraffic(drawn[0], 5) for _ in range(2)]
    assert [taken[0].take() for _ in range(50)] == [taken[1].take() for _ in range(50)]
    share = sum(filler.mean_ns / filler.period_ns for filler in drawn[0])
    assert share == pytest.approx(0.2, rel=0.02)
    assert not {filler.frame.can_id for filler in drawn[0]} & OURS


def test_a_log_with_other_nodes_frames_is_verifiable(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, run = tmp_path / "x.log", tmp_path / "run.json"
    arguments = ["--preset", "thesis", "--shifts", "1", "--seed", "3", "--bus-load", "0.8"]
    assert main(["simulate", *arguments, "--log", str(log), "--json", str(run)]) == Exit.DONE
    assert json.loads(run.read_text())["bus"]["load_wanted"] == 0.8
    capsys.readouterr()
    assert main(["replay", str(log), "--verify"]) == Exit.DONE
    assert "identical" in capsys.readouterr().out


@pytest.mark.parametrize("text", ["0", "1.1", "nan", "x", "0.09"])
def test_a_load_that_cannot_be_is_refused(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["simulate", "--bus-load", text])
    assert ended.value.code == Exit.BAD_INPUT
    assert "0.1 to 1" in capsys.readouterr().err
