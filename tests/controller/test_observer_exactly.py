"""What the observer makes of a step's messages, branch by branch, with doubles around it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from meshpoint.controller.estimation.main_tracker import MainTracker
from meshpoint.controller.motion.brake_input import BrakeInput
from meshpoint.controller.observer import Observer
from meshpoint.controller.sensing.step_inputs import StepInputs
from meshpoint.controller.settings import ControllerSettings
from meshpoint.dbc.messages import EEC1, Estimator, GearboxSensors, ValveStatus
from meshpoint.gearbox import Range, Split, load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS

SHEET = load_sheet("truck12")
ATMOSPHERE_PA = SHEET.air.atmosphere_pa
T0 = 5_000_000


def an_observer(estimator: Estimator = Estimator.CROSSING) -> Any:
    brake = BrakeInput(round(1e6 * SHEET.brake.valve_delay_s))
    return Observer(SHEET, ControllerSettings(), brake, estimator)


class Noted:
    """Any object whose calls are noted by name and arguments."""

    def __init__(self, **values: Any) -> None:
        self.calls: list[tuple[Any, ...]] = []
        vars(self).update(values)

    def __getattr__(self, name: str) -> Any:
        return lambda *args: self.calls.append((name, *args))

    def named(self, name: str) -> list[tuple[Any, ...]]:
        return [call[1:] for call in self.calls if call[0] == name]


@pytest.mark.parametrize(("after_us", "is_dragged"), [(0, True), (29_999, True), (30_000, False)])
@pytest.mark.parametrize("which", ["split", "range_"])
def test_a_synchroniser_drags_for_30_ms_after_its_sleeve_was_last_between_the_steps(
    which: str, after_us: int, is_dragged: bool
) -> None:
    """Splitter: the layshaft; range: the main shaft."""
    observer = an_observer()
    observer._layshaft_wheel, observer._main_wheel = layshaft, main = Noted(), Noted()
    view = observer.view = SimpleNamespace(split=Split.LOW, range_=Range.LOW)
    observer._see_synchronisers(T0 - 100_000)
    assert (observer._dragged, observer._main_dragged) == (False, False)
    setattr(view, which, None)
    observer._see_synchronisers(T0)
    setattr(view, which, Split.HIGH if which == "split" else Range.HIGH)
    observer._see_synchronisers(T0 + after_us)
    assert observer._dragged is is_dragged
    assert observer._main_dragged is (is_dragged and which == "range_")
    assert layshaft.named("set_dragged")[-1] == (is_dragged and which == "split",)
    assert main.named("set_dragged")[-1] == (is_dragged and which == "range_",)


def test_just_after_the_start_nothing_is_dragged() -> None:
    observer = an_observer()
    observer.view = SimpleNamespace(split=Split.LOW, range_=Range.LOW)
    observer._see_synchronisers(0)
    assert (observer._dragged, observer._main_dragged) == (False, False)


def test_pressures_are_told_over_the_atmosphere_and_the_newest_counts() -> None:
    observer = an_observer()
    observer._zero = SimpleNamespace(take=lambda _time, gauge_pa, _driven: gauge_pa - 500.0)
    taken: list[Any] = []
    observer._sampler = SimpleNamespace(take=lambda pairs: taken.extend(pairs) or "samples")
    samples = [
        GearboxSensors(
            sample_time_us=time_us, clutch_position_fraction=share,
            brake_pressure_pa=ATMOSPHERE_PA + 1e5 * k, supply_pressure_pa=9e5 + 1e4 * k,
        )
        for k, (time_us, share) in enumerate(((1_000, 0.2), (11_000, 0.6)), 1)
    ]  # fmt: skip
    assert observer._sensors(samples, T0) == "samples"
    assert taken == [
        (1_000, pytest.approx(1e5 - 500.0)),
        (11_000, pytest.approx(2e5 - 500.0)),
    ]
    assert observer.view.brake_gauge_pa == pytest.approx(2e5)
    assert observer.view.clutch.closed == 0.6
    assert observer.view.supply_pa == 9.2e5
    assert observer.brake.supply_pa == pytest.approx(9.2e5 - ATMOSPHERE_PA)


@pytest.mark.parametrize(
    ("energised", "pending", "drives"),
    [(False, False, False), (True, False, True), (False, True, True), (True, True, True)],
)
def test_a_brake_counts_as_driven_where_its_valve_is_on_or_will_be(
    energised: bool, pending: bool, drives: bool
) -> None:
    observer = an_observer()
    assert observer._brake_driven
    observer.valves = ValveStatus(brake_energised=energised, brake_pending=pending)
    assert observer._brake_driven is drives


def test_a_stamp_that_goes_back_is_of_a_clock_that_was_set_back() -> None:
    observer = an_observer()
    observer.clock = clock = SimpleNamespace(
        stamp=lambda stamp, _now: ("on", stamp), set_back=lambda stamp, _now: ("back", stamp)
    )
    assert clock is observer.clock
    found = [observer._sampled_us(stamp, T0) for stamp in (9_000, 9_000, 19_000, 18_999, 20_000)]
    assert [how for how, _ in found] == ["on", "on", "on", "back", "on"]
    assert observer._sampled_us((1 << 32) - 5, T0) == ("back", (1 << 32) - 5)
    assert observer._sampled_us(3, T0) == ("on", 3)


def broken(observer: Any) -> Any:
    """Doubles of all that is told when something breaks; nothing has yet."""
    observer.clock = SimpleNamespace(late=0, jumps=0)
    observer._layshaft_wheel, observer._main_wheel = Noted(broken=0), Noted(broken=0)
    observer.recovery, observer.references = Noted(), Noted()
    observer.layshaft, observer._main = Noted(), Noted()
    return observer


def test_nothing_is_lost_where_nothing_broke() -> None:
    observer, events = broken(an_observer()), list[str]()
    assert not observer._lose_what_broke(events)
    assert not events
    assert not observer.references.calls


def test_frames_that_come_late_are_said_once_each_time() -> None:
    observer, events = broken(an_observer()), list[str]()
    observer.clock.late = 1
    for _ in range(3):
        assert not observer._lose_what_broke(events)
    assert events == ["sensor frames come over 500 ms late: bus or machine overloaded"]
    observer.clock.late = 2
    observer._lose_what_broke(events)
    assert len(events) == 2
    assert not observer.references.calls


@pytest.mark.parametrize(("layshaft", "main"), [(1, 0), (0, 1), (1, 1)])
def test_a_wheel_whose_numbers_are_lost_starts_anew_and_the_other_loses_its_speed(
    layshaft: int, main: int
) -> None:
    """And every phase reference with them; the clock is as it was. It is done once."""
    observer, events = broken(an_observer()), list[str]()
    observer._layshaft_wheel.broken, observer._main_wheel.broken = layshaft, main
    assert not observer._lose_what_broke(events)
    assert events == ["tooth numbers lost: phase references unknown again"]
    assert observer.recovery.named("lost") == [(bool(layshaft), bool(main))]
    assert observer.references.named("lose_all") == [()]
    for tracker, is_lost in ((observer.layshaft, layshaft), (observer._main, main)):
        assert tracker.calls == [("restart",) if is_lost else ("lose_speed",)]
    for wheel in (observer._layshaft_wheel, observer._main_wheel):
        assert not wheel.calls
    assert not observer._lose_what_broke(events)
    assert len(events) == 1


def test_a_clock_that_jumped_breaks_every_wheel() -> None:
    """A wheel that starts anew has broken: both shafts lose their numbers."""
    observer, events = broken(an_observer()), list[str]()
    wheels = [observer._layshaft_wheel, observer._main_wheel]
    for wheel in wheels:
        wheel.restart = lambda wheel=wheel: setattr(wheel, "broken", wheel.broken + 1)
    observer.clock.jumps = 1
    assert observer._lose_what_broke(events)
    assert events == [
        "sensor clock jumped: teeth and phases start anew",
        "tooth numbers lost: phase references unknown again",
    ]
    assert [wheel.broken for wheel in wheels] == [1, 1]
    assert observer.recovery.named("lost") == [(True, True)]
    assert not observer._lose_what_broke(events)


def test_a_baseline_loses_its_references_without_a_memory() -> None:
    observer, events = broken(an_observer()), list[str]()
    observer.recovery = None
    observer.clock.jumps = 1
    assert observer._lose_what_broke(events)
    assert observer.references.named("lose_all") == [()]


class Main(MainTracker):
    """A main shaft's tracker that says what it is told to."""

    def __init__(self, known: Any) -> None:
        self.asked: list[Range] = []
        self.known = known
        self.frees: list[tuple[Any, ...]] = []

    def shafts(self, range_: Range) -> Any:
        self.asked.append(range_)
        return self.known

    placed: Any = "main placed"

    def set_free(self, *args: Any) -> None:
        self.frees.append(args)


