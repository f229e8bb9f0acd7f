"""The layshaft's tracker by hand: what it knows at first, and what each end of freedom leaves."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from meshpoint.controller.estimation.crossing_tracker import CrossingTracker
from meshpoint.controller.estimation.likelihood import prior
from meshpoint.controller.motion.brake_input import BrakeInput
from meshpoint.controller.observer import Observer
from meshpoint.controller.sensing.pressure_samples import NO_SAMPLES
from meshpoint.controller.sensing.wheel_edges import EdgeBatch
from meshpoint.controller.settings import ControllerSettings
from meshpoint.dbc.messages import Estimator
from meshpoint.gearbox import load_sheet

SHEET, SETTINGS = load_sheet("truck12"), ControllerSettings()
TUNING, TEETH = SETTINGS.crossing_filter, SHEET.wheels.layshaft.teeth
HALF_PITCH = math.pi / TEETH


def turn(tracker: Any, first: int, last: int) -> None:
    for number in range(first, last, 6):
        edges = np.arange(number, number + 6)
        angle = HALF_PITCH * edges.astype(np.float64)
        batch = EdgeBatch(angle / 100.0 / 1e-6, angle, edges // 2 % TEETH, edges % 2)
        tracker.edges(batch, NO_SAMPLES)


def a_tracker(edges: int = 60) -> Any:
    brake = BrakeInput(round(SHEET.brake.valve_delay_s / 1e-6))
    tracker = Observer(SHEET, SETTINGS, brake, Estimator.CROSSING).layshaft
    assert isinstance(tracker, CrossingTracker)
    turn(tracker, 0, edges)
    return tracker


def free() -> Any:
    tracker = a_tracker()
    tracker.set_free(True, 0.0, [])
    return tracker


def test_what_is_known_at_first_is_what_the_settings_say_within_factors_and_ranges() -> None:
    """Friction of a sheet that has none is taken to be 1 mNms."""
    for friction, typical in ((0.0, 1e-3), (0.3, 0.3)):
        tracker: Any = CrossingTracker(
            TUNING, BrakeInput(0), a_tracker(0)._known, TEETH, friction_nms=friction
        )
        assert tracker.friction == prior(typical, 3.0, (1e-3, 2.0), 0.1)
    assert tracker.noise == [
        prior(TUNING.edge_time_s, 2.0, (1e-6, 2e-4), 0.03),
        prior(TUNING.torque_disturbance_nm, 3.0, (0.02, 100.0), 0.1),
        prior(TUNING.disturbance_s, 2.0, (2e-3, 0.5), 0.1),
    ]
    assert (tracker.noise_shifts, tracker._steady_rad_s, tracker.free) == (0, None, False)
    assert tracker.disturbance == pytest.approx(
        (TUNING.torque_disturbance_nm, TUNING.disturbance_s)
    )
    assert (tracker.drag_nm(100.0), tracker._inertia_kgm2) == (0.0, 1.0)
    with pytest.raises(RuntimeError):
        assert tracker.model
    default: Any = CrossingTracker(TUNING, BrakeInput(0), tracker._known, TEETH)
    assert default.friction.value == pytest.approx(1e-3)
    assert default.at(0.0) is None
    x, p = default._first_state(3.0)
    follow = TUNING.follow_rad_s2
    sds = (2.0 * TUNING.tooth_error_rad, 3.0, 1.0, follow, 1e-9, follow)
    assert p == pytest.approx(np.diag(np.square(sds)))
    assert x.tolist() == [0.0, 0.0, 0.0, 0.0, 1.0, 0.0]


def test_a_layshaft_is_braked_by_its_friction_and_the_drag_that_was_learned() -> None:
    """A drag that would drive it counts as none."""
    tracker = a_tracker()
    by_friction = tracker._inertia_kgm2 * tracker.model.friction_per_s * 80.0
    for drag_nm, braked in ((-2.0, by_friction + 2.0), (by_friction + 1.0, 0.0)):
        tracker._known = SimpleNamespace(drag_nm=SimpleNamespace(value=drag_nm))
        assert tracker.drag_nm(-80.0) == pytest.approx(braked)
        tracker._filter.x[1] = 80.0
        assert tracker.own_drag_nm == pytest.approx(braked)


def test_what_earlier_runs_learned_is_taken_up() -> None:
    tracker = a_tracker()
    tracker.take_noise(5, (3e-5, 0.3), (4.0, 0.4), (0.02, 0.5))
    assert tracker.noise_shifts == 5
    assert [one.value for one in tracker.noise] == pytest.approx([3e-5, 4.0, 0.02])
    assert [one.sd for one in tracker.noise] == pytest.approx([0.3, 0.4, 0.5])
    assert tracker._filter._memory.part("edge_time_s")[0] == pytest.approx(3e-5)
    tracker.take_friction(0.2, 0.3)
    assert (tracker.friction.value, tracker.friction.sd) == pytest.approx((0.2, 0.3))
    models = SimpleNamespace(motion="model", inertia_kgm2=0.7)
    tracker.set_models(models)
    assert (tracker.model, tracker._inertia_kgm2) == ("model", 0.7)


@pytest.mark.parametrize("learned", [False, True])
def test_a_layshaft_that_becomes_free_begins_a_window(learned: bool) -> None:
    """Its angle so far was off by the errors of unlearned teeth."""
    tracker = a_tracker()
    tracker.teeth.learned = learned
    tracker._free_edges, tracker._in_gear._count = 7, 3
    before, state = tracker._filter.p[:2, :2].copy(), tracker._filter
    tracker.take_noise(0, (3e-5, 0.3), (4.0, 0.4), (0.02, 0.5))
    tracker.set_free(True, 0.0, [])
    off = 0.0 if learned else TUNING.tooth_error_rad**2
    assert state.p[:2, :2] == pytest.approx(before + np.diag((off, 0.0)))
    assert (tracker.free, tracker._free_edges, tracker._in_gear._count) == (True, 0, 0)
    assert state._memory.part("heed")[0] == 0.0
    assert state._memory.held[0] == 0
    learner = tracker.teeth.learner
    assert learner.running
    assert learner._memory.part("edge_time_s")[0] == pytest.approx(3e-5)
    assert learner._memory.x.tolist() == state.x.tolist()
    expected = np.diag(state.p).copy()
    expected[:2] = (2.0 * TUNING.tooth_error_rad) ** 2, 1.0
    assert learner._memory.p == pytest.approx(np.diag(expected))
    turn(tracker, 60, 72)
    assert tracker._free_edges == 12


def test_a_layshaft_becomes_free_once_and_with_a_speed() -> None:
    tracker, begun = a_tracker(), []
    tracker._begin_free = lambda: begun.append(True)
    tracker._running = False
    tracker.set_free(True, 0.0, [])
    tracker._running = True
    tracker.set_free(False, 0.0, [])
    assert not begun
    tracker._free = True
    tracker.set_free(True, 0.0, [])
    assert not begun


@pytest.mark.parametrize(("edges", "learned"), [(99, False), (100, True)])
def test_what_a_window_of_a_hundred_edges_has_shown_is_learned(edges: int, learned: bool) -> None:
    """Then the torque on the layshaft is unknown again: accelerations of any kind, and noise that
    follows what is seen."""
    tracker, events = free(), ["before"]
    order: list[Any] = []
    turn(tracker, 60, 72)
    state = tracker._filter
    tracker._free_edges = edges
    tracker._learn_noise = lambda: order.append("noise")
    tracker._learn_friction = lambda end: order.append(end)
    tracker._learn_teeth = lambda name, lines: order.append((name, lines))
    end_rad_s = float(state.x[1])
    tracker.set_free(False, 0.0, events)
    said: list[Any] = [("layshaft", events)]
    assert order == said + (["noise", end_rad_s] if learned else [])
    follow = TUNING.follow_rad_s2
    assert np.diag(state.p)[2:] == pytest.approx(np.square((1.0, follow, 1e-9, follow)))
    assert not state.p[2:, :2].any()
    assert (state.x[3], state.x[5]) == (0.0, 0.0)
    assert state._memory.part("heed")[0] == 0.1
    assert state._memory.held[0] == 0
    assert not tracker.free


@pytest.mark.parametrize("learned", [False, True])
@pytest.mark.parametrize("seen", [None, 90.0])
def test_friction_is_learned_from_the_second_window_on(learned: bool, seen: float | None) -> None:
    tracker = free()
    asked: list[Any] = []
    tracker.teeth.learned, tracker._steady_rad_s = learned, seen

    def learn(*given: Any) -> str:
        asked.append(given)
        return "friction"

    tracker._run.learn_friction = learn
    before = tracker.friction
    tracker._learn_friction(70.0)
    taught = learned and seen is not None
    assert len(asked) == int(taught)
    assert tracker.friction == ("friction" if taught else before)
    if taught:
        assert asked[0][:3] == (before, 90.0, tracker._known)
    assert tracker._steady_rad_s == 70.0


def test_noise_is_learned_from_each_window_and_an_edge_s_time_holds_from_then_on() -> None:
    tracker, known = free(), prior(4e-5, 2.0, (1e-6, 2e-4), 0.03)
    tracker._run.learn_noise = lambda *_: [known] * 3
    tracker._learn_noise()
    assert (tracker.noise, tracker.noise_shifts) == ([known] * 3, 1)
    assert tracker._filter._memory.part("edge_time_s")[0] == pytest.approx(4e-5)


def test_the_newest_state_says_how_sure_edges_are() -> None:
    """Variance of an edge's angle times the time from edge to edge."""
    tracker = free()
    turn(tracker, 60, 72)
    found = tracker.latest()
    omega = found.omega_rad_s
    edge = (omega * TUNING.edge_time_s) ** 2 + TUNING.tooth_error_rad**2
    assert found.edge_rad2_s == pytest.approx(edge * HALF_PITCH / omega)
    now_us = tracker._filter.time_us
    assert tracker.at(now_us + 61e3) is None
    assert tracker.at(now_us + 5e3).gain == tracker._filter.x[4]
    tracker.lose_speed()
    assert (tracker.free, tracker.at(now_us)) == (False, None)
