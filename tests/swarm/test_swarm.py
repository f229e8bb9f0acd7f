"""The swarm: what it draws, what it sees, what it makes small; and every deed under the guard."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import pytest

from benchmarks.swarm.aimed import AIMS, Aim
from benchmarks.swarm.command import main
from benchmarks.swarm.deeds import DEEDS
from benchmarks.swarm.draw import draw_world
from benchmarks.swarm.episode import Episode, EpisodeResult, declared
from benchmarks.swarm.events import (
    FAULT_KINDS,
    REQUEST,
    Event,
    World,
    load_world,
    save_world,
)
from benchmarks.swarm.shrink import shrink
from benchmarks.swarm.swarm import SwarmSpec, breaks
from meshpoint.controller.guard.rules import Guard
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Profile

SHEET, SETTINGS = load_sheet("truck12"), ControllerSettings()
SPEC = SwarmSpec(SHEET, SETTINGS, 1)
IN_THE_SUITE = ("mad_two_sleeves", "mad_slip", "mad_blind")


def run(world: World) -> EpisodeResult:
    """In a gearbox of the profile in which the worlds of this file were found."""
    return Episode(SHEET, SETTINGS, world, Profile.CLEAN).run()


def deed_alone(name: str) -> World:
    """A deed alone, with a request after it."""
    deed = DEEDS[name]
    at_ms = 0 if deed.begins is None else 900
    events = [Event(at_ms, name, 0, 0.0, 4_000)]
    if deed.begins is not None and deed.begins.name != "IN_GEAR":
        events.append(Event(1_000, REQUEST, 0, float(deed.asks)))
    speed, has_dog = deed.layshaft_rpm, deed.dog_splitter
    return World(6, deed.start_gear, speed, {}, tuple(sorted(events)), 5_000, has_dog)


def deeds() -> Iterator[Any]:
    """Of all, the suite runs one that drives valves, one that blinds and one that says nothing."""
    for name in DEEDS:
        yield pytest.param(name, marks=() if name in IN_THE_SUITE else (pytest.mark.long,))


@pytest.mark.parametrize("name", list(deeds()))
def test_a_deed_meets_its_row_of_the_guard_does_no_harm_and_shifts_come_back(name: str) -> None:
    result = run(deed_alone(name))
    assert result.broken == []
    row = DEEDS[name].row
    assert result.reached.faults[name] == 1
    assert not row or result.reached.guard_rows[str(row)] > 0, result.reached.guard_rows


def test_every_row_of_the_guard_has_a_deed() -> None:
    assert {str(deed.row) for deed in DEEDS.values() if deed.row} == set(declared()["guard_rows"])


def test_all_that_can_be_drawn_is_drawn() -> None:
    drawn = Counter(event.kind for seed in range(1_500) for event in draw_world(seed).events)
    assert set(FAULT_KINDS) | {REQUEST} == set(drawn)


def test_a_seed_is_a_world_is_a_trajectory() -> None:
    world = replace(draw_world(6), safety_ms=2_500)
    assert draw_world(6) == draw_world(6) != draw_world(7)
    first, again = run(world), run(world)
    assert first == again
    assert first.shifts


def test_what_a_blind_guard_lets_through_is_seen_made_small_and_repeated_from_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Guard, "passes", lambda self, payload, seen: True)
    monkeypatch.setattr(Guard, "is_proven", True)
    noise = [Event(400 + 500 * k, "bus_duplicate", 5, 0.02, 40) for k in range(4)]
    events = (Event(900, "mad_both_valves", 0, 0.0, 2_000), *noise)
    world = World(6, 8, 1400.0, {}, tuple(sorted(events)), 4_000)
    (broken,) = run(world).broken
    assert broken.what == "slip_at_contact"
    small = shrink(world, broken, lambda each: breaks(SPEC, each, broken.what))
    assert [event.kind for event in small.events] == ["mad_both_valves"]
    path = tmp_path / "found.json"
    save_world(path, small, {"broken": broken._asdict()})
    assert load_world(path) == small
    arguments = ["--scenario", str(path), "--json", str(tmp_path / "j")]
    assert main(arguments) == 1
    assert json.loads((tmp_path / "j").read_text())["broken"][0]["what"] == "slip_at_contact"
    monkeypatch.undo()
    assert main(arguments) == 0


SHOWN = [aim for aim in AIMS if aim.reaches in
         ("disengage_refused", "clutch_parting+gave_up", "engaging+gave_up",
          "retracting+gear_unknown", "synchronising+engaged", "speed_raising+engaged",
          "clutch_parting+engaged", "coasting+engaged")]  # fmt: skip
"""All of them are run by each swarm."""


@pytest.mark.parametrize(
    "aim",
    [
        pytest.param(aim, id=aim.reaches, marks=(pytest.mark.long,) * (aim is not SHOWN[0]))
        for aim in SHOWN
    ],
)
def test_an_aimed_world_reaches_what_it_aims_at_whatever_the_gearbox(aim: Aim) -> None:
    for seed in (2, 5):
        result = run(aim.world(seed))
        assert result.broken == []
        reached = result.reached
        assert reached.transitions[aim.reaches] + reached.fault_codes[aim.reaches] > 0


@pytest.mark.long
def test_a_controller_that_starts_while_old_frames_fill_the_bus_is_no_violation() -> None:
    """What waited while the gearbox's node hung comes at once; nobody can tell its age."""
    events = (
        Event(300, REQUEST, 0, 4.0),
        Event(700, "node_restart", 0, 0.0, 500),
        Event(1_600, "node_stalled", 0, 0.0, 1_500),
        Event(3_600, "controller_restarted"),
    )
    assert run(World(1_000_151, 5, 913.0, {}, events, 3_800)).broken == []