def loaded(free: bool = False, shafts: Any = "shafts", closed: float | None = 0.9) -> Any:
    observer = an_observer()
    observer._loaded = Noted()
    observer._crossing = SimpleNamespace(free=free, placed="placed", own_drag_nm=-3.0)
    observer._main = Main(shafts)
    observer.view = SimpleNamespace(gear_number=8, clutch_closed=closed)
    observer.kiss_share = 0.4
    return observer


def said(share: float | None, fine: float | None = None) -> StepInputs:
    inputs = StepInputs()
    for each in (0.9, share):
        inputs.take(
            EEC1(actual_engine_torque_fraction=each, actual_engine_torque_fine_fraction=fine)
        )
    return inputs


@pytest.mark.parametrize(("closed", "carries"), [(0.4, False), (0.41, True), (0.0, False)])
def test_the_gear_in_mesh_is_loaded_by_the_engine_where_the_plates_carry(
    closed: float, carries: bool
) -> None:
    """By the newest of its messages, and until the next."""
    observer = loaded(closed=closed)
    observer._see_load(said(0.2, 0.005))
    observer._see_load(StepInputs())
    gear = DRIVE_GEARS[8]
    for call in observer._loaded.named("take"):
        assert call[:3] == (gear, "placed", "main placed")
        assert call[3][0] == pytest.approx(0.205 * SHEET.engine.reference_nm)
        assert call[3][1:] == (carries, -3.0)
        assert call[4] == "shafts"
    assert len(observer._loaded.calls) == 2
    assert observer._main.asked == [gear.range_] * 2


