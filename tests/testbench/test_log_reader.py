"""A log's frames taken apart: runs in neutral, contacts, closings and switches of
valves of a gearbox of which it is known what happened when."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from wheel import Wheel, capture

from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import (
    EEC1,
    EdgesLayshaftFall,
    EdgesLayshaftRise,
    EdgesMainFall,
    EdgesMainRise,
    GearboxSensors,
    SleevesAux,
    SleevesMain,
    ValveAction,
    ValveCommand,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import GearboxSheet, MainGear, Range, Sleeve, Split, load_sheet
from meshpoint.gearbox.gears import SplitGear
from meshpoint.identify.log_reader import (
    FreeRun,
    LogContent,
    LogReader,
)
from meshpoint.identify.valve_switches import BRAKE, Switch, ValveSwitches

SHEET = load_sheet("truck12")
STROKE_M = SHEET.sleeve.stroke_m
BEGIN_US, STEP_US = 10_000_000, 10_000
LAYSHAFT_RAD_S, MAIN_RAD_S = 140.0, 90.0
Trajectory = Callable[[int], float]
"""Of a time in ms since the log's beginning."""


def turning(teeth: int, rad_s: float, seconds: float) -> Wheel:
    """A wheel at constant speed, half of each pitch a tooth."""
    pitch_us = 2e6 * math.pi / teeth / rad_s
    number = np.arange(int(seconds * 1e6 / pitch_us))
    rise = BEGIN_US + np.round(number * pitch_us)
    fall = BEGIN_US + np.round((number + 0.5) * pitch_us)
    return Wheel(0, rise.astype(int).tolist(), fall.astype(int).tolist())


@dataclass
class Box:
    """What a log was made of. Sleeves in m; clutch 0 open to 1 closed; pressures in Pa."""

    first_second: Trajectory = lambda _: 0.0
    third: Trajectory = lambda _: 0.0
    split: Trajectory = lambda _: STROKE_M
    range_: Trajectory = lambda _: -STROKE_M
    clutch: Trajectory = lambda _: 0.0
    brake_pa: Trajectory = lambda _: 1e5
    supply_pa: Trajectory = lambda _: 9e5
    engine_rad_s: Trajectory = lambda _: 100.0
    commands: dict[int, ValveCommand] = field(default_factory=dict)
    """By the ms at which each is sent."""
    sheet: GearboxSheet = SHEET
    without_edges: tuple[int, int] = (0, 0)
    """From and to which ms no edges come."""
    apart_us: int = 0
    """From one frame of the sensors to the next."""
    begins_us: int | None = None
    """When an engine's frame came, before all others."""

    def read(self, seconds: float) -> LogContent:
        """The log of so long."""
        io, engine = Transmitter(Node.GEARBOX_IO), Transmitter(Node.ENGINE)
        controller = Transmitter(Node.TRANSMISSION_CONTROL)
        reader, teeth = LogReader(self.sheet), SHEET.wheels
        layshaft = turning(teeth.layshaft.teeth, LAYSHAFT_RAD_S, seconds)
        main = turning(teeth.main.teeth, MAIN_RAD_S, seconds)
        if self.begins_us is not None:
            reader.take(BEGIN_US + self.begins_us, engine.encode(EEC1()))
        for ms in range(10, int(seconds * 1000), 10):
            at_us = BEGIN_US + 1000 * ms
            if ms in self.commands:
                reader.take(at_us + 50, controller.encode(self.commands[ms]))
            messages: list[object] = []
            if not self.without_edges[0] <= ms < self.without_edges[1]:
                messages += [
                    EdgesLayshaftRise(**capture(layshaft.rise_us, 0, at_us)),  # type: ignore[arg-type]
                    EdgesLayshaftFall(**capture(layshaft.fall_us, 0, at_us)),  # type: ignore[arg-type]
                    EdgesMainRise(**capture(main.rise_us, 0, at_us)),  # type: ignore[arg-type]
                    EdgesMainFall(**capture(main.fall_us, 0, at_us)),  # type: ignore[arg-type]
                ]
            stamp = at_us % (1 << 32)
            samples = [tuple(trajectory(ms - k) for k in range(10)) for trajectory in
                       (self.first_second, self.third, self.split, self.range_)]  # fmt: skip
            messages += [
                SleevesMain(stamp, 0, samples[0], samples[1]),
                SleevesAux(stamp, 0, samples[2], samples[3]),
                GearboxSensors(stamp, self.brake_pa(ms), self.supply_pa(ms), 350.0,
                               self.clutch(ms)),
            ]  # fmt: skip
            for k, message in enumerate(messages):
                reader.take(at_us + 100 + k * self.apart_us, io.encode(message))  # type: ignore[arg-type]
            after_us = at_us + 200 + len(messages) * self.apart_us
            reader.take(after_us, engine.encode(EEC1(engine_speed_rad_s=self.engine_rad_s(ms))))
        return reader.finish()


