"""What goes from one controller to another: by a calibration over a restart, or by following it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import is_dataclass, replace
from types import SimpleNamespace
from typing import Any

import pytest
from calibration_example import SHEET, example

from meshpoint.bus.core import Step
from meshpoint.controller.calibration.learned import (
    Calibration,
    DriftRecord,
    DriftRecords,
    ReferenceRecords,
    SleeveRecords,
    SwingRecords,
    WheelRecords,
)
from meshpoint.controller.core import ControllerCore
from meshpoint.controller.follower import Follower
from meshpoint.controller.header import RunHeader, new_header
from meshpoint.controller.motion.brake_input import BrakeInput
from meshpoint.controller.settings import ControllerSettings
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox import MainGear, load_sheet
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import Preset, Profile, RigSettings
from meshpoint.testbench.loop.virtual_time import VirtualTime

TRUCK = load_sheet("truck12")


def whole() -> Calibration:
    """One with a drift too."""
    drifts = DriftRecords(first=DriftRecord(0.05, 0.01, 0.8, 9.0))
    return replace(example(), drifts=drifts)


def header_of(calibration: Calibration | None, estimator: str = "crossing") -> RunHeader:
    settings = replace(ControllerSettings(), estimator_name=estimator)
    return new_header("2.0", SHEET, settings, calibration)


def are_alike(found: Any, given: Any) -> bool:
    """Two records of numbers, whose last digits a way through logarithms changes."""
    if is_dataclass(given):
        pairs = [(getattr(found, each), own) for each, own in vars(given).items()]
        return type(found) is type(given) and all(are_alike(*pair) for pair in pairs)
    if isinstance(given, tuple):
        return bool(found == pytest.approx(given))
    return bool(found == (pytest.approx(given) if isinstance(given, float) else given))


def test_a_controller_that_has_done_nothing_hands_on_what_it_was_given() -> None:
    """The wheels' patterns are memories until the wheels have turned, and kept as they were."""
    given = whole()
    core = ControllerCore(header_of(given))
    kept = core.calibration("at noon")
    assert vars(kept.provenance) == {
        "meshpoint": "2.0", "sheet": SHEET.name, "sheet_sha256": SHEET.sha256,
        "written": "at noon", "shifts": given.provenance.shifts,
    }  # fmt: skip
    assert (kept.format_, kept.end.complete) == (1, True)
    assert are_alike(kept.wheels, given.wheels)
    assert are_alike(kept.references, given.references)
    assert are_alike(kept.sleeves, given.sleeves)
    assert are_alike(kept.drifts, given.drifts)
    core.shifts = 5
    assert core.calibration("").provenance.shifts == given.provenance.shifts + 5
    fresh = ControllerCore(header_of(None)).calibration("")
    assert fresh.provenance.shifts == 0
    assert (fresh.wheels, fresh.references) == (WheelRecords(), ReferenceRecords())
    assert (fresh.sleeves, fresh.drifts) == (SleeveRecords(), DriftRecords())


def test_the_references_of_an_earlier_run_are_kept_while_they_may_still_be_found_again() -> None:
    core = ControllerCore(header_of(whole()))
    recovery: Any = core.observer.recovery
    assert recovery._remembered == {MainGear.SECOND: 0.05, MainGear.THIRD: -0.03}
    own = recovery.saved()
    recovery.saved = lambda: SimpleNamespace(
        layshaft=own.layshaft, main=own.main,
        offsets_rad={MainGear.CRAWL: 0.01, MainGear.FIRST: 1.3 * SHEET.dog.pitch_rad,
                     MainGear.THIRD: -0.6 * SHEET.dog.pitch_rad},
    )  # fmt: skip
    kept = core.calibration("").references
    assert kept.crawl_rad == pytest.approx(0.01)
    assert kept.first_rad == pytest.approx(0.3 * SHEET.dog.pitch_rad)
    assert kept.second_rad is None
    assert kept.third_rad == pytest.approx(0.4 * SHEET.dog.pitch_rad)


@pytest.mark.parametrize("estimator", ["window", "thesis"])
def test_a_baseline_keeps_what_it_cannot_learn_and_starts_with_delays_and_drifts(
    estimator: str,
) -> None:
    given = whole()
    core = ControllerCore(header_of(given, estimator))
    kept = core.calibration("")
    assert (kept.wheels, kept.references) == (given.wheels, given.references)
    assert (kept.brake, kept.noise, kept.swings) == (given.brake, given.noise, given.swings)
    assert are_alike(kept.sleeves, given.sleeves)
    assert are_alike(kept.drifts, given.drifts)
    assert kept.provenance.shifts == given.provenance.shifts
    none = ControllerCore(header_of(None, estimator)).calibration("")
    assert (none.wheels, none.references) == (WheelRecords(), ReferenceRecords())
    assert (none.brake, none.noise, none.swings) == (None, None, SwingRecords())
    assert none.provenance.shifts == 0


def told(known: StepSnapshot) -> tuple[Any, ...]:
    """All that is estimated, by value."""
    state = known.layshaft.at(known.now_us)
    angles = None if state is None else (state.theta_rad, state.omega_rad_s)
    main = None if known.main is None else (known.main.theta_rad, known.main.omega_rad_s)
    speeds = known.speeds
    return (
        known.now_us, known.earliest_us, angles, main, speeds.layshaft, speeds.main,
        known.view.gear_number, known.lost, known.driven, known.supply_pa,
    )  # fmt: skip


