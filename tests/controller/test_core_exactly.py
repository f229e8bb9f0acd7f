"""Small statements about the controller's core that no longer run would make by accident."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from meshpoint.bus.core import Step
from meshpoint.bus.records import Records
from meshpoint.controller import node, outage_record
from meshpoint.controller.core import FRESH_US, ControllerCore
from meshpoint.controller.header import new_header
from meshpoint.controller.outage_record import OutageRecord, load_outages
from meshpoint.controller.sensing.clock_probe import FIRST_OF_A_READ
from meshpoint.controller.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import (
    ClutchCommand,
    ControllerStatus,
    FaultCode,
    ValveCommand,
)
from meshpoint.gearbox import MainGear, load_sheet

STATUS = CODECS[ControllerStatus.__name__]


def a_core() -> ControllerCore:
    return ControllerCore(new_header("1.2.3", load_sheet("truck12"), ControllerSettings()))


def lateness_us(step: Step) -> int:
    status = next(frame for frame in step.frames if frame.can_id == STATUS.spec.can_id)
    decoded: ControllerStatus = STATUS.decode(status.data)
    return decoded.step_lateness_us


@pytest.mark.parametrize("late_us", [0, 1, 3_000])
def test_a_step_says_how_late_it_is(late_us: int) -> None:
    """The first one, which was due at no time, is not late; and none is early."""
    core = a_core()
    assert lateness_us(core.step(777_000)) == 0
    assert lateness_us(core.step(core.next_step_us + late_us)) == late_us
    assert lateness_us(core.step(core.next_step_us - 200)) == 0


def test_a_step_that_was_made_because_a_frame_came_is_not_late() -> None:
    core = a_core()
    core.step(777_000)
    core.receive(Frame(FIRST_OF_A_READ, bytes(64)))
    assert core.next_step_us == 0
    assert lateness_us(core.step(778_000)) == 0


@pytest.mark.parametrize(
    ("age_us", "fault"), [(FRESH_US, FaultCode.NONE), (FRESH_US + 1, FaultCode.POSITION_STALE)]
)
def test_positions_are_used_up_to_an_age(age_us: int, fault: FaultCode) -> None:
    core: Any = a_core()
    everything = SimpleNamespace(all_valid=lambda _: True, valid=lambda _: True)
    view = SimpleNamespace(complete=True, oldest_us=1_000_000, main_gear=MainGear.FIRST)
    core._receiver = everything
    core._observer = SimpleNamespace(view=view, layshaft=SimpleNamespace(free=False))
    core._speeds = SimpleNamespace(layshaft=100.0, main=80.0)
    assert core._lost(1_000_000 + age_us) is fault


class Silent:
    """A core that does nothing."""

    next_step_us = 0

    def receive(self, frame: Frame) -> None:
        pass

    def step(self, now_us: int) -> Step:
        del now_us
        return Step([], [])

    shutdown = step


def test_an_outage_longer_than_what_is_kept_of_it_leaves_one_record_of_so_many_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outage_record, "MOST_STEPS", 12)
    lost = [0]
    records = Records(tmp_path)
    kept = OutageRecord(Silent(), records, 1, lambda: lost[0])
    said = []
    for step in range(60):
        lost[0] += step >= 5
        said += kept.step(10_000 * step).events
        said += records.write()
    assert len(list(tmp_path.iterdir())) == 1
    assert [line.split(":")[0] for line in said] == ["outage"]
    assert list(load_outages(tmp_path, 1)) == list(range(12))


@pytest.mark.parametrize(
    ("estimator", "baselines"), [("crossing", False), ("window", True), ("thesis", True)]
)
def test_a_node_loads_the_kernels_that_its_estimator_needs_before_it_begins(
    estimator: str, baselines: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is not loaded before would be in the first shift, for seconds."""
    loaded: list[bool] = []
    monkeypatch.setattr(node, "warm_up", lambda baselines: loaded.append(baselines))

    async def nothing(*_: object, **__: object) -> None:
        pass

    monkeypatch.setattr(node, "run_node", nothing)
    settings = replace(ControllerSettings(), estimator_name=estimator)
    header = new_header("1.2.3", load_sheet("truck12"), settings)
    unused: Any = None
    asyncio.run(node.run_controller(header, unused, unused, on_event=print, stop=unused))
    assert loaded == [baselines]


def test_a_command_that_the_guard_has_blocked_leaves_no_gap_in_the_counters() -> None:
    """Off goes out in its place: a receiver that counts lost frames has lost none."""
    core: Any = a_core()
    valves, clutch = (CODECS[kind.__name__].spec.can_id for kind in (ValveCommand, ClutchCommand))
    counters: dict[int, list[int]] = {valves: [], clutch: []}
    for k in range(6):
        core._guard.passes = lambda *_, k=k: k % 2 == 0
        core._driveline_guard.passes_clutch = lambda *_, k=k: k % 3 == 0
        for frame in core.step(777_000 + 10_000 * k).frames:
            if frame.can_id in counters:
                counters[frame.can_id].append(frame.data[2])
    for found in counters.values():
        assert found == list(range(found[0], found[0] + 6))
