"""What the observer learns of a gear in mesh, and what it hands on, with doubles around it."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from calibration_example import example
from test_observer_exactly import SHEET, T0, Noted, an_observer

from meshpoint.controller.calibration.learned import SwingRecords
from meshpoint.controller.motion.swing import ShaftState
from meshpoint.controller.phase.locked_gear import LockedGear
from meshpoint.controller.sensing.step_inputs import StepInputs
from meshpoint.controller.sensing.wheel_edges import NO_EDGES
from meshpoint.dbc.messages import Estimator, ValveStatus
from meshpoint.gearbox import MainGear, Split


@pytest.mark.parametrize("place", range(6))
def test_a_shaft_of_which_any_figure_is_no_number_is_not_known(place: int) -> None:
    observer = an_observer()
    state = ShaftState(1.0, 2.0, 3.0, 0.1, 0.2, 0.3)
    observer._main = SimpleNamespace(at=lambda _time: state)
    assert observer.main_at(5.0) is state
    spoilt = ShaftState(*[math.nan if k == place else v for k, v in enumerate(state[:6])])
    observer._main = SimpleNamespace(at=lambda _time: spoilt)
    assert observer.main_at(5.0) is None
    observer._main = SimpleNamespace(at=lambda _time: None)
    assert observer.main_at(5.0) is None


def test_a_step_s_messages_reach_wheels_view_and_trackers() -> None:
    """Where the clock jumped in it, its edges and pressures are of two clocks and of no use. A
    main shaft that its synchroniser drags loses its speed."""
    for jumped in (False, True):
        observer = an_observer()
        observer.layshaft, observer._main = Noted(free=False), Noted()
        observer._loaded, observer.recovery = Noted(), Noted()
        observer._lose_what_broke = lambda _events, jumped=jumped: jumped
        observer._sensors = lambda *_: "pressures"
        observer._see_synchronisers = lambda _now: None
        observer._main_dragged = not jumped
        observer._read = lambda wheel, *_: wheel
        inputs = StepInputs()
        inputs.take(ValveStatus(refused_count=3))
        observer.take(inputs, T0, [])
        observer.take(StepInputs(), T0, [])
        assert observer.valves.refused_count == 3
        expected = (NO_EDGES,) if jumped else (observer._main_wheel,)
        assert observer._main.named("edges") == [expected] * 2
        assert observer.layshaft.named("edges")[0][0] is (
            NO_EDGES if jumped else observer._layshaft_wheel
        )
        assert (observer.layshaft.named("edges")[0][1] == "pressures") is not jumped
        assert len(observer._loaded.named("lose")) == (2 if jumped else 0)
        renumbered = observer._layshaft_wheel.sensor.renumbered
        assert observer.recovery.named("look") == [([], renumbered)] * 2
        assert len(observer._main.named("lose_speed")) == (0 if jumped else 2)


GAP_RAD = SHEET.dog.backlash_rad


def in_mesh(sd_rad: float = 1e-4, learns: bool = False) -> Any:
    """Second gear in mesh, watched; its shafts known at the newest edge."""
    observer = an_observer()
    observer.view = SimpleNamespace(complete=True, main_gear=MainGear.SECOND, clutch_closed=0.9)
    references = observer.references = Noted()
    references.watches = lambda gear: gear is MainGear.SECOND
    references.released = lambda: None
    references.watch = lambda *args: references.calls.append(("watch", *args)) or learns
    observer.recovery = Noted()
    observer._locked = LockedGear(SHEET, references, observer.recovery)
    newest = SimpleNamespace(time_us=40_000.0)
    observer._layshaft_wheel = SimpleNamespace(newest=newest)
    observer._main_wheel = SimpleNamespace(newest=SimpleNamespace(time_us=39_000.0))
    layshaft = SimpleNamespace(theta_rad=3.0, theta_sd_rad=sd_rad, is_finite=True)
    main = ShaftState(40_000.0, 2.0, 60.0, 0.0, 0.05)
    asked: list[float] = []
    observer.layshaft = SimpleNamespace(at=lambda at_us: asked.append(at_us) or layshaft)
    observer._main = SimpleNamespace(at=lambda at_us: asked.append(at_us) or main)
    observer.asked = asked
    return observer


def test_a_gear_in_mesh_is_looked_at_once_at_each_newest_edge() -> None:
    observer, events = in_mesh(), list[str]()
    for _ in range(3):
        observer.learn(events)
    assert observer.asked == [40_000.0, 40_000.0]
    ratio = SHEET.main_mesh(MainGear.SECOND).ratio
    assert observer.references.named("see") == [
        (MainGear.SECOND, 3.0, 2.0, pytest.approx(ratio * 1e-4))
    ]
    assert observer.references.named("watch") == [(MainGear.SECOND, 3.0, 2.0, False)]
    observer._main_wheel.newest.time_us = 41_000.0
    observer.learn(events)
    assert observer.asked[2:] == [41_000.0, 41_000.0]
    assert not events
    assert not observer.recovery.calls


def test_a_reference_that_was_learned_is_said_and_remembered() -> None:
    observer, events = in_mesh(learns=True), list[str]()
    observer.learn(events)
    assert events == ["phase reference of second learned"]
    ((gear, sd_rad, told),) = observer.recovery.named("learned")
    assert (gear, told) == (MainGear.SECOND, events)
    assert sd_rad == pytest.approx(SHEET.main_mesh(MainGear.SECOND).ratio * 1e-4)
    without = in_mesh(learns=True)
    without._locked = LockedGear(SHEET, without.references, None)
    without.learn(events)
    assert len(events) == 2


@pytest.mark.parametrize(("share", "is_watched"), [(0.149, True), (0.151, False)])
def test_a_look_that_cannot_tell_the_flanks_apart_counts_but_is_not_watched(
    share: float, is_watched: bool
) -> None:
    """15 % of the backlash is the limit."""
    ratio = SHEET.main_mesh(MainGear.SECOND).ratio
    observer = in_mesh(share * GAP_RAD / ratio)
    observer.learn([])
    assert len(observer.references.named("see")) == 1
    assert bool(observer.references.named("watch")) is is_watched


def test_nothing_is_looked_at_without_a_gear_an_edge_of_both_wheels_and_known_shafts() -> None:
    for name in ("incomplete", "between", "neutral", "unwatched", "no layshaft edge",
                 "no main edge", "no layshaft", "no main"):  # fmt: skip
        observer = in_mesh()
        if name == "incomplete":
            observer.view.complete = False
        if name in ("between", "neutral"):
            observer.view.main_gear = None if name == "between" else MainGear.NEUTRAL
        if name == "unwatched":
            observer.view.main_gear = MainGear.THIRD
        if name == "no layshaft edge":
            observer._layshaft_wheel.newest = None
        if name == "no main edge":
            observer._main_wheel.newest = None
        if name == "no layshaft":
            observer.layshaft.at = lambda _time: None
        if name == "no main":
            observer._main.at = lambda _time: None
        observer.learn([])
        assert not observer.references.calls, name


@pytest.mark.parametrize("main_gear", [None, MainGear.NEUTRAL])
def test_a_gear_that_comes_out_tells_how_far_it_floated(main_gear: MainGear | None) -> None:
    observer, events = in_mesh(), list[str]()
    observer.view.main_gear = main_gear
    observer.learn(events)
    assert not observer.recovery.calls
    observer.references.released = lambda: "floated"
    observer.learn(events)
    assert observer.recovery.named("floated") == [("floated", events)]
    observer._locked = LockedGear(SHEET, observer.references, None)
    observer.learn(events)


def test_the_phase_s_deviation_is_that_of_both_shafts_at_the_gear() -> None:
    ratio = SHEET.main_mesh(MainGear.THIRD).ratio
    layshaft: Any = SimpleNamespace(theta_sd_rad=3e-3 / ratio)
    main = ShaftState(0.0, 0.0, 0.0, 4e-3, 0.0)
    found = an_observer()._locked._phase_sd_rad(MainGear.THIRD, layshaft, main)
    assert found == pytest.approx(5e-3)


def slowest(speeds: list[float], acceleration: float = 0.0, step_us: float = 10_000.0) -> float:
    locked, main = an_observer()._locked, None
    for k, speed in enumerate(speeds):
        main = ShaftState(step_us * k, 0.0, speed, 0.0, 0.0, acceleration)
        locked._main_speeds.append((main.time_us, main.omega_rad_s))
    return float(locked._slowest_rad_s2(main))


def test_the_lowest_acceleration_of_the_latest_looks_is_over_two_of_them_each() -> None:
    """Of speeds 10 ms apart: 90, 89, 88.5, 87.9, 88.4, the steepest over 20 ms from the first to
    the third: -1.5 / 20 ms. What the filter says of itself counts as well."""
    speeds = [90.0, 89.0, 88.5, 87.9, 88.4]
    assert slowest(speeds) == pytest.approx(-75.0)
    assert slowest(speeds, -80.0) == -80.0
    assert slowest(speeds[:2], -3.0) == -3.0
    assert slowest([90.0, 90.0, 91.0], 60.0) == pytest.approx(50.0)


def test_a_look_of_80_ms_ago_is_forgotten() -> None:
    """Of eight looks at most, and none older."""
    late = [0.0] + [-2.0] * 8
    assert slowest(late) == 0.0
    assert slowest(late[:8]) == pytest.approx(-100.0)
    assert slowest([0.0, -2.0, -2.0, -2.0], step_us=26_000.0) == pytest.approx(-2.0 / 52e-3)
    assert slowest([0.0, -2.0, -2.0, -2.0], step_us=27_000.0) == 0.0
    assert slowest([0.0, -2.0, -2.0], step_us=0.0) == 0.0


@pytest.mark.parametrize(
    ("drag_nm", "split", "pulls"),
    [
        (-3.1, Split.HIGH, True),
        (-2.5, Split.HIGH, False),
        (3.1, Split.HIGH, False),
    ],
)
def test_drag_pulls_by_five_radians_a_second_squared_at_the_gear(
    drag_nm: float, split: Split, pulls: bool
) -> None:
    """Third gear's ratio over the shafts' inertia."""
    observer, main = an_observer(), ShaftState(0.0, 0.0, 60.0, 0.0, 0.0)
    observer.view = SimpleNamespace(clutch_closed=None)
    observer._split = split
    ratio = SHEET.main_mesh(MainGear.THIRD).ratio / SHEET.inertia_kgm2(split)
    edge_nm = 5.0 / ratio
    observer.brake.drag_nm = SimpleNamespace(value=drag_nm / 2.8 * edge_nm)
    locked, coasting = observer._locked, observer._coasting_rad_s2
    assert locked._drag_pulls(MainGear.THIRD, main, coasting) is pulls
    assert list(locked._main_speeds) == [(0.0, 60.0)]


def test_what_was_learned_of_noise_and_swing_goes_in_and_out_as_it_was() -> None:
    given, observer = example(), an_observer()
    assert observer.noise() is None
    assert observer.swings() == SwingRecords()
    observer.take_noise(given.noise)
    kept = observer.noise()
    assert kept is not None
    assert given.noise is not None
    for name, figure in vars(given.noise).items():
        assert getattr(kept, name) == pytest.approx(figure), name
    observer.take_swings(given.swings)
    assert observer.swings().low is None
    assert observer.swings().high.shifts == 5
    base = an_observer(Estimator.THESIS)
    base.take_noise(given.noise)
    base.take_swings(given.swings)
    assert base.noise() is None
    assert base.swings() == SwingRecords()


def test_a_friction_that_was_not_learned_yet_is_the_sheet_s() -> None:
    given = example().noise
    assert given is not None
    observer = an_observer()
    before = observer._crossing.friction.value
    observer.take_noise(type(given)(**(vars(given) | {"friction_nms": 0.0})))
    assert observer._crossing.friction.value == before
    observer.take_noise(type(given)(**(vars(given) | {"friction_nms": 0.05})))
    assert observer._crossing.friction.value == pytest.approx(0.05)