FOUND: Final = {
    "a brake valve quicker than its nominal delay brings air before the teeth are out": World(
        5_004_350, 5, 1_130.2277051843137, {},
        (Event(300, REQUEST, 0, 4.0), Event(5_838, "supply_drop", 0, 4.229, 774)), 7_095,
    ),
    "a silent propeller shaft says nothing of the speed a gear would have": World(
        5_001_446, 5, 937.6466800215566, {},
        (Event(1_605, REQUEST, 0, 3.0), Event(4_132, "hall_dropout", 6, 0.0, 2_297),
         Event(4_250, REQUEST, 0, 2.0)), 6_098,
    ),
    "a speed from before the sensors started anew comes back with its time": World(
        5_004_634, 5, 1_400.0, {"guard.brake_on_ms": 150.0},
        (Event(2_199, REQUEST, 0, 4.0), Event(3_044, "hall_double_edge", 0, 0.0, 2_533),
         Event(3_788, "mad_unasked", 0, 0.0, 747), Event(5_020, "node_restart", 0, 0.0, 116)),
        5_743,
    ),
    "after a hang frames come message by message, their times back and forth": World(
        5_006_558, 5, 953.8716342336943, {},
        (Event(4_847, "controller_stalled", 0, 0.0, 249), Event(5_016, "bus_off", 4, 0.0, 2_505)),
        5_298,
    ),
    "a bus that catches up for longer than the guard remembers": World(
        5_007_020, 8, 1_512.2266313422192, {},
        (Event(2_718, "node_stalled", 0, 0.0, 2_776), Event(7_918, "node_stalled", 0, 0.0, 1_448)),
        10_208,
    ),
    "sensors that started anew while their frames waited for the bus": World(
        5_007_570, 6, 1_562.09862719685, {},
        (Event(1_917, "node_stalled", 0, 0.0, 2_803), Event(4_434, "node_restart", 0, 0.0, 314)),
        6_067,
    ),
    "a range changed in gear, denied too late, lets its cones go": World(
        6_001_141, 8, 1_400.0, {},
        (Event(348, "mad_range", 0, 0.0, 2_188), Event(976, "position_offset", 0, 10.78, 1_104)),
        2_286,
    ),
    "valve frames that overtake each other are no channel, for the guard as well": World(
        8_000_425, 8, 1_400.0, {},
        (Event(0, "mad_from_the_start", 0, 0.0, 1_398), Event(783, "bus_delay", 3, 45.203, 281)),
        1_395,
    ),
    "silence between two hangs of the sensors is no settled clock": World(
        9_001_158, 8, 1_405.5143391541435, {"limits.blocks": 1.0},
        (Event(2_869, "clock_step", 0, 1_584_152.549, 871),
         Event(3_495, "node_stalled", 0, 0.0, 448), Event(4_025, "node_stalled", 0, 0.0, 837)),
        5_726,
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", FOUND)
def test_what_long_swarms_have_broken_holds_now(what: str) -> None:
    assert run(FOUND[what]).broken == []


def test_after_a_clock_was_set_back_a_little_shifts_are_made_at_once() -> None:
    """By more than a cycle, by less than a bus may delay: the counters tell the two apart."""
    events = (
        Event(400, REQUEST, 0, 10.0),
        Event(600, "clock_step", 0, 25_000.0, 700),
        Event(1_800, REQUEST, 0, 8.0),
    )
    result = run(World(1_000_077, 8, 1400.0, {}, events, 2_300))
    assert result.broken == []
    assert result.reached.fault_codes.total() <= 2
    assert result.engaged
    assert result.simulated_s < 3.5


@pytest.mark.parametrize(
    ("events", "safety_ms", "gear", "layshaft_rpm"),
    [
        (
            (
                Event(289, "clock_step", 0, 84_608.0, 1_517),
                Event(1_027, "controller_stalled", 0, 0.0, 1_450),
            ),
            2_700, 10, 1_171.9,
        ),
        (
            (
                Event(301, "controller_stalled", 0, 0.0, 1_456),
                Event(572, "node_restart", 0, 0.0, 353),
            ),
            2_000, 10, 1_339.1,
        ),
    ],
)  # fmt: skip
def test_a_clock_fault_that_a_hanging_controller_has_not_heard_of_shows_when_it_goes_on(
    events: tuple[Event, ...], safety_ms: int, gear: int, layshaft_rpm: float
) -> None:
    """It ended while the controller hung, and longer before it went on than a fault shows."""
    assert run(World(2_000_067, gear, layshaft_rpm, {}, events, safety_ms)).broken == []


def test_a_sleeve_is_seen_to_meet_its_gear_out_of_the_window(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The deed whose guard judges, and is not heeded."""
    judged = Guard.passes
    monkeypatch.setattr(
        Guard, "passes", lambda self, payload, seen: judged(self, payload, seen) or True
    )
    assert [each.what for each in run(deed_alone("mad_slip")).broken] == ["slip_at_contact"]


def test_a_crash_of_a_node_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Guard, "passes", lambda self, payload, seen: 1 // 0)
    (broken,) = run(World(6, events=(), safety_ms=500)).broken
    assert broken.what == "crash"
    assert "ZeroDivisionError" in broken.text


def test_a_sleeve_that_torque_held_half_out_of_its_gear_is_not_thrown_through_neutral() -> None:
    """Held so, it moves as one of heavy friction would."""
    events = Event(300, "mad_slip", 0, 0.0, 3_000), Event(400, REQUEST, 0, 10.0)
    assert run(World(1_000_035, 8, 1400.0, {}, events, 5_000)).broken == []
