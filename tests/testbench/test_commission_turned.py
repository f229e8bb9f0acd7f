"""Commissioning with turning shafts: teeth, ratios, kiss point and sensors without a data sheet."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.bench.virtual_time import VirtualTime
from meshpoint.commission.core import CONSENT_US, CommissionCore
from meshpoint.commission.drawn import draw_sheet, withheld
from meshpoint.commission.edge_log import EdgeLog, State
from meshpoint.commission.finding import Verdict
from meshpoint.commission.kiss import kiss_points
from meshpoint.commission.measured import (
    Commissioned,
    _meshes,
    _wheels,
    commissioned,
    with_entries,
)
from meshpoint.commission.rehearsal import (
    POSITION_PAIRS,
    Hearing,
    MiswiredRig,
    Miswiring,
    findings_of,
    rehearse_turned,
)
from meshpoint.commission.roles import Turning, judge_turning
from meshpoint.commission.running import RunningCore
from meshpoint.commission.shafts import Shaft
from meshpoint.commission.standing import standing_figures
from meshpoint.commission.trial import EXPECTED
from meshpoint.commission.wheels import (
    GEAR_STATES,
    HIGH_STATE,
    SPLIT_STATES,
    fraction_of,
    tooth_count,
)
from meshpoint.commission.whole import WholeCommission, wires_of
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import (
    TSC1,
    ClutchAction,
    ClutchCommand,
    Message,
    ValveAction,
    ValveCommand,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.gears import MAIN_GEARS, MainGear, Range, Sleeve, SleeveSide, Split
from meshpoint.gearbox.keys import groups_of, to_toml
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.gearbox.tables import parse_toml, read_group
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import Profile, RigSettings
from meshpoint.rig_sim.truck.stand import STAND
from meshpoint.units import MS

TRUCK = load_sheet("truck12")
WIRES = {SleeveSide(*moved): valve for valve, moved in EXPECTED.items()}
SEED = 5


@pytest.fixture(scope="module")
def turned() -> tuple[GearboxSheet, WholeCommission, dict]:
    """A drawn box whose sheet is withheld, and its values as built."""
    sheet = draw_sheet(TRUCK, SEED)
    settings_ = RigSettings(seed=SEED, main_speed_rpm=0.0, profile=Profile.CLEAN, as_built=STAND)
    rig = RigCore(sheet, settings_)
    core = WholeCommission(withheld(TRUCK), consents=True, turns=True)
    VirtualTime([core, rig], [3_000, 1_000]).run(lambda: core.done, 300_000_000)
    assert rig.as_built is not None
    return sheet, core, rig.as_built


@pytest.fixture(scope="module")
def found(turned) -> Commissioned:
    """What was measured of that box."""
    _, core, _ = turned
    return commissioned(core, withheld(TRUCK), "0", "2026-01-01T00:00:00Z")


def test_every_tooth_count_and_every_ratio_is_found_without_a_sheet(turned) -> None:
    sheet, core, _ = turned
    assert not core.running.stopped
    found = Commissioned(withheld(TRUCK))
    _wheels(found, core.running.log)
    _meshes(found, core.running.log)
    measured = with_entries(found.sheet, found.entries)
    assert not found.findings
    for field in ("input_", "layshaft", "main", "propeller"):
        assert getattr(measured.wheels, field).teeth == getattr(sheet.wheels, field).teeth
    for gear in MAIN_GEARS:
        assert measured.main_mesh(gear).exact == sheet.main_mesh(gear).exact
    for split in Split:
        assert measured.split_mesh(split).exact == sheet.split_mesh(split).exact
    for range_ in Range:
        assert measured.range_mesh(range_).exact == sheet.range_mesh(range_).exact


def test_the_kiss_point_is_found_by_the_input_shaft(turned) -> None:
    sheet, core, built = turned
    edges_us = core.running.log.tracks[Shaft.INPUT, 0].times
    shares = kiss_points(core.running.closings, edges_us, sheet.wheels.input_.teeth)
    assert shares.size >= 10
    assert float(np.median(shares)) == pytest.approx(built["clutch"]["kiss"], abs=0.015)


def test_the_law_of_the_sleeves_is_told_and_goes_into_the_calibration(turned, found) -> None:
    """Of the valves of a box, whose data sheet is withheld."""
    sheet, _, _ = turned
    delays_ms = [one.value for one in found.sleeve_law]
    assert delays_ms
    assert abs(np.median(delays_ms) - 1e3 * sheet.sleeve.valve_delay_s) < 2.0
    assert found.calibration is not None
    laws = found.calibration.sleeve_laws
    assert laws.first_second is not None
    assert laws.crawl_third is not None
    assert laws.crawl_third.movements > 4
    assert found.calibration.sleeves.third is not None


def test_every_figure_has_an_interval_and_it_holds_what_the_box_is(turned, found) -> None:
    """But for counts of teeth and for a tolerance. The brake's delay is measured by turning, within
    half a millisecond, and no bound of it is left: it read 29 ms of a valve of 10.8 while brake
    pulses of more than 100 ms were ended by a command that the drivers refuse."""
    sheet, _, built = turned
    without = "teeth_driving", "teeth_driven", "teeth", "kiss_tolerance_percent"
    measured = {f"{one.table}.{one.key}": one for one in found.entries if one.key not in without}
    assert all(one.low is not None and one.high is not None for one in measured.values())
    factor, brake, clutch = built["sheet"], sheet.brake, sheet.clutch
    supply_bar = 1e-5 * sheet.air.supply_gauge_pa + built["air"]["supply_offset_bar"]
    for key, truth in (
        ("brake.valve_delay_ms", 1e3 * brake.valve_delay_s * factor["brake_valve_delay_factor"]),
        ("clutch.open_delay_ms", 1e3 * clutch.open_delay_s * factor["clutch_open_factor"]),
        ("clutch.close_delay_ms", 1e3 * clutch.close_delay_s * factor["clutch_close_factor"]),
        ("clutch.kiss_percent", 100.0 * built["clutch"]["kiss"]),
        ("air.supply_gauge_bar", supply_bar),
    ):
        one = measured[key]
        assert one.low <= truth <= one.high, (key, one, truth)
    delay = measured["brake.valve_delay_ms"]
    assert delay.high - delay.low < 1.5
    assert "brake.valve_delay_ms" not in {one.subject for one in found.findings}


def test_no_pulse_of_either_part_ends_by_a_command_that_the_drivers_refuse(turned) -> None:
    """An activation more than 100 ms ahead: the valve would stay on until it is switched off at
    once, tens of ms later."""
    _, core, _ = turned
    receiver, refused = Receiver(*Node), set()
    for _, frame in core.recorded:
        message = receiver.receive(frame).message
        if isinstance(message, ValveStatus):
            refused.add(message.refused_count)
    assert refused == {0}


def test_a_sound_box_that_was_turned_is_called_sound(turned) -> None:
    _, core, _ = turned
    findings = list(findings_of(core))
    assert all(finding.verdict is Verdict.GOOD for finding in findings), findings
    assert {f.subject for f in findings} >= {f"{shaft} sensor turned" for shaft in Shaft}


def test_a_measured_sheet_can_be_written_and_read_back(turned) -> None:
    """Values as measured, of all their digits, are those of no file."""
    _, core, _ = turned
    entries, _ = standing_figures(withheld(TRUCK), core.standing)
    assert entries
    measured = with_entries(withheld(TRUCK), entries)
    text = to_toml(groups_of(GearboxSheet, measured), "measured")
    assert read_group(GearboxSheet, parse_toml(text, "x"), "x") == measured


def made_turning(places: dict[Shaft, Shaft] | None = None, **wrong: float) -> Turning:
    """Rates of a box; places: the shaft on which each sensor sits. wrong: rates by gear."""
    places = places or {shaft: shaft for shaft in Shaft}
    gears = {"crawl": 0.3, "first": 0.43, "second": 0.68, "third": 1.06} | wrong
    turning = Turning(EdgeLog())
    for state in (*GEAR_STATES.values(), *SPLIT_STATES.values(), HIGH_STATE):
        layshaft = 0.77 if state.split is Split.LOW else 0.95
        main = 0.9  # coasts
        if state.gear is not MainGear.NEUTRAL:
            main = layshaft * gears[state.gear.name.lower()]
        propeller = main * (0.27 if state.range_ is Range.LOW else 1.0)
        true = dict(zip(Shaft, (40.0, 43 * layshaft, 45 * main, 42 * propeller), strict=True))
        turning.rates[state] = {sensor: true[places[sensor]] for sensor in Shaft}
    return turning


def test_sensors_of_two_shafts_that_are_exchanged_are_named_whichever_two() -> None:
    for a, b in combinations(Shaft, 2):
        turning = made_turning({shaft: shaft for shaft in Shaft} | {a: b, b: a})
        bad = {f.subject: f.text for f in turning.sensors() if f.verdict is Verdict.BAD}
        assert bad == {
            f"{a} sensor turned": f"the sensors of {a} and {b} are exchanged",
            f"{b} sensor turned": f"the sensors of {b} and {a} are exchanged",
        }


def test_a_silent_sensor_is_named_and_no_other() -> None:
    turning = made_turning()
    for seen in turning.rates.values():
        seen[Shaft.MAIN] = 0.0
    bad = [f.subject for f in turning.sensors() if f.verdict is Verdict.BAD]
    assert bad == ["main sensor turned"]


def test_a_sleeve_whose_gears_ratios_are_the_other_way_round_is_not_believed() -> None:
    assert all(is_true for _, is_true in made_turning().order())
    reported = dict(made_turning(first=0.68, second=0.43).order())
    assert reported == {
        Sleeve.FIRST_SECOND: False,
        Sleeve.CRAWL_THIRD: True,
        Sleeve.SPLITTER: True,
        Sleeve.RANGE: True,
    }


def test_what_was_not_turned_is_not_judged() -> None:
    (finding,) = judge_turning(EdgeLog(), WIRES)
    assert finding.verdict is Verdict.UNKNOWN


def test_outputs_are_all_found_where_the_main_sleeves_position_sensors_are_exchanged() -> None:
    """The gear that is in cannot be taken out by the output of its name."""
    core = CommissionCore(TRUCK, consents=True)
    settings_ = RigSettings(seed=4, main_speed_rpm=0.0, profile=Profile.CLEAN, as_built=STAND)
    rig = MiswiredRig(RigCore(TRUCK, settings_), Miswiring(positions=POSITION_PAIRS[0]))
    VirtualTime([core, rig], [3_000, 1_000]).run(lambda: core.done, 60_000_000)
    wires = wires_of(core)
    assert wires is not None
    assert wires[SleeveSide(Sleeve.CRAWL_THIRD, -1)] is ValveName.MAIN_FIRST
    assert wires[SleeveSide(Sleeve.FIRST_SECOND, 1)] is ValveName.MAIN_THIRD


@given(st.integers(17, 61), st.integers(17, 61), st.floats(-1.0, 1.0))
def test_a_ratio_of_two_wheels_is_found_or_not_reported_but_never_another(a, b, off) -> None:
    tolerance = 3e-5
    found = fraction_of(a / b * (1.0 + off * tolerance * 0.9), tolerance)
    assert found in (None, Fraction(a, b))


@given(st.integers(17, 45), st.integers(17, 45))
def test_a_ratio_of_small_wheels_is_reported(a, b) -> None:
    assert fraction_of(a / b, 3e-5) == Fraction(a, b)


@settings(max_examples=20)
@given(st.integers(24, 80), st.integers(0, 1000))
def test_a_wheels_teeth_are_counted_by_their_own_errors(teeth, seed) -> None:
    rng = np.random.Generator(np.random.PCG64(seed))
    errors = rng.uniform(-0.1, 0.1, teeth) * math.tau / 360.0
    edges = np.arange(20 * teeth)
    angles = edges * math.tau / teeth + np.tile(errors, 20)
    # The wheel slows evenly while it turns.
    times = 1e6 * angles / 100.0 * (1.0 + 1e-4 * angles) + rng.normal(0.0, 8.0, edges.size)
    assert tooth_count(times) == teeth


def test_a_wheel_made_well_is_counted_by_many_windows_together() -> None:
    """One window alone does not tell it: its errors are little more than the stamps' jitter."""
    rng = np.random.Generator(np.random.PCG64(3))
    errors = rng.uniform(-0.04, 0.04, 38) * math.tau / 360.0
    windows = []
    for _ in range(7):
        angles = np.arange(1500) * math.tau / 38 + np.tile(errors, 40)[:1500]
        windows.append(1e6 * angles / 100.0 + rng.normal(0.0, 8.0, 1500))
    assert tooth_count(*windows) == 38
    assert [tooth_count(window) for window in windows].count(38) < 7


