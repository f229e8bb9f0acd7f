"""Commissioning a standing box: what moves what, miswirings named, consent and its end."""

from __future__ import annotations

from dataclasses import replace

import pytest

from meshpoint.bench.virtual_time import VirtualTime
from meshpoint.commission.core import CONSENT_US, PULSE_US, CommissionCore
from meshpoint.commission.drawn import draw_sheet, withheld
from meshpoint.commission.finding import Verdict
from meshpoint.commission.measured import commissioned
from meshpoint.commission.rehearsal import (
    LIMIT_US,
    Miswiring,
    Rehearsed,
    draw_miswiring,
    rehearse,
)
from meshpoint.commission.shafts import Shaft
from meshpoint.commission.standing import standing_figures
from meshpoint.commission.verdict import judge_outputs
from meshpoint.commission.whole import WholeCommission
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import ClutchAction, ClutchCommand, ValveAction, ValveCommand
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.gears import MAIN_SLEEVES
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import Preset, Profile, RigSettings
from meshpoint.rig_sim.truck.stand import STAND

SHEET = load_sheet("truck12")
V = ValveName


@pytest.fixture(scope="module")
def sound() -> Rehearsed:
    return rehearse(SHEET, 1, Miswiring(), profile=Profile.CLEAN)


def test_a_sound_box_is_called_sound_and_every_output_was_driven(sound: Rehearsed) -> None:
    assert sound.is_right
    verdicts = {f.subject: f.verdict for f in sound.findings if f.group == "outputs"}
    assert verdicts == {valve.name.lower(): Verdict.GOOD for valve in ValveName}


def test_a_sleeve_that_is_brought_back_stops_before_the_other_gear(sound: Rehearsed) -> None:
    returns = []
    for number, trial in enumerate(sound.core.trials):
        before = [t for t in sound.core.trials[:number] if t.valve is trial.valve]
        known = {moved for earlier in before for moved in earlier.moved}
        for sleeve, way in known:
            if sleeve in MAIN_SLEEVES and trial.before_m[sleeve] * way < -SHEET.sleeve.to_contact_m:
                returns.append(max(x_m * way for _, x_m in trial.path[sleeve]))
    assert returns
    assert max(returns) < SHEET.sleeve.to_contact_m


def test_what_is_measured_at_standstill_has_an_interval_that_holds_what_the_box_is(
    sound: Rehearsed,
) -> None:
    """Against the data sheet, from which a clean box differs by some per cent."""
    wrong = replace(
        SHEET,
        sleeve=replace(SHEET.sleeve, delay_s=0.080, valve_delay_s=0.030),
        air=replace(SHEET.air, supply_gauge_pa=6e5),
    )
    measured, _ = standing_figures(wrong, sound.core)
    built = {"sleeve.delay_ms": 1e3 * SHEET.sleeve.delay_s,
             "air.supply_gauge_bar": 1e-5 * SHEET.air.supply_gauge_pa}  # fmt: skip
    assert {f"{one.table}.{one.key}" for one in measured} == built.keys()
    for one in measured:
        truth = built[f"{one.table}.{one.key}"]
        assert one.low is not None and one.high is not None
        assert one.low < one.value < one.high
        assert one.low - 0.03 * truth < truth < one.high + 0.03 * truth


@pytest.mark.parametrize("seed", [2, 16])
def test_delays_that_one_stroke_cannot_tell_are_bounds_and_no_numbers(seed: int) -> None:
    """Of brake and sleeves, in boxes whose pressure sensors lag: with seed 16 the brake's pressure
    seems to come 12.5 ms later than its valve lets it."""
    sheet = draw_sheet(SHEET, seed)
    rig = RigCore(sheet, RigSettings(seed=seed, main_speed_rpm=0.0, as_built=STAND))
    core = WholeCommission(withheld(SHEET), consents=True)
    VirtualTime([core, rig], [3_000, 1_000]).run(lambda: core.done, LIMIT_US)
    assert rig.as_built is not None
    factor = rig.as_built["sheet"]["brake_valve_delay_factor"]
    found = commissioned(core, withheld(SHEET), "0", "2026-01-01T00:00:00Z")
    assert not {"valve_delay_ms", "time_constant_ms"} & {one.key for one in found.entries}
    assert all(one.low is not None and one.high is not None for one in found.entries)
    said = {one.subject: one.text for one in found.findings}
    bound_ms = float(said["brake.valve_delay_ms"].removeprefix("at most ").split()[0])
    assert bound_ms > 1e3 * factor * sheet.brake.valve_delay_s
    assert said["brake.time_constant_ms"].startswith("at least ")
    if "sleeve.valve_delay_ms" in said:
        bound_ms = float(said["sleeve.valve_delay_ms"].removeprefix("at most ").split()[0])
        assert bound_ms > 1e3 * sheet.sleeve.valve_delay_s


@pytest.mark.parametrize(
    "wrong",
    [
        Miswiring(valves=(V.MAIN_FIRST, V.MAIN_SECOND)),
        Miswiring(valves=(V.BRAKE, V.SPLIT_LOW)),
        Miswiring(dead=V.MAIN_SECOND),
        Miswiring(sensors=(Shaft.LAYSHAFT, Shaft.MAIN)),
    ],
    ids=str,
)
def test_each_miswiring_is_named_and_nothing_else(wrong: Miswiring) -> None:
    found = rehearse(SHEET, 3, wrong, profile=Profile.CLEAN)
    assert found.is_right, [f for f in found.findings if f.verdict is Verdict.BAD]


