"""`meshpoint.Bench`: the same shifts as `simulate`, step by step, with parts of one's own."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest
from recorded_run import Recorded

import meshpoint
from meshpoint import messages
from meshpoint.dbc.layout import CODECS
from meshpoint.rig_sim import RigCore, RigSettings

ROOT = Path(__file__).parents[2]


def test_an_aimed_shift_meets_the_gap_and_the_first_cannot_aim(recorded: Recorded) -> None:
    assert recorded.learning.reference == "unknown"
    assert 3 in recorded.known  # gear 10 is the main box's second
    assert (recorded.aimed.from_, recorded.aimed.to) == (8, 10)
    assert recorded.aimed.reference == "known"
    assert recorded.aimed.contact == "gap"


def test_its_first_shift_is_that_of_simulate(recorded: Recorded) -> None:
    first = meshpoint.simulate(1, seed=1, as_built="clean").shifts[0].to_json()
    mine = recorded.learning.to_json()
    del first["bound_ms"], mine["bound_ms"]  # of the plan as a whole, which a bench does not have
    assert mine == first


def test_steps_by_hand() -> None:
    with meshpoint.Bench(preset="thesis") as bench:
        assert bench.status is None
        while bench.status is None:
            bench.step()
        before_s, number = bench.now_s, bench.status.step_number
        step = bench.step()
        assert bench.now_s == pytest.approx(before_s + 0.010)
        sent = {frame.can_id for frame in step.frames}
        assert CODECS["ValveCommand"].spec.can_id in sent
        bench.step()  # the frames of a step reach the bus when time goes on
        assert bench.status.step_number > number
        assert bench.latest(messages.ValveStatus).brake_energised is False
        assert bench.latest(messages.ShiftOutcome) is None


def test_a_shift_goes_on_while_time_does() -> None:
    with meshpoint.Bench(preset="thesis", strategy="speed_window") as bench:
        bench.begin(10)
        braking = messages.ControllerState.SYNCHRONISING
        bench.run_until(lambda bench: bench.status and bench.status.state is braking)
        assert not bench.shift_is_over and bench.shifts == []
        bench.run_until(lambda bench: bench.shift_is_over)
        assert bench.shifts[0].result == "engaged"
        assert bench.shifts[0].strategy == "speed_window"


def test_time_that_runs_out_is_reported() -> None:
    with meshpoint.Bench(preset="thesis") as bench:
        with pytest.raises(TimeoutError, match=r"within 0\.05 s of virtual time"):
            bench.run_until(lambda bench: bench.shifts, timeout_s=0.05)
        assert bench.now_s == pytest.approx(0.05)
        bench.run_for(0.02)
        assert bench.now_s == pytest.approx(0.07)
    with pytest.raises(RuntimeError, match="closed"):
        bench.step()


@pytest.mark.parametrize(
    ("call", "reported"),
    [
        (lambda bench: bench.shift(15), r"gear 15, allowed are 1 to 14"),
        (lambda bench: bench.shift(8), r"in gear 8 already"),
        (lambda bench: bench.shift(6), r"upshifts of the main box alone"),
        (lambda bench: bench.send(messages.ValveCommand()), r"does not send ValveCommand"),
    ],
)
def test_what_a_bench_cannot_do_is_said_before_anything_moves(call, reported: str) -> None:
    with meshpoint.Bench(preset="thesis") as bench:
        with pytest.raises((ValueError, meshpoint.TableError), match=reported):
            call(bench)
        assert bench.now_s == 0.0


class SilentRig:
    """The rig, but its oil temperature and pressures never come."""

    def __init__(self) -> None:
        sheet = meshpoint.load_gearbox()
        self._rig = RigCore(sheet, RigSettings(preset="thesis"))
        self._silent = CODECS["GearboxSensors"].spec.can_id
        self.receive = self._rig.receive
        self.shutdown = self._rig.shutdown

    @property
    def next_step_us(self) -> int:
        return self._rig.next_step_us

    def step(self, now_us: int) -> meshpoint.Step:
        frames, events = self._rig.step(now_us)
        return meshpoint.Step([f for f in frames if f.can_id != self._silent], events)


def test_a_rig_of_ones_own_is_what_the_controller_sees() -> None:
    with meshpoint.Bench(preset="thesis", rig=SilentRig()) as bench:
        bench.run_for(0.2)
        assert bench.as_built is None
        assert bench.latest(messages.SleevesMain) is not None
        assert bench.latest(messages.GearboxSensors) is None
        assert bench.status.state is messages.ControllerState.STARTING
        assert bench.status.invalid_channels != 0


def test_a_class_in_a_file_is_a_strategy(tmp_path: Path) -> None:
    path = tmp_path / "own.py"
    path.write_text((ROOT / "examples" / "own_strategy.py").read_text())
    spec = importlib.util.spec_from_file_location("own_of_a_test", path)
    module = sys.modules["own_of_a_test"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    by_class = meshpoint.load_settings(strategy=module.NextGap)
    assert by_class == meshpoint.load_settings(strategy=f"{path}:NextGap")
    assert by_class.strategy_file.aims
    with pytest.raises(meshpoint.TableError, match=r"allowed is a class at the top level"):
        meshpoint.load_settings(strategy=type("Nowhere", (), {"__module__": "builtins"}))
    with pytest.raises(meshpoint.TableError, match=r"allowed are speed_window"):
        meshpoint.load_settings(strategy="best")


def test_a_failing_shift_says_where_the_controller_stands() -> None:
    class Mute:
        """A controller that says nothing."""

        next_step_us = 0

        def receive(self, frame: meshpoint.Frame) -> None: ...

        def step(self, now_us: int) -> meshpoint.Step:
            self.next_step_us = now_us + 100_000
            return meshpoint.Step([], [])

        def shutdown(self, now_us: int) -> meshpoint.Step:
            return meshpoint.Step([], [])

    with meshpoint.Bench(preset="thesis", controller=Mute()) as bench:
        with pytest.raises(meshpoint.ShiftError, match="8 -> 10: no controller was heard"):
            bench.shift(10)
        assert any("stuck in returning" in event.text for event in bench.events)