def within(from_ms: int, to_ms: int, inside: float, outside: float) -> Trajectory:
    return lambda ms: inside if from_ms <= ms < to_ms else outside


def out_of_gear(from_ms: int, to_ms: int) -> Trajectory:
    """In first gear but for this time."""
    return within(from_ms, to_ms, 0.0, -STROKE_M)


def the_run(content: LogContent) -> FreeRun:
    (run,) = content.runs
    return run


def test_a_run_in_neutral_holds_all_edges_of_its_time_and_where_they_are_on_their_wheels() -> None:
    box = Box(out_of_gear(500, 900), engine_rad_s=lambda ms: 100.0 + ms // 10)
    run = the_run(box.read(1.4))
    assert (run.split, run.range_) == (Split.HIGH, Range.LOW)
    assert run.start_us == BEGIN_US + 500_000
    assert run.end_us == BEGIN_US + 890_000
    for wheel, rad_s, teeth in ((run.layshaft, LAYSHAFT_RAD_S, SHEET.wheels.layshaft.teeth),
                                (run.main, MAIN_RAD_S, SHEET.wheels.main.teeth)):  # fmt: skip
        half_us = math.pi * 1e6 / teeth / rad_s
        first = math.floor((run.start_us - BEGIN_US) / half_us) + 1
        last = math.floor((run.end_us - BEGIN_US) / half_us)
        numbers = np.arange(first, last + 1)
        assert wheel.time_us == pytest.approx(BEGIN_US + half_us * numbers, abs=0.6)
        assert np.diff(wheel.theta_rad) == pytest.approx(math.pi / teeth)
        assert (np.diff(wheel.place) % (2 * teeth) == 1).all()
        assert wheel.place[0] % 2 == numbers[0] % 2, "odd ones fall"
    times = run.engine[0]
    assert times[0] == pytest.approx(run.start_us - 30_000, abs=11_000)
    assert times[0] >= run.start_us - 30_000
    assert np.diff(run.engine[1]) == pytest.approx(1.0, abs=0.014)


def test_a_run_goes_with_the_brake_s_switches_and_pressures_and_the_mean_of_the_air() -> None:
    """Switches from two seconds before on, pressures from three reads before on, up to its end."""

    def brake(action: ValveAction, ms: int) -> ValveCommand:
        return ValveCommand(brake_action=action, brake_time_us=BEGIN_US + 1000 * ms + 500)

    commands = {90: brake(ValveAction.ON_AT, 100), 190: brake(ValveAction.OFF_AT, 200),
                390: brake(ValveAction.ON_AT, 400), 2_590: brake(ValveAction.OFF_AT, 2_600),
                2_890: brake(ValveAction.ON_AT, 2_900)}  # fmt: skip
    box = Box(out_of_gear(2_400, 2_800), brake_pa=lambda ms: 1e5 + 100.0 * ms,
              supply_pa=lambda ms: 9e5 - 100.0 * ms, commands=commands)  # fmt: skip
    run = the_run(box.read(3.2))
    expected = [(400, True), (2_600, False)]
    assert run.brake == tuple(Switch(BEGIN_US + 1000 * ms + 500, on, True) for ms, on in expected)
    ms = (run.pressure[0] - BEGIN_US) / 1000.0
    assert ms.tolist() == list(range(2_370, 2_791, 10))
    assert run.pressure[1] == pytest.approx(1e5 + 100.0 * ms, abs=30.0)
    assert run.supply_pa == pytest.approx(9e5 - 100.0 * 2_590, abs=2_500.0)


@pytest.mark.parametrize(
    "change",
    [
        {"clutch": lambda _: 0.9},
        {"split": lambda _: 0.0},
        {"third": lambda _: 0.62 * SHEET.sleeve.to_contact_m},
        {"without_edges": (600, 760)},
    ],
    ids=["closed clutch", "no split", "a sleeve near its teeth", "edges lost"],
)
def test_it_is_no_run_in_neutral_with(change: dict[str, Trajectory]) -> None:
    assert not list(Box(out_of_gear(500, 900), **change).read(1.4).runs)  # type: ignore[arg-type]


def test_a_splitter_that_changes_spoils_a_run_and_begins_another() -> None:
    """The layshaft was not free to its end; while the splitter stands between its steps there is no
    run."""
    split: Trajectory = lambda ms: STROKE_M if ms < 700 else (0.0 if ms < 760 else -STROKE_M)  # noqa: E731
    run = the_run(Box(out_of_gear(400, 1_200), split=split).read(1.6))
    assert run.start_us - BEGIN_US == 770_000
    assert run.split is Split.LOW


def pushed(begun_ms: int, rest_m: float = 0.0, direction: int = 1) -> Trajectory:
    """A sleeve at rest that takes 40 ms to its stroke's end, the faster the further, and comes back
    after 600 ms."""

    def at(ms: int) -> float:
        since = ms - begun_ms
        if since < 0 or since > 600:
            return rest_m
        return rest_m + direction * min(STROKE_M, STROKE_M * (since / 40.0) ** 3)

    return at


def second_on(ms: int, action: ValveAction = ValveAction.ON_AT) -> dict[int, ValveCommand]:
    """Second gear's valve, sent 10 ms before; off again 300 ms later."""
    off = ValveCommand(main_second_action=ValveAction.OFF_AT,
                       main_second_time_us=BEGIN_US + 1000 * (ms + 300))  # fmt: skip
    on = ValveCommand(main_second_action=action, main_second_time_us=BEGIN_US + 1000 * ms + 300)
    return {ms - 10: on, ms + 290: off}


def test_a_contact_is_reported_of_the_gear_whose_valve_was_switched_on() -> None:
    """Of a sleeve at rest that comes to the faces 29.9 ms after it has begun to move; the other way
    is first gear."""
    first = ValveCommand(main_first_action=ValveAction.ON_AT,
                         main_first_time_us=BEGIN_US + 1_300_300)  # fmt: skip
    box = Box(lambda ms: pushed(520)(ms) + pushed(1_320, 0.0, -1)(ms),
              commands={**second_on(500), 1_290: first})  # fmt: skip
    content = box.read(1.7)
    ms = [1e-3 * (one.measured_us - BEGIN_US) for _, one in content.contacts]
    assert [gear for gear, _ in content.contacts] == [MainGear.SECOND, MainGear.FIRST]
    assert [one.fired_us - BEGIN_US for _, one in content.contacts] == [500_300, 1_300_300]
    meets_ms = 40.0 * math.cbrt(SHEET.sleeve.to_contact_m / STROKE_M)
    assert ms == pytest.approx([520.0 + meets_ms, 1_320.0 + meets_ms], abs=1.0)
    assert content.moved == {Sleeve.FIRST_SECOND}
    assert content.inexact == 0


def test_a_splitter_with_dog_teeth_has_contacts_as_a_main_gear_and_one_with_cones_none() -> None:
    on, off = (
        ValveCommand(split_high_action=action, split_high_time_us=BEGIN_US + 1000 * ms + 300)
        for action, ms in ((ValveAction.ON_AT, 500), (ValveAction.OFF_AT, 800))
    )
    dog, cones = (
        Box(split=pushed(520), commands={490: on, 790: off}, sheet=sheet).read(1.0)
        for sheet in (load_sheet("truck12-dog"), SHEET)
    )
    ((gear, contact),) = dog.contacts
    assert (gear, contact.fired_us - BEGIN_US) == (SplitGear.HIGH_SPLIT, 500_300)
    assert dog.moved == {Sleeve.SPLITTER}
    assert (list(cones.contacts), cones.moved) == ([], set())


def test_a_firing_at_no_commanded_time_is_counted() -> None:
    content = Box(pushed(520), commands=second_on(500, ValveAction.ON_NOW)).read(1.0)
    assert content.inexact == 1
    assert Box().read(0.5).moved == set()


@pytest.mark.parametrize("begins_us", [None, 0, 300, 5_000, 9_900])
def test_what_is_switched_at_once_is_so_when_its_command_came_wherever_the_log_begins(
    begins_us: int | None,
) -> None:
    """Within the way of the soonest frame, 0.1 ms. A log's times were up to 2.5 ms apart by where
    between two reads it began."""
    on = second_on(500, ValveAction.ON_NOW)
    content = Box(pushed(520), commands=on, apart_us=400, begins_us=begins_us).read(1.0)
    ((_, contact),) = content.contacts
    assert contact.fired_us == pytest.approx(BEGIN_US + 490_050, abs=101)


def test_a_pulse_within_a_step_moves_its_sleeve_as_any_other() -> None:
    """First gear's valve is on for 9.6 ms between two reads: the stroke into second, 12 ms later,
    is expected to come the later for it. Such a pulse was not known of."""
    on = second_on(500)
    first_on = ValveCommand(main_first_action=ValveAction.ON_AT,
                            main_first_time_us=BEGIN_US + 488_200)  # fmt: skip
    first_off = on[490]._replace(main_first_action=ValveAction.OFF_AT,
                                 main_first_time_us=BEGIN_US + 497_800)  # fmt: skip
    expected_us = []
    for begun_ms, commands in ((518, on), (522, on | {480: first_on, 490: first_off})):
        box = Box(pushed(begun_ms), commands=commands, begins_us=8_000)
        ((_, contact),) = box.read(1.0).contacts
        expected_us.append(contact.expected_us)
    assert expected_us[1] > expected_us[0] + 1_000.0


def closing_clutch(begun_ms: int, ms_taken: int) -> Trajectory:
    return lambda ms: min(max((ms - begun_ms) / ms_taken, 0.0), 1.0)


def test_a_clutch_that_closes_is_reported_with_the_engine_beside_it() -> None:
    box = Box(clutch=closing_clutch(500, 200), engine_rad_s=lambda ms: 150.0 - ms // 50)
    (closing,) = box.read(1.0).closings
    ms = (closing.time_us - BEGIN_US) / 1000.0
    assert ms.tolist() == list(range(500, 691, 10))
    assert closing.closed == pytest.approx((ms - 500.0) / 200.0, abs=0.003)
    engine_ms = (closing.engine_us - BEGIN_US) / 1000.0
    assert engine_ms[0] == pytest.approx(400.0, abs=10.5)
    assert engine_ms[-1] == pytest.approx(690.0, abs=20.5)
    assert closing.engine_rad_s == pytest.approx(150.0 - engine_ms // 50, abs=1.01)


NOW_US = 5_000_000


def brake_at(time_us: int, action: ValveAction = ValveAction.ON_AT) -> ValveCommand:
    return ValveCommand(brake_action=action, brake_time_us=time_us)


@pytest.mark.parametrize(
    ("ahead_us", "is_taken"),
    [(100_000, True), (100_001, False), (0, True), (-1, True), (-2_000, True), (-2_001, False)],
)
def test_an_activation_is_taken_from_2_ms_late_to_100_ms_ahead(
    ahead_us: int, is_taken: bool
) -> None:
    """At its own time, exactly, even where it came too late for that."""
    valves = ValveSwitches()
    valves.take(brake_at(NOW_US + ahead_us), NOW_US)
    expected = [Switch(NOW_US + ahead_us, True, True)] if is_taken else []
    assert valves.of(BRAKE, NOW_US + 1_000_000) == expected
    assert valves.late == (ahead_us < -2_000)


def test_a_valve_has_one_activation_that_waits_and_off_at_once_ends_it() -> None:
    """The next one takes its place even where it is refused; one that is repeated is one."""
    valves = ValveSwitches()
    off_now = ValveCommand(brake_action=ValveAction.OFF_NOW)
    for at_us, command in (
        (0, brake_at(NOW_US + 20_000)),
        (5_000, brake_at(NOW_US + 30_000)),
        (31_000, brake_at(NOW_US + 30_000)),
        (40_000, brake_at(NOW_US + 90_000, ValveAction.OFF_AT)),
        (50_000, off_now),
        (60_000, brake_at(NOW_US + 80_000)),
        (70_000, brake_at(NOW_US + 900_000)),
    ):
        valves.take(command, NOW_US + at_us)
    assert valves.of(BRAKE, NOW_US + 2_000_000) == [
        Switch(NOW_US + 30_000, True, True), Switch(NOW_US + 50_000, False, False),
    ]  # fmt: skip


@pytest.mark.parametrize(("first_ahead_us", "is_taken"), [(150_000, False), (100_000, True)])
def test_an_activation_that_was_refused_is_refused_however_often_it_is_sent(
    first_ahead_us: int, is_taken: bool
) -> None:
    """As the drivers do it: the first reception decides. A brake that stays on until it is switched
    off at once has not been off at a commanded time before."""
    valves, on_us, off_us = ValveSwitches(), NOW_US, NOW_US + first_ahead_us
    valves.take(brake_at(on_us), on_us)
    for at_us in range(0, first_ahead_us, 10_000):
        valves.take(brake_at(off_us, ValveAction.OFF_AT), NOW_US + at_us)
    valves.take(ValveCommand(brake_action=ValveAction.OFF_NOW), off_us + 30_000)
    off = Switch(off_us, False, True) if is_taken else Switch(off_us + 30_000, False, False)
    assert valves.of(BRAKE, NOW_US + 1_000_000) == [Switch(on_us, True, True), off]


def test_an_activation_that_has_passed_is_not_taken_again() -> None:
    """Switched on, off at once, and the old activation resent: the brake stays off."""
    valves = ValveSwitches()
    for at_us, command in (
        (0, brake_at(NOW_US)),
        (1_000, ValveCommand(brake_action=ValveAction.OFF_NOW)),
        (1_500, brake_at(NOW_US)),
    ):
        valves.take(command, NOW_US + at_us)
    assert [one.on for one in valves.of(BRAKE, NOW_US + 100_000)] == [True, False]
