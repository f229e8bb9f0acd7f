"""Sleeves drawn otherwise than the data sheet says: what strokes and aborts teach of them.
Simulated by an integrator of its own (drawn_sleeve.py), five ways to have the sheet's delay."""

from __future__ import annotations

import copy
import functools

import numpy as np
import pytest
from drawn_sleeve import CYLINDERS, DETENT_M, FACE, DrawnSleeve
from sleeve_bench import GEAR, OTHER, SLEEVE, VALVES, SleeveBench

from meshpoint.controller.measure.gearbox_view import GearboxView
from meshpoint.controller.sleeve.sleeves import Sleeves
from meshpoint.dbc.messages import SleevesMain
from meshpoint.gearbox import load_sheet

SHEET = load_sheet("truck12")
SEEDS = (1, 2, 3)
CHANCE_MS = 0.3
"""Of a drawn valve, from switch to switch."""


def learned(name: str, seed: int, strokes: int) -> tuple[SleeveBench, list[float]]:
    """A sleeve after some strokes, and by how much each contact was off its prediction (ms)."""
    return copy.deepcopy(_after(name, seed, strokes))


@functools.cache
def _after(name: str, seed: int, strokes: int) -> tuple[SleeveBench, list[float]]:
    if strokes == 0:
        return SleeveBench(SHEET, DrawnSleeve(CYLINDERS[name], seed, 1e-3 * CHANCE_MS)), []
    bench, errors = learned(name, seed, strokes - 1)
    predicted_us, true_us = bench.fire()
    bench.back()
    return bench, [*errors, 1e-3 * (predicted_us - true_us)]


def rms(values: list[float]) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.check
def test_after_six_strokes_a_contact_is_known_but_for_the_valves_chance() -> None:
    errors = [learned(name, seed, 7)[1] for name in CYLINDERS for seed in SEEDS]
    assert rms([each[4] for each in errors]) < 2.0 * CHANCE_MS
    assert rms([each[6] for each in errors]) < 2.0 * CHANCE_MS


@pytest.mark.parametrize(
    "name",
    [pytest.param(each, marks=[pytest.mark.check] * (each != "between")) for each in CYLINDERS],
)
def test_a_learned_sleeve_is_stopped_short_of_the_teeth_and_goes_on_as_predicted(name: str) -> None:
    bench, _ = learned(name, 1, 6)
    fire_us = bench.now_us + 15_000
    bench.sleeve.reached_us.clear()
    bench.command(0, True, fire_us)
    while bench.now_us + 2_000 < fire_us:
        bench.step()
    abort_us = fire_us + bench.sleeves.abort_after_us(GEAR)
    while bench.now_us + 5_000 < abort_us:
        bench.step()
    halt = bench.sleeves.abort(GEAR, abort_us)
    bench.command(0, False, abort_us)
    bench.command(1, True, abort_us)
    while bench.now_us + 2_000 < abort_us:
        bench.step()
    bench.command(1, False, halt.off_us)
    bench.run(200_000)
    assert FACE not in bench.sleeve.reached_us
    assert abs(bench.sleeve.x - halt.m) < 3.0 * halt.sd_m
    stands_m, from_neutral_us = bench.sleeve.x, bench.sleeves.from_neutral(GEAR).contact_us
    again = bench.sleeves.stroke(GEAR, bench.now_us + 15_000)
    predicted_us, true_us = bench.fire()
    if stands_m > DETENT_M:
        assert true_us < from_neutral_us - 5_000
    else:
        assert abs(true_us - from_neutral_us) < 1_500.0, "its detent took it back to neutral"
    assert abs(predicted_us - true_us) < 2.0 * again.sd_us < 3_000.0


def test_what_was_learned_is_kept_and_another_controller_goes_on_with_it() -> None:
    bench, _ = learned("long pipe", 2, 3)
    known, another = bench.sleeves, Sleeves(SHEET)
    another.restore(known.records(), known.laws())
    mine, other = known.from_neutral(GEAR), another.from_neutral(GEAR)
    assert other.contact_us == pytest.approx(mine.contact_us, abs=30)
    assert other.sd_us == pytest.approx(mine.sd_us, rel=0.02)
    assert another.records().of(OTHER) is None