def test_no_load_is_followed_where_something_of_it_is_not_known() -> None:
    for observer, inputs in (
        (loaded(free=True), said(0.2)),
        (loaded(shafts=None), said(0.2)),
        (loaded(closed=None), said(0.2)),
        (loaded(), said(None)),
        (loaded(), StepInputs()),
    ):
        observer._see_load(inputs)
        assert not observer._loaded.calls
    neutral = loaded()
    neutral.view.gear_number = 0
    neutral._see_load(said(0.2))
    assert not neutral._loaded.calls
    baseline = an_observer(Estimator.THESIS)
    baseline.view = neutral.view
    baseline._see_load(said(0.2))
    assert baseline._torque_nm == pytest.approx(0.2 * SHEET.engine.reference_nm)


STEPS = (Split.LOW, Range.HIGH)


@pytest.mark.parametrize(
    ("changed", "is_free"),
    [
        ({}, True),
        ({"clutch_parted": False}, False),
        ({"main_box_free": False}, False),
        ({"split": None}, False),
        ({"range_": None}, False),
        ({"dragged": True}, False),
    ],
)
def test_the_layshaft_is_free_with_an_open_clutch_in_neutral_and_its_steps_in(
    changed: dict[str, Any], is_free: bool
) -> None:
    observer, events = an_observer(), list[str]()
    has = {"complete": True, "clutch_parted": True, "main_box_free": True, "split": Split.HIGH,
           "range_": Range.HIGH, "oldest_us": 77, "dragged": False} | changed  # fmt: skip
    observer._dragged = has.pop("dragged")
    observer.view = SimpleNamespace(**has)
    observer.layshaft, observer._main = Noted(free=False), Main(None)
    observer._layshaft_wheel = SimpleNamespace(newest=SimpleNamespace(time_us=123))
    observer.pressed_nm = 4.0
    observer._see_whether_free(events)
    assert observer.layshaft.named("set_free") == [(is_free, 123, events)]
    assert observer._main.frees == [(is_free, has["range_"], events, 77, 4.0, observer._loaded)]
    observer.view.complete = False
    observer._see_whether_free(events)
    observer.view.complete, observer._layshaft_wheel.newest = True, None
    observer._see_whether_free(events)
    assert len(observer._main.frees) == 1


def test_the_layshaft_s_model_is_made_anew_with_the_splitter_and_behind_each_free_run() -> None:
    observer, made = an_observer(), list[Split]()
    observer._model_layshaft = lambda: made.append(observer._split)
    view = observer.view = SimpleNamespace(
        complete=True, clutch_parted=False, main_box_free=False, split=Split.HIGH,
        range_=Range.HIGH, oldest_us=0,
    )  # fmt: skip
    layshaft = observer.layshaft = Noted(free=False)
    observer._layshaft_wheel = SimpleNamespace(newest=SimpleNamespace(time_us=1))
    observer._main = Main(None)
    for split, expected in ((Split.HIGH, 0), (Split.LOW, 1), (None, 1), (Split.LOW, 1),
                            (Split.HIGH, 2)):  # fmt: skip
        view.split = split
        observer._see_whether_free([])
        assert len(made) == expected
    layshaft.free = True
    observer._see_whether_free([])
    assert len(made) == 3
    view.clutch_parted = view.main_box_free = True
    observer._see_whether_free([])
    assert len(made) == 3
    assert made == [Split.LOW, Split.HIGH, Split.HIGH]
