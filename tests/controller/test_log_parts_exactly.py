"""The parts of a log's reader by themselves: edges of a run, strokes, closings, and its steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_log_reader_exactly import BEGIN_US, SHEET, STROKE_M, Box, out_of_gear, the_run

from meshpoint.controller.sensing.gearbox_view import GearboxView
from meshpoint.controller.sensing.wheel_edges import EdgeBatch, WheelEdges
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import (
    EEC1,
    GearboxSensors,
    SleevesAux,
    SleevesMain,
    ValveAction,
    ValveCommand,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import Split
from meshpoint.testbench.identify.log_reader import (
    LogContent,
    LogReader,
    Stroke,
    _ClosingTrack,
    _Course,
    _Strokes,
)
from meshpoint.testbench.identify.valve_switches import ValveSwitches

TEETH = SHEET.wheels.layshaft.teeth


def course_with(*times_us: float) -> _Course:
    """Edges of one read, a rising one first; the first tooth's number is its wheel's last but
    one."""
    number = np.arange(len(times_us))
    course = _Course(WheelEdges.of(SHEET.wheels.layshaft), TEETH)
    course.begin()
    tooth = TEETH - 2 + number // 2
    course.add(EdgeBatch(np.array(times_us), np.asarray(0.1 * number), tooth, number % 2))
    return course


def test_a_run_s_edges_are_those_after_its_beginning_up_to_its_very_end() -> None:
    wheel = course_with(100.0, 200.0, 300.0, 400.0, 500.0, 600.0).wheel(100, 500)
    assert wheel is not None
    assert wheel.time_us.tolist() == [200.0, 300.0, 400.0, 500.0]
    assert wheel.theta_rad == pytest.approx([0.1, 0.2, 0.3, 0.4])
    assert wheel.place.tolist() == [2 * TEETH - 3, 2 * TEETH - 2, 2 * TEETH - 1, 0]


def test_reads_without_an_edge_and_the_edges_of_the_run_before_make_no_wheel() -> None:
    course = course_with(100.0, 200.0)
    course.begin()
    assert course.wheel(0, 1_000) is None
    none = np.empty(0)
    course.add(EdgeBatch(none, none, none.astype(np.int64), none.astype(np.int64)))
    assert course.wheel(0, 1_000) is None


def test_teeth_that_were_lost_before_a_run_do_not_spoil_it() -> None:
    edges = WheelEdges.of(SHEET.wheels.layshaft)
    course = _Course(edges, TEETH)
    course.begin()
    edges.restart()
    course.begin()
    number = np.arange(2)
    course.add(EdgeBatch(np.array([1.0, 2.0]), np.asarray(0.1 * number), number // 2, number))
    assert course.wheel(0, 10) is not None
    edges.restart()
    assert course.wheel(0, 10) is None


def test_a_run_of_a_single_read_is_none() -> None:
    assert not list(Box(out_of_gear(500, 510)).read(0.8).runs)


class Sleeves:
    """A view that is fed, and the strokes that are seen by it. Times in us."""

    def __init__(self) -> None:
        self.view, self.valves, self.content = GearboxView(SHEET), ValveSwitches(), LogContent()
        self.strokes = _Strokes(SHEET, self.content)

    def fire(self, at_us: int, name: str = "main_second", off: bool = False) -> None:
        action = ValveAction.OFF_AT if off else ValveAction.ON_AT
        values = {f"{name}_action": action, f"{name}_time_us": at_us}
        self.valves.take(ValveCommand(**values), at_us)  # type: ignore[arg-type]

    def read(self, at_us: int, *newest_m: float, supply_pa: float = 9e5) -> None:
        """Ten samples or fewer of the sleeve of first and second gear, newest first."""
        own = newest_m if len(newest_m) > 1 else newest_m * 10
        self.view.sleeves_main(SleevesMain(at_us % (1 << 32), 0, own, (0.0,) * 10), at_us)
        self.strokes.step(self.view, self.valves, at_us, supply_pa)

    def told(self) -> list[Stroke]:
        return list(self.content.strokes)


def test_a_gearbox_whose_sleeves_were_not_seen_yet_has_no_strokes() -> None:
    sleeves = Sleeves()
    sleeves.fire(1_000)
    sleeves.strokes.step(sleeves.view, sleeves.valves, 2_000, 9e5)
    assert not sleeves.told()


@pytest.mark.parametrize(("over_us", "is_over"), [(149_999, False), (150_000, True)])
def test_a_stroke_is_over_150_ms_after_its_valve_was_switched_on(
    over_us: int, is_over: bool
) -> None:
    sleeves = Sleeves()
    sleeves.read(1_000_000, 0.0)
    sleeves.fire(1_001_000)
    sleeves.read(1_010_000, 0.0, supply_pa=8.5e5)
    sleeves.read(1_001_000 + over_us, STROKE_M, supply_pa=7e5)
    assert len(sleeves.told()) == is_over
    if is_over:
        (stroke,) = sleeves.told()
        assert stroke.fired_us == 1_001_000
        assert stroke.time_us[:10].tolist() == list(range(1_001_000, 1_010_001, 1_000))
        assert stroke.time_us[-1] == 1_151_000
        assert (stroke.supply_pa, stroke.way_m[-1]) == (8.5e5, STROKE_M)


def test_a_read_of_fewer_samples_tells_those_that_it_has() -> None:
    sleeves = Sleeves()
    sleeves.read(1_000_000, 0.0)
    sleeves.fire(1_008_000)
    sleeves.read(1_010_000, 1.3e-3, 1.2e-3, 1.1e-3)
    sleeves.read(1_200_000, STROKE_M)
    (stroke,) = sleeves.told()
    assert stroke.time_us[:3].tolist() == [1_008_000, 1_009_000, 1_010_000]
    assert stroke.way_m[:3] == pytest.approx([1.1e-3, 1.2e-3, 1.3e-3])


@pytest.mark.parametrize(
    ("since_us", "position_m", "told"),
    [(19_999, 1.2e-3, True), (20_000, 1.2e-3, False), (20_000, 0.9e-3, True)],
)
def test_a_sleeve_that_has_left_neutral_may_still_be_on_its_way_for_20_ms(
    since_us: int, position_m: float, told: bool
) -> None:
    """Where it was never seen in neutral its sensor counts as having no offset."""
    sleeves = Sleeves()
    sleeves.fire(1_000_000)
    sleeves.read(1_000_000 + since_us, position_m)
    sleeves.read(1_200_000, STROKE_M)
    assert len(sleeves.told()) == told
    if told and position_m == 1.2e-3:
        (stroke,) = sleeves.told()
        assert stroke.way_m[0] == pytest.approx(1.2e-3)


@pytest.mark.parametrize(("off_m", "told"), [(1.5e-3, True), (1.6e-3, False)])
def test_a_sleeve_may_be_a_millimetre_and_a_half_off_its_rest_as_its_valve_comes_on(
    off_m: float, told: bool
) -> None:
    """It was never seen at rest before."""
    sleeves = Sleeves()
    sleeves.fire(1_000_000)
    sleeves.read(1_009_000, off_m)
    sleeves.read(1_200_000, STROKE_M)
    assert len(sleeves.told()) == told


def test_a_gear_s_valve_that_is_switched_on_again_makes_another_stroke() -> None:
    """Its rest is what its sleeve showed in neutral: by a tenth of what a read's mean is off it,
    for each of the sleeve's two gears."""
    sleeves = Sleeves()
    sleeves.read(900_000, 2e-4)
    sleeves.read(950_000, 4e-4)
    rest_m = 2e-4 + (1.0 - 0.9**2) * 2e-4
    for at_us in (1_000_000, 2_000_000):
        sleeves.fire(at_us)
        sleeves.read(at_us + 9_000, 1.2e-3)
        sleeves.read(at_us + 160_000, STROKE_M)
        sleeves.fire(at_us + 200_000, off=True)
    first, second = sleeves.told()
    assert first.rested_s is None
    assert second.rested_s == pytest.approx(1.0)
    assert first.way_m[-1] == pytest.approx(STROKE_M - rest_m, abs=1e-12)
    assert first.way_m[0] == pytest.approx(1.2e-3 - rest_m, abs=1e-12)
    assert second.fired_us == 2_000_000