def test_a_finding_of_a_sound_box_does_not_pass_for_another_ones(sound: Rehearsed) -> None:
    assert not Miswiring(dead=V.BRAKE).is_named_by(sound.findings)
    assert not Miswiring(valves=(V.BRAKE, V.SPLIT_LOW)).is_named_by(sound.findings)
    assert not Miswiring(sensors=(Shaft.INPUT, Shaft.MAIN)).is_named_by(sound.findings)


def test_a_bus_on_which_nothing_is_sent_names_what_is_missing() -> None:
    core = CommissionCore(SHEET, consents=True)
    while not core.done:
        core.step(core.next_step_us)
    assert core.stopped.startswith("inputs are missing: GearboxSensors, SleevesMain, SleevesAux, ")
    assert "are the other nodes on, and on this bus?" in core.stopped


def test_one_box_in_ten_is_drawn_miswired() -> None:
    drawn = [draw_miswiring(seed) for seed in range(1000)]
    assert 70 < sum(wrong.is_any for wrong in drawn) < 130
    assert len({str(wrong) for wrong in drawn}) > 20


@pytest.fixture(scope="module")
def dragged() -> tuple[CommissionCore, list[str]]:
    """A box whose engine has come to its idle speed, with the clutch open: out of gear, the plates'
    drag turns the shafts. The node that drove its outputs, and what it said."""
    settings = RigSettings(seed=1, main_speed_rpm=0.0, as_built={"vehicle.slope_percent": 0.0})
    core = CommissionCore(SHEET, consents=True)
    said: list[str] = []
    time = VirtualTime(
        [core, RigCore(SHEET, settings)],
        [8_003_000, 1_000],
        on_event=lambda _, node, line: said.append(line) if node == 0 else None,
    )
    time.run(lambda: core.done, 120_000_000)
    return core, said


def test_what_a_pulse_turns_itself_does_not_end_it(
    dragged: tuple[CommissionCore, list[str]],
) -> None:
    core, said = dragged
    assert V.MAIN_SECOND in {trial.valve for trial in core.trials if trial.moved}
    assert not [line for line in said if "pulse ended" in line]


def test_shafts_that_turn_are_no_reason_to_call_an_output_unwired(
    dragged: tuple[CommissionCore, list[str]],
) -> None:
    core, _ = dragged
    assert core.stopped.startswith("a shaft turns")
    findings = list(judge_outputs(core))
    assert [f for f in findings if f.verdict is Verdict.BAD] == []
    assert any("a shaft turns" in f.text for f in findings if f.verdict is Verdict.UNKNOWN)


class Bus:
    """A rig and a commissioning node in virtual time; every command on the bus."""

    def __init__(self, core: CommissionCore, main_rpm: float = 0.0) -> None:
        self.commands: list[tuple[int, ValveCommand]] = []
        self.clutch: set[ClutchAction] = set()
        self._receiver = Receiver(Node.GEARBOX_IO)
        rig = RigCore(SHEET, RigSettings(preset=Preset.THESIS, seed=1, main_speed_rpm=main_rpm))
        self.time = VirtualTime([core, rig], [3_000, 1_000], self._take)

    def _take(self, time_us: int, frame) -> None:
        message = self._receiver.receive(frame).message
        if isinstance(message, ValveCommand):
            self.commands.append((time_us, message))
        elif isinstance(message, ClutchCommand):
            self.clutch.add(message.action)

    def run(self, seconds: float) -> None:
        self.time.run(lambda: False, self.time.now_us + round(seconds * 1e6))

    @property
    def driven(self) -> list[tuple[int, set[V]]]:
        found = []
        for time_us, command in self.commands:
            actions = command[: len(ValveName)]
            found.append((time_us, {v for v in V if actions[v] is not ValveAction.OFF_NOW}))
        return found


def test_nothing_is_driven_without_a_yes_and_a_no_is_kept() -> None:
    core = CommissionCore(SHEET)
    bus = Bus(core)
    bus.run(2.0)
    assert core.is_asking
    first = core.question
    assert first is not None
    core.answer(False, bus.time.now_us)
    bus.run(1.0)
    assert core.question not in (None, first)
    assert {first} == core.declined
    assert not any(valves for _, valves in bus.driven)
    assert bus.clutch == {ClutchAction.OPEN}


def test_a_yes_drives_one_output_once_and_for_no_longer_than_a_pulse() -> None:
    core = CommissionCore(SHEET)
    bus = Bus(core)
    bus.run(2.0)
    asked = core.question
    core.answer(True, bus.time.now_us)
    bus.run(3.0)
    at = [time_us for time_us, valves in bus.driven if valves]
    assert {frozenset(valves) for _, valves in bus.driven} == {frozenset(), frozenset({asked})}
    assert at[-1] - at[0] <= PULSE_US + 50_000
    assert core.is_asking, "the next output waits for a yes of its own"


def test_a_yes_that_is_older_than_its_time_drives_nothing() -> None:
    core = CommissionCore(SHEET)
    bus = Bus(core)
    bus.run(2.0)
    core.answer(True, bus.time.now_us - CONSENT_US - 20_000)
    bus.run(1.0)
    assert not any(valves for _, valves in bus.driven)


def test_a_box_that_turns_is_not_touched() -> None:
    core = CommissionCore(SHEET, consents=True)
    bus = Bus(core, main_rpm=600.0)
    bus.run(32.0)
    assert core.done
    assert core.stopped.startswith("a shaft turns")
    assert not any(valves for _, valves in bus.driven)


def test_never_two_outputs_at_once() -> None:
    core = CommissionCore(SHEET, consents=True)
    bus = Bus(core)
    bus.time.run(lambda: core.done, 60_000_000)
    assert core.done
    assert max(len(valves) for _, valves in bus.driven) == 1
    assert set().union(*(valves for _, valves in bus.driven)) == set(V)
    assert bus.driven[-1][1] == set()
