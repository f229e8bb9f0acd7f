"""Trucks with other equipment than today's, as study `hardware` drives them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.studies import hardware_trucks
from benchmarks.studies.draw import write_files
from benchmarks.studies.equipment import (
    Equipment,
    EquippedRun,
    EquippedShifts,
    with_stroke,
    with_valve_delay,
)
from benchmarks.studies.equipment_truth import Parking, WheelRings, WheelRingTeeth
from benchmarks.studies.record import Finding, StudyJob
from benchmarks.studies.registry import load
from benchmarks.studies.settings import load_study_settings
from meshpoint.campaigns.draw import draw, upshifts
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.campaigns.record import JudgedShift
from meshpoint.campaigns.run import run_one
from meshpoint.campaigns.spec import CampaignSpec, Job
from meshpoint.controller.plan.gear_predictor import GearPredictor
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.sleeve.sleeves import Sleeves
from meshpoint.gearbox import GearboxSheet, MainGear, load_sheet
from meshpoint.rig_sim.settings import Preset, Profile

TRUCK = load_sheet("truck12")
PARKING = Parking(before_teeth_m=1.5e-3, scatter_m=0.3e-3, least_m=0.5e-3)
RINGS = WheelRingTeeth(teeth=100, error_percent_of_pitch=0.2, final_drive=2.6)
SEED = 4
AHEAD_US = 40_000.0


def shifts(equipment: Equipment, sheet: GearboxSheet = TRUCK, seed: int = SEED) -> EquippedShifts:
    """Two judged shifts of a truck as built within its tolerances."""
    return EquippedRun(equipment, sheet, seed, 1, 2, Profile.CLEAN, PARKING, RINGS).run()


def delays_ms(equipment: Equipment, sheet: GearboxSheet = TRUCK, seed: int = SEED) -> list[float]:
    """From the valve's current to the first contact, of sleeves that were fired once: one that was
    stopped on its way has less of it left."""
    records = shifts(equipment, sheet, seed).records
    assert [record.aborts for record in records] == [0] * len(records)
    found = [record.delay_ms for record in records]
    return [delay_ms for delay_ms in found if delay_ms is not None]


def test_today_s_truck_shifts_as_in_a_campaign() -> None:
    spec = CampaignSpec(
        TRUCK, ControllerSettings(), Preset.TRUCK, ("target_phase",), False, upshifts(), 1, 2, 1,
        profile=Profile.CLEAN,
    )  # fmt: skip
    campaign = run_one(spec, Job(SEED)).records
    study = shifts(Equipment.TODAY).records
    assert [replace(one, strategy="", sweep="") for one in study] == [
        replace(one, strategy="", sweep="") for one in campaign
    ]


def test_through_a_wide_valve_a_stroke_takes_as_long_as_its_sheet_says() -> None:
    # Through it a pulse to neutral is so short that a valve's scatter may throw a sleeve: not here.
    delays = delays_ms(Equipment.WIDE_VALVE, with_stroke(TRUCK, 0.027), seed=6)
    assert len(delays) == 2
    assert delays == pytest.approx([27.0, 27.0], abs=1e3 * TRUCK.sleeve.delay_limit_s)


def test_a_quick_valve_shortens_a_stroke_by_its_own_delay_alone() -> None:
    quick = with_valve_delay(TRUCK, 0.005)
    met = [Sleeves(sheet).from_neutral(MainGear.FIRST) for sheet in (quick, TRUCK)]
    assert met[0].contact_speed_m_s == pytest.approx(met[1].contact_speed_m_s, rel=1e-3)
    delays = delays_ms(Equipment.QUICK_VALVE, quick, seed=5)
    assert len(delays) == 2
    assert delays == pytest.approx([38.0, 38.0], abs=1e3 * TRUCK.sleeve.delay_limit_s)


def test_a_parked_sleeve_has_less_of_its_way_left() -> None:
    """The valve's delay and the rise of the pressure are not shortened with the way."""
    delays = delays_ms(Equipment.PARKED_SLEEVE, seed=5)
    assert len(delays) == 2
    for delay_ms in delays:
        assert 1e3 * TRUCK.sleeve.valve_delay_s + 5.0 < delay_ms < 35.0


def test_each_line_has_intervals_beside_today_s_and_says_what_it_risks(tmp_path: Path) -> None:
    gap, missed = shifts(Equipment.TODAY).records
    missed = replace(missed, contact="tooth", delay_ms=-200.0)
    start = load_study_settings(None).given(load("hardware"))
    start = replace(start, own=replace(start.own, trucks=replace(start.own.trucks, gearboxes=3)))
    jobs = hardware_trucks.jobs(start)
    results = {job: EquippedShifts([_of(one, job) for one in (gap, missed)], 2) for job in jobs}
    found = hardware_trucks.compared(replace(start, results=results))
    assert len(found.statements) == 4
    for statement in found.statements:
        assert statement.ours.count("0.500 (") == 2  # ours and today's, with their intervals
        assert "6 aborts, 3 unmeant contacts, 0 not engaged" in statement.ours
        assert statement.reason.startswith("risk: ")
    assert [row[0] for row in found.table.rows] == list(Equipment)
    written = write_files(Finding((), {}, (found.chart,), (found.table,)), tmp_path)
    assert all((tmp_path / name).stat().st_size > 0 for name in written)


def _of(record: JudgedShift, job: StudyJob) -> JudgedShift:
    assert isinstance(job, EquippedRun)
    return replace(record, seed=job.seed, strategy=str(job.equipment))


@pytest.mark.long
def test_who_sees_the_driven_wheels_foresees_the_main_shaft_no_worse() -> None:
    """Five shifts of each of four trucks whose drivelines have backlash. One truck says nothing: in
    the worst tenth of its predictions it is 0.4 to 3 times as far off with rings as without, and
    six of them together 0.88 times."""
    trucks = range(917_000_001, 917_000_005)
    without, with_rings = (
        np.concatenate([foreseen_off_rad(truck, ring_seed) for truck in trucks])
        for ring_seed in (None, 1)
    )
    assert min(without.size, with_rings.size) > 300
    assert np.percentile(with_rings, 90.0) < np.percentile(without, 90.0)


def foreseen_off_rad(seed: int, ring_seed: int | None) -> np.ndarray:
    """By how much the main shaft is elsewhere than was foreseen."""
    drawn = draw(seed, TRUCK, Preset.TRUCK, upshifts(), 9, {}, Profile.TYPICAL)
    bench = ClosedLoop(TRUCK, ControllerSettings(), Preset.TRUCK, drawn)
    for _ in range(4):
        bench.shift()
    source = WheelRings(TRUCK, bench.rig_truth, bench.controller.observer, RINGS, ring_seed or 0)
    foreseen: list[float] = []
    seen: list[tuple[float, float]] = []

    def watch(predictor: GearPredictor) -> GearPredictor:
        known, now_us = source(predictor) if ring_seed else predictor, predictor.main.time_us
        foreseen.append(known.main.theta_at(now_us + AHEAD_US))
        seen.append((now_us, known.main.theta_rad))
        return known

    bench.controller.take_predictor_from(watch)
    for _ in range(5):
        bench.shift()
    times, angles = np.array(seen).T
    ahead = times + AHEAD_US
    after = np.searchsorted(times, ahead).clip(1, times.size - 1)
    is_seen = (ahead <= times[-1]) & (times[after] - times[after - 1] < 11_000.0)
    return np.abs(np.array(foreseen) - np.interp(ahead, times, angles))[is_seen]