def test_a_stroke_is_told_each_sample_once_though_a_read_of_the_sleeves_is_lost() -> None:
    reader, io = LogReader(SHEET), Transmitter(Node.GEARBOX_IO)
    controller = Transmitter(Node.TRANSMISSION_CONTROL)
    on = ValveCommand(main_second_action=ValveAction.ON_AT, main_second_time_us=1_055_000)
    for k in range(1, 40):
        at_us = 1_000_000 + 10_000 * k
        if k == 5:
            reader.take(at_us, controller.encode(on))
        way = (0.0,) * 10
        if k not in (8, 9):
            reader.take(at_us + 100, io.encode(SleevesMain(at_us, 0, way, way)))
            reader.take(at_us + 100, io.encode(SleevesAux(at_us, 0, way, way)))
        reader.take(at_us + 100, io.encode(GearboxSensors(at_us, 1e5, 9e5, 350.0, 0.0)))
    (stroke,) = reader.finish().strokes
    ms = ((stroke.time_us - 1_000_000) / 1000.0).tolist()
    assert sorted(set(ms)) == ms
    assert not {71.0, 80.0, 90.0} & set(ms)
    assert {70.0, 91.0} <= set(ms)


def closings(shares: list[float], spoken: int = 20) -> int:
    """How many closings a clutch shows that goes through these, 10 ms apart, beside so many engine
    speeds."""
    content = LogContent()
    track = _ClosingTrack(content)
    for k in range(spoken):
        track.engine(1_000_000 + 1_000 * k, 100.0)
    for k, share in enumerate(shares):
        track.clutch(1_000_000 + 10_000 * k, share)
    return len(content.closings)