def test_teeth_that_are_all_alike_are_not_counted() -> None:
    rng = np.random.Generator(np.random.PCG64(1))
    times = np.arange(900) * 1500.0 + rng.normal(0.0, 8.0, 900)
    assert tooth_count(times) is None


@pytest.mark.long
def test_a_gearbox_of_a_truck_on_the_stand_comes_to_rest_at_the_end() -> None:
    """Its profile gives it axle shafts, wheels and a clutch that drags; the stand has no axle."""
    settings_ = RigSettings(seed=1, main_speed_rpm=0.0, profile=Profile.TYPICAL, as_built=STAND)
    core = WholeCommission(TRUCK, consents=True, turns=True)
    VirtualTime([core, RigCore(TRUCK, settings_)], [3_000, 1_000]).run(
        lambda: core.done, 300_000_000
    )
    assert core.standing.stopped == ""
    assert core.running is not None
    assert core.running.done
    assert core.running.stopped == ""
    assert [f for f in findings_of(core) if f.verdict is Verdict.BAD] == []


class Bus:
    """A rig on a stand and the running node; every command on the bus."""

    def __init__(self, core: RunningCore) -> None:
        self.heard: list[Message] = []
        self._receiver = Receiver(*Node)
        rig = RigCore(TRUCK, RigSettings(seed=1, main_speed_rpm=0.0, as_built=STAND))
        self.time = VirtualTime([core, rig, Hearing(self._take)], [3_000, 1_000, 1 << 62])

    def _take(self, frame) -> None:
        message = self._receiver.receive(frame).message
        if isinstance(message, (ValveCommand, ClutchCommand, TSC1)):
            self.heard.append(message)

    def run(self, seconds: float) -> None:
        self.heard.clear()
        self.time.run(lambda: False, self.time.now_us + round(seconds * 1e6))

    @property
    def driven(self) -> set[str]:
        return {
            name
            for message in self.heard
            if isinstance(message, ValveCommand)
            for name, action in message._asdict().items()
            if name.endswith("_action") and action is not ValveAction.OFF_NOW
        }

    @property
    def turned(self) -> bool:
        closed = ClutchCommand(action=ClutchAction.CLOSE)
        return any(
            message.action is closed.action
            for message in self.heard
            if isinstance(message, ClutchCommand)
        )