@pytest.mark.parametrize("way", [0, 1])
@pytest.mark.parametrize("name", CYLINDERS)
def test_a_contact_is_measured_when_the_sleeve_is_at_the_teeth(name: str, way: int) -> None:
    """Within the time that it takes for 0.3 mm: so much a sensor may be off. A sleeve that has come
    there before, and is fired once more, has not yet come there again."""
    bench = SleeveBench(SHEET, DrawnSleeve(CYLINDERS[name], 3, 1e-3 * CHANCE_MS))
    gear, none = (GEAR, OTHER) if way == 0 else (OTHER, GEAR)
    for _ in range(2):
        fire_us = bench.now_us
        assert bench.sleeves.contact_us(gear, fire_us) is None
        _, true_us = bench.fire(way)
        measured_us = bench.sleeves.contact_us(gear, fire_us)
        assert measured_us == pytest.approx(fire_us + 15_000 + true_us, abs=600)
        assert bench.sleeves.contact_us(none, fire_us) is None
        bench.back(way)


@pytest.mark.parametrize("since_ms", [30, 50, 60])
def test_a_sensor_clock_set_back_amid_a_stroke_begins_the_sleeve_anew(since_ms: int) -> None:
    """It is where it is measured, what it has learned stays, and the next contact is as sure."""
    bench, _ = learned("narrow valve", 1, 4)
    bench.command(0, True, bench.now_us + 5_000)
    bench.run(1_000 * since_ms)
    bench.back_us = 1_000_000
    bench.run(100_000)
    stands = bench.sleeves.place(SLEEVE, bench.now_us - bench.back_us)
    assert stands.m == pytest.approx(bench.sleeve.x, abs=2e-4)
    assert not stands.is_moving
    bench.back()
    predicted_us, true_us = bench.fire()
    assert predicted_us == pytest.approx(true_us, abs=4e3 * CHANCE_MS)


def test_a_contact_is_measured_of_a_sleeve_that_moves_otherwise_than_the_law_says() -> None:
    """Pushed at 0.08 m/s from its valve's current on."""
    sleeves, view = Sleeves(SHEET), GearboxView(SHEET)
    for newest_ms in range(10, 200, 10):
        if newest_ms == 90:
            sleeves.expected(VALVES[0], [(100_000, True)])
        way_m = [8e-5 * max(0, newest_ms - back - 100) for back in range(10)]
        samples = tuple(min(way, 12e-3) for way in way_m)
        view.sleeves_main(SleevesMain(0, 0, samples, (0.0,) * 10), 1_000 * newest_ms)
        sleeves.take(view, 1_000 * newest_ms + 2_000)
    contact_us = sleeves.contact_us(GEAR, 100_000)
    assert contact_us == pytest.approx(100_000 + 1e6 * FACE / 0.08, abs=1_000.0)


def test_a_sleeve_that_is_held_fast_teaches_nothing() -> None:
    bench, _ = learned("narrow valve", 1, 1)
    known = bench.sleeves.records(), bench.sleeves.laws()
    fire_us = bench.now_us + 15_000
    bench.sleeves.expected(VALVES[0], [(fire_us, True)])
    bench.run(200_000)
    bench.sleeves.expected(VALVES[0], [(bench.now_us + 5_000, False)])
    bench.run(400_000)
    assert (bench.sleeves.records(), bench.sleeves.laws()) == known


@pytest.mark.parametrize("noise_mm", [0.0, 0.04, 0.1])
def test_a_sleeve_is_seen_to_stand_whatever_the_noise_of_its_sensor(noise_mm: float) -> None:
    """In its gear, its valve off: until then nothing is learned, and it is not moved again."""
    stood_ms = []
    for seed in range(8):
        bench = SleeveBench(SHEET, DrawnSleeve(CYLINDERS["between"], seed))
        bench.sleeve.noise_m = 1e-3 * noise_mm
        bench.fire()
        bench.command(0, False, bench.now_us + 4_000)
        off_us = bench.now_us + 4_000
        while not bench.sleeves.rests(GEAR) and bench.now_us < off_us + 400_000:
            bench.step()
        stood_ms.append(1e-3 * (bench.now_us - off_us))
    assert max(stood_ms) <= 80.0
    assert np.mean(stood_ms) <= 55.0