@pytest.mark.parametrize(
    ("shares", "told"),
    [
        ([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 1.0], 1),
        ([0.0, 0.1, 0.2, 0.3, 0.4, 1.0], 0),  # five samples before the end
        ([0.02, 0.1, 0.2, 0.3, 0.4, 0.5, 1.0], 1),
        ([0.0225, 0.1, 0.2, 0.3, 0.4, 0.5, 1.0], 0),  # it was not seen open
        ([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.98], 1),
        ([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.97], 0),  # it has not come to its end
        ([0.0, 0.2, 0.4, 0.6, 1.0, 0.7, 0.8, 1.0], 0),  # it had snapped shut before
        ([0.0, 0.02, 0.3, 0.6, 0.7, 0.8, 1.0], 0),  # open for the last time at 0.02: five
    ],
)
def test_a_closing_goes_from_two_percent_to_98_percent_in_six_samples_or_more(
    shares: list[float], told: int
) -> None:
    assert closings(shares) == told


@pytest.mark.parametrize(("spoken", "told"), [(5, 0), (6, 1)])
def test_six_speeds_of_the_engine_beside_a_closing_are_enough(spoken: int, told: int) -> None:
    assert closings([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 1.0], spoken) == told


def test_the_newest_200_speeds_of_the_engine_are_kept() -> None:
    track = _ClosingTrack(LogContent())
    for k in range(300):
        track.engine(10_000 * k, 100.0 + k)
    times, speeds = track.engine_since(0)
    assert times.tolist() == [10_000 * k for k in range(100, 300)]
    assert (speeds[0], speeds[-1]) == (200.0, 399.0)
    assert track.engine_since(2_980_000)[0].tolist() == [2_980_000, 2_990_000]
    assert track.engine_since(4_000_000).shape == (2, 0)


class Steps(LogReader):
    """Says when its steps are."""

    def __init__(self) -> None:
        super().__init__(SHEET)
        self.at_us: list[int] = []

    def _step(self, now_us: int) -> None:
        self.at_us.append(now_us)
        super()._step(now_us)


FOREIGN = Frame(0x123, b"\0" * 8)


def test_a_log_is_gone_through_in_steps_of_10_ms_and_over_a_gap_in_one() -> None:
    """A step is before the first frame that comes at its time or later; the first one 10 ms after
    the first frame. The last step is after the last frame. Foreign frames are of no account."""
    reader = Steps()
    for now_us in (5_000, 14_999):
        reader.take(now_us, FOREIGN)
    assert reader.at_us == []
    reader.take(15_000, FOREIGN)
    assert reader.at_us == [15_000]
    reader.take(34_999, FOREIGN)
    assert reader.at_us == [15_000, 25_000]
    reader.take(1_000_000, FOREIGN)
    assert reader.at_us == [15_000, 25_000, 35_000, 990_000, 1_000_000]
    content = reader.finish()
    assert reader.at_us[-1] == 1_010_000
    assert not content.messages


def test_an_empty_log_holds_nothing() -> None:
    reader = Steps()
    content = reader.finish()
    assert reader.at_us == []
    assert (len(content.runs), len(content.strokes), len(content.closings)) == (0, 0, 0)