def test_no_gear_is_pushed_in_and_nothing_is_turned_without_a_yes() -> None:
    core = RunningCore(TRUCK, WIRES)
    bus = Bus(core)
    bus.time.run(lambda: core.is_asking, 10_000_000)
    asked = core.question
    assert asked is not None
    assert "crawl" in asked
    bus.run(1.0)
    assert not bus.driven
    assert not bus.turned
    core.answer(True, bus.time.now_us - CONSENT_US - 20_000)
    bus.run(0.5)
    assert core.is_asking, "a yes that is too old is none"
    core.answer(False, bus.time.now_us)
    bus.time.run(lambda: core.is_asking and core.question != asked, bus.time.now_us + 9_000_000)
    assert core.declined == {"crawl"}
    assert not bus.turned
    core.answer(True, bus.time.now_us)
    bus.run(3.0)
    assert bus.driven <= {"brake_action", "main_first_action", "main_second_action"}
    assert "main_first_action" in bus.driven


def test_a_shutdown_leaves_all_off_and_the_clutch_open() -> None:
    core = RunningCore(TRUCK, WIRES, consents=True)
    bus = Bus(core)
    bus.time.run(lambda: bus.turned, 20_000_000)
    assert bus.turned
    receiver = Receiver(*Node)
    last = [receiver.receive(frame).message for frame in core.shutdown(bus.time.now_us).frames]
    assert last[0] == ValveCommand()
    assert last[1] == ClutchCommand()
    assert core.done