def driven_beside(core: ControllerCore, look: Callable[[int], None], until_us: int) -> None:
    """A truck in eighth gear; after each of the controller's steps somebody looks on."""

    class Looked:
        next_step_us = property(lambda _: core.next_step_us)
        receive = staticmethod(core.receive)
        shutdown = staticmethod(core.shutdown)

        @staticmethod
        def step(now_us: int) -> Step:
            made = core.step(now_us)
            look(now_us)
            return made

    rig = RigCore(TRUCK, RigSettings(preset=Preset.TRUCK, start_gear=8, profile=Profile.CLEAN))
    nodes: list[Any] = [Looked(), rig]
    VirtualTime(nodes, [20_000, 1]).run(lambda: False, until_us)


def test_a_follower_knows_to_the_bit_what_the_controller_knows() -> None:
    """Of the same frames; also in the second in which the clock is probed once more."""
    core: Any = ControllerCore(new_header("0", TRUCK, ControllerSettings()))
    follower, knew = Follower(core.header), list[tuple[Any, Any]]()

    def look(now_us: int) -> None:
        its = follower.step(core._heard, now_us, core._sequence, core.snapshot)
        knew.append((told(core.snapshot), told(its)))

    driven_beside(core, look, 1_100_000)
    assert len(knew) > 100
    for mine, its in knew:
        assert its == mine
    last = knew[-1][1]
    assert last[6] == 8
    assert None not in last[2:6]
    theirs: Any = follower
    assert theirs._probe._probed_us == core._probe._probed_us > 1_000_000


class First:
    """The sequence of the controller that is followed."""

    def __init__(self) -> None:
        self.brake = BrakeInput(12_000)
        self.shift: Any = None
        self.finished: Any = None
        self.references = SimpleNamespace(watched=None)


SEEN: Any = SimpleNamespace(
    earliest_us=1_004_000, now_us=1_000_000, lost=3, driven=(True,) * 9, supply_pa=7e5
)


def stepped(follower: Follower, first: First, frames: list[Frame] | None = None) -> StepSnapshot:
    sequence: Any = first
    return follower.step(frames or [], 500_000, sequence, SEEN)


def test_a_follower_is_made_by_its_own_header() -> None:
    follower = Follower(header_of(whole()))
    assert follower.brake.off_delay_us == pytest.approx(9_800)
    assert are_alike(follower.delays.records(), whole().sleeves)
    assert are_alike(follower.drifts.records(), whole().drifts)
    bare = Follower(header_of(None, "window"))
    assert bare.brake.off_delay_us == round(1e6 * SHEET.brake.valve_delay_s)
    assert bare.header.settings.estimator_name == "window"


def test_what_a_follower_cannot_know_it_takes_from_the_first() -> None:
    """What is lost or driven, and how far ahead an activation has to be."""
    its = stepped(Follower(header_of(None)), First())
    assert its.earliest_us - its.now_us == 4_000
    assert (its.lost, its.driven) == (3, (True,) * 9)
    assert its.supply_pa == float("inf")


def test_the_first_one_s_brake_commands_are_the_follower_s() -> None:
    follower, first = Follower(header_of(None)), First()
    first.brake.schedule(100_000, True, 0)
    first.brake.schedule(180_000, False, 120_000)
    stepped(follower, first)
    assert follower.brake.switches == first.brake.switches
    assert len(follower.brake.switches) == 2


def a_shift(contact_us: int | None, fired_us: int | None, attempts: int = 1) -> Any:
    plan = None if fired_us is None else SimpleNamespace(fire_us=fired_us)
    return SimpleNamespace(
        measured_contact_us=contact_us, plan=plan, request_us=9, attempts=attempts,
        target=SimpleNamespace(main=MainGear.THIRD),
    )  # fmt: skip


def test_the_first_one_s_contacts_are_learned_once_each() -> None:
    """While it lasts a shift is the one under way, then the one that has ended."""
    follower, first = Follower(header_of(None)), First()
    delays = follower.delays
    before_us = delays.delay_us(MainGear.THIRD)
    for contact_us, fired_us in ((None, 900_000), (947_000, None), (None, None)):
        first.shift = a_shift(contact_us, fired_us)
        stepped(follower, first)
    assert delays.samples(MainGear.THIRD) == 0
    first.shift, first.finished = a_shift(900_000 + before_us + 3_000, 900_000), a_shift(None, None)
    stepped(follower, first)
    stepped(follower, first)
    assert delays.samples(MainGear.THIRD) == 1
    assert delays.delay_us(MainGear.THIRD) == pytest.approx(before_us + 2_000, abs=1)
    first.shift = a_shift(900_000 + before_us, 900_000, attempts=2)
    stepped(follower, first)
    assert delays.samples(MainGear.THIRD) == 2
    first.shift, first.finished = None, first.shift
    stepped(follower, first)
    assert delays.samples(MainGear.THIRD) == 2
    first.finished = a_shift(900_000 + before_us, 900_000, attempts=3)
    stepped(follower, first)
    assert delays.samples(MainGear.THIRD) == 3


def test_a_gear_that_has_locked_is_watched_by_the_follower_from_then_on() -> None:
    """Each lock once: the same one is not begun again."""
    follower, first = Follower(header_of(None)), First()
    locks: list[tuple[MainGear, float, bool]] = []
    follower.observer.references.locked = lambda *args: locks.append(args)  # type: ignore[assignment, misc]
    stepped(follower, first)
    one = SimpleNamespace(gear=MainGear.FIRST, flank=-1, straight=False)
    for watched in (one, one, None, one, SimpleNamespace(**vars(one))):
        first.references.watched = watched
        stepped(follower, first)
    assert locks == [(MainGear.FIRST, -1.0, False)] * 3