def test_messages_are_counted_by_their_kind() -> None:
    reader, io, engine = LogReader(SHEET), Transmitter(Node.GEARBOX_IO), Transmitter(Node.ENGINE)
    for k in range(3):
        reader.take(10_000 * k, io.encode(GearboxSensors(10_000 * k, 1e5, 9e5, 350.0, 0.5)))
        if k:
            reader.take(10_000 * k, engine.encode(EEC1(engine_speed_rad_s=100.0)))
    content = reader.finish()
    assert content.messages == {"GearboxSensors": 3, "EEC1": 2}


def test_what_came_after_the_last_step_is_looked_at_in_the_end() -> None:
    """A clutch whose last sample but one is at its end has closed by then, and by the last one of a
    shorter log, too."""
    reader, io, engine = LogReader(SHEET), Transmitter(Node.GEARBOX_IO), Transmitter(Node.ENGINE)
    for k, share in enumerate([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 1.0]):
        at_us = 1_000_000 + 10_000 * k
        reader.take(at_us + 100, io.encode(GearboxSensors(at_us, 1e5, 9e5, 350.0, share)))
        reader.take(at_us + 200, engine.encode(EEC1(engine_speed_rad_s=100.0)))
    assert not list(reader.content.closings)
    (closing,) = reader.finish().closings
    assert closing.engine_us.tolist() == [1_000_100 + 10_000 * k for k in range(8)], (
        "100 us after the read, by when the sensors' frame came"
    )


def test_a_run_s_engine_speeds_are_those_since_three_reads_before_it() -> None:
    """Each 100 us after a read."""
    run = the_run(Box(out_of_gear(500, 900)).read(1.2))
    assert run.engine[0, 0] == run.start_us - 30_000 + 100


def brake(action: ValveAction, at_us: int) -> ValveCommand:
    return ValveCommand(brake_action=action, brake_time_us=at_us)