def test_too_little_air_ends_it() -> None:
    starved = replace(TRUCK, air=replace(TRUCK.air, supply_gauge_pa=16e5))
    core = RunningCore(starved, WIRES)
    bus = Bus(core)
    bus.time.run(lambda: core.done, 5_000_000)
    assert core.stopped == "too little air"
    assert not bus.driven


def test_drawn_sheets_differ_in_everything_that_is_withheld() -> None:
    one, other, blank = draw_sheet(TRUCK, 1), draw_sheet(TRUCK, 2), withheld(TRUCK)
    for sheet in (one, other):
        assert all(
            sheet.main_mesh(gear).exact != blank.main_mesh(gear).exact for gear in MAIN_GEARS
        )
        assert sheet.brake != blank.brake
        assert sheet.sleeve != blank.sleeve
        assert sheet.clutch != blank.clutch
        assert sheet.air != blank.air
        assert sheet.dog == blank.dog
    assert one != other
    assert State(Split.LOW, MainGear.THIRD, Range.HIGH) == HIGH_STATE


def test_a_splitter_with_dog_teeth_is_brought_in_at_standstill_and_its_valves_are_told() -> None:
    """While it turned it met the other step at 300 rpm and stayed before the teeth: its ratios were
    said to be those of other sides."""
    drawn = draw_sheet(load_sheet("truck12-dog"), 1)
    turned = rehearse_turned(drawn, 1, Miswiring(), Profile.CLEAN)
    assert all(one.verdict is not Verdict.BAD for one in turned.findings)
    made = commissioned(turned.core, withheld(drawn), "0", "2026-01-01T00:00:00Z")
    assert made.sheet.splitter == drawn.splitter
    told = {one.name: one for one in made.sleeve_law}
    delay_ms = drawn.sleeve.valve_delay_s / MS
    for step in ("low_split", "high_split"):
        for way in ("on", "off"):
            figure = told[f"sleeve valve {step} {way} delay"]
            assert figure.low is not None
            assert figure.high is not None
            assert figure.low < delay_ms < figure.high