def test_the_brake_s_switches_of_a_run_are_those_of_two_seconds_before_it_to_its_very_end() -> None:
    ons = {90: 100, 390: 400, 890: 900}
    commands = {}
    for sent_ms, at_ms in ons.items():
        commands[sent_ms] = brake(ValveAction.ON_AT, BEGIN_US + 1000 * at_ms)
        commands[sent_ms + 100] = brake(ValveAction.OFF_AT, BEGIN_US + 1000 * (at_ms + 100))
    commands[2_690] = brake(ValveAction.ON_AT, BEGIN_US + 2_700_000)
    run = the_run(Box(out_of_gear(2_400, 2_710), commands=commands).read(3.0))
    assert (run.start_us - BEGIN_US, run.end_us - BEGIN_US) == (2_400_000, 2_700_000)
    assert [(one.time_us - BEGIN_US) // 1000 for one in run.brake] == [400, 500, 900, 1_000, 2_700]


def test_a_run_whose_main_wheel_has_no_edges_is_none() -> None:
    """The layshaft's alone do not do."""
    reader = LogReader(SHEET)
    for free in ((True, False), (False, True), (True, True)):
        content = LogContent()
        reader.content = content
        reader._free_us, reader._last_us, reader._split = 100, 900, Split.LOW
        courses = [course_with(200.0, 300.0) for _ in free]
        for course, has_edges in zip(courses, free, strict=True):
            if not has_edges:
                course.begin()
        reader._courses = (courses[0], courses[1])
        reader._end()
        assert len(content.runs) == all(free)


def test_a_run_without_a_pressure_of_its_own_goes_with_the_last_of_the_air() -> None:
    reader = LogReader(SHEET)
    for k in range(5):
        reader._take_sensors(GearboxSensors(0, 1e5, 8e5 + 1e4 * k, 350.0, 0.0), 1_000 * k)
    reader._free_us, reader._last_us = 900_000, 1_000_000
    reader._split = Split.LOW
    reader._courses = (course_with(950_000.0, 960_000.0), course_with(950_000.0, 960_000.0))
    reader._end()
    (run,) = reader.content.runs
    assert run.supply_pa == 8.4e5
    assert run.pressure.shape == (2, 0)


@pytest.mark.parametrize(("share", "runs"), [(0.6, 0), (0.59, 1)])
def test_a_sleeve_at_six_tenths_of_its_way_to_the_teeth_is_not_clear_of_them(
    share: float, runs: int
) -> None:
    """A way of a wire's steps, so that the very limit can be told."""
    sheet = replace(SHEET, sleeve=replace(SHEET.sleeve, to_contact_m=0.006 / 0.6))
    reader = LogReader(sheet)
    reader._view = GearboxView(sheet)
    clear_m = 0.6 * sheet.sleeve.to_contact_m
    position_m = clear_m if share == 0.6 else share * sheet.sleeve.to_contact_m
    view = reader._view
    view.sleeves_main(SleevesMain(0, 0, (position_m,) * 10, (0.0,) * 10), 0)
    view.sleeves_aux(SleevesAux(0, 0, (STROKE_M,) * 10, (STROKE_M,) * 10), 0)
    view.clutch.take(0, 0.0)
    view.work_out()
    reader._split = view.split
    assert reader._is_free() is bool(runs)


def sensors(reader: LogReader, count: int, begin: int = 0) -> None:
    for k in range(begin, begin + count):
        message = GearboxSensors(0, 1e5 + k, 9e5 + k, 350.0, 1.0)
        reader._take_sensors(message, 10_000 * k)


def test_pressures_are_dropped_but_for_50_as_soon_as_two_seconds_are_full() -> None:
    reader = LogReader(SHEET)
    sensors(reader, 200)
    assert len(reader._pressure) == len(reader._supply) == 200
    sensors(reader, 1, 200)
    assert [value for _, value in reader._pressure] == [1e5 + k for k in range(151, 201)]
    assert reader._supply == [9e5 + k for k in range(151, 201)]


def test_of_a_run_that_is_going_on_no_pressure_is_dropped() -> None:
    reader = LogReader(SHEET)
    reader._free_us = 0
    sensors(reader, 300)
    assert len(reader._pressure) == len(reader._supply) == 300


def test_switches_of_two_seconds_are_kept_and_of_those_before_the_newest() -> None:
    reader = LogReader(SHEET)
    for at_us, action in ((0, ValveAction.ON_AT), (1_000, ValveAction.OFF_AT),
                          (4_000, ValveAction.ON_AT), (900_000, ValveAction.OFF_AT),
                          (950_000, ValveAction.ON_AT)):  # fmt: skip
        reader._valves.take(brake(action, at_us), at_us)
    sensors(reader, 201)
    assert [one.time_us for one in reader._valves.of("brake", 2_000_000)] == [
        0, 1_000, 4_000, 900_000, 950_000
    ]  # fmt: skip
    sensors(reader, 151, 201)
    assert [one.time_us for one in reader._valves.of("brake", 3_520_000)] == [950_000]


def test_no_more_than_a_thousand_pressures_of_the_empty_brake_are_kept() -> None:
    reader = LogReader(SHEET)
    reader._valves.take(ValveCommand(brake_action=ValveAction.ON_NOW), 0)
    reader._valves.take(ValveCommand(brake_action=ValveAction.OFF_NOW), 1)
    sensors(reader, 1_500, 1_000)
    assert reader.content.empty_pa == [1e5 + k for k in range(1_000, 2_000)]


def test_a_log_whose_valve_was_never_switched_does_not_tell_when_the_brake_is_empty() -> None:
    reader = LogReader(SHEET)
    sensors(reader, 20)
    reader._valves.take(ValveCommand(brake_action=ValveAction.ON_NOW), 200_000)
    sensors(reader, 400, 20)
    assert not reader.content.empty_pa


def test_a_brake_s_newest_switch_is_the_one_that_counts() -> None:
    """Two seconds ago it went off, and a moment ago again."""
    reader = LogReader(SHEET)
    for at_us, action in ((0, ValveAction.ON_AT), (1_000, ValveAction.OFF_AT),
                          (2_000_000, ValveAction.ON_AT),
                          (2_100_000, ValveAction.OFF_AT)):  # fmt: skip
        reader._valves.take(brake(action, at_us), at_us)
    reader._take_sensors(GearboxSensors(0, 3e5, 9e5, 350.0, 1.0), 2_101_000)
    assert not reader.content.empty_pa
    reader._take_sensors(GearboxSensors(0, 1.1e5, 9e5, 350.0, 1.0), 3_000_000)
    assert reader.content.empty_pa == [1.1e5]


def test_edges_that_were_lost_between_two_runs_spoil_neither() -> None:
    def first_second(ms: int) -> float:
        return 0.0 if 400 <= ms < 700 or 1_300 <= ms < 1_600 else -STROKE_M

    runs = list(Box(first_second, without_edges=(850, 1_010)).read(1.8).runs)
    assert [(run.start_us - BEGIN_US) // 1000 for run in runs] == [400, 1_300]
    for run in runs:
        assert run.start_us < run.layshaft.time_us[0]
        assert run.layshaft.time_us[-1] <= run.end_us
