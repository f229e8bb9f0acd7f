"""The data set: nothing known is later than it says, and the same seed is the same bytes."""

import importlib.util
import math
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from asammdf import MDF

from benchmarks.dataset.command import TASK, main, write_set
from benchmarks.dataset.parts import SERIES
from benchmarks.dataset.plan import AHEAD_US, HELD_OUT, SHEET, TEST, UPSHIFT, Plan
from benchmarks.dataset.recording import SETTINGS, draw_of, record
from benchmarks.dataset.shift_series import MARGIN_US, clock_of
from meshpoint.bench.bench_builder import tick_phases
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.controller.models.thesis import THESIS_FILTER, propagate, thesis_filter
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import read_alone
from meshpoint.dbc.messages import EngagementEvent, ReferenceEngagement
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.kernels.records import RecordMemory
from meshpoint.rig_sim.settings import Preset
from meshpoint.units import DEG

PLAN = Plan(upshifts=2, downshifts=2, learned=2)
ARGUMENTS = ["--upshifts", "2", "--downshifts", "2", "--learn", "2"]
CONTACTS = (EngagementEvent.GAP_CONTACT, EngagementEvent.TOOTH_CONTACT)
SAME_RAD = 1e-9
MOST_OFF_DEG = 0.75
"""Half a gap."""
WRAP_US = 2**32
"""Of the sensor clock; one gearbox here begins just before it."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset") / "set"
    folder.mkdir()
    write_set(folder, PLAN, jobs=1)
    return folder


@pytest.fixture(scope="module")
def recorded():
    return record(next(PLAN.gearboxes(UPSHIFT)))[0]


def rows_of(path: Path) -> list[dict]:
    return pq.read_table(path).to_pylist()


def test_same_seed_is_the_same_bytes(made, tmp_path) -> None:
    assert main(["--out", str(tmp_path / "again"), *ARGUMENTS, "--jobs", "2"]) == 0
    files = {path.relative_to(made): path for path in made.rglob("*") if path.is_file()}
    again = {path.relative_to(tmp_path / "again") for path in (tmp_path / "again").rglob("*.*")}
    assert {name for name in files if name.suffix} == again
    for name, path in files.items():
        assert path.read_bytes() == (tmp_path / "again" / name).read_bytes(), name


def test_nothing_known_is_later_than_45_ms_before_contact(made) -> None:
    contact_us = {
        row["shift"]: row["contact_us"] for row in rows_of(made / "truth/contacts.parquet")
    }
    cutoff_us = {row["shift"]: row["cutoff_us"] for row in rows_of(made / "shifts.parquet")}
    assert cutoff_us == {shift: at_us - AHEAD_US for shift, at_us in contact_us.items()}
    for name in SERIES:
        known = pq.read_table(made / "known" / f"{name}.parquet").to_pylist()
        assert known, name
        for row in known:
            last_us = max(row["arrival_us"], row.get("time_us", row["arrival_us"]))
            assert last_us <= cutoff_us[row["shift"]], name
        for row in rows_of(made / "later" / f"{name}.parquet"):
            assert row["arrival_us"] > cutoff_us[row["shift"]], name


def test_arrivals_are_never_early(recorded) -> None:
    """Held against the sensor clock as the rig has it: what it showed as the rig began to step."""
    start_us = _sensor_clock_at_start(recorded[0].gearbox)
    for shift in recorded:
        clock = clock_of(shift)
        for bus_us, _ in shift.frames:
            true_us = start_us + bus_us - clock.zero_us
            assert 0 <= (clock.arrival_us(bus_us) - true_us) % WRAP_US <= MARGIN_US


def _sensor_clock_at_start(gearbox) -> int:
    sheet = load_sheet(SHEET)
    drawn = draw_of(gearbox, sheet)
    rig = ClosedLoop(sheet, SETTINGS, Preset.TRUCK, drawn)._rig
    _, rig_phase_us, _ = tick_phases(drawn.seed)
    return rig._world.clock.at(0.0) - rig_phase_us


def test_truth_is_what_the_rig_sent_as_reference_engagement(made, recorded) -> None:
    rows = {row["shift"]: row for row in rows_of(made / "truth/contacts.parquet")}
    zeros = {row["shift"]: row["request_clock_us"] for row in rows_of(made / "shifts.parquet")}
    codec = CODECS[ReferenceEngagement.__name__]
    for shift in recorded[:2]:
        sent = [read_alone(codec, f) for _, f in shift.frames if f.can_id == codec.spec.can_id]
        gear, of = DRIVE_GEARS[shift.row.to].main, rows[shift.shift_id]
        since_us = zeros[shift.shift_id]
        first = next(
            each
            for each in sent
            if each.gear == gear
            and each.event in CONTACTS
            and (each.event_time_us - since_us) % WRAP_US < WRAP_US // 2
        )
        assert of["phase_deg"] == first.phase_rad / DEG
        assert of["contact_us"] == (first.event_time_us - since_us) % WRAP_US
        assert of["contact"] == first.event.name.lower().partition("_")[0]


def test_a_gearbox_is_in_one_split() -> None:
    boxes = [box for box, _ in zip(Plan().gearboxes(UPSHIFT), range(60), strict=False)]
    assert len({box.seed for box in boxes}) == len(boxes)
    assert sum(box.split == TEST for box in boxes) == len(boxes) // HELD_OUT


def test_an_mf4_file_has_what_parquet_has_and_no_date(made) -> None:
    shift = rows_of(made / "shifts.parquet")[0]["shift"]
    with MDF(made / "mf4" / f"{shift}.mf4") as mdf:
        assert mdf.header.start_time.timestamp() == 0.0
        found = mdf.get("edges.layshaft.rise.index")
        slip = mdf.get("true_events.slip_rpm")
    edges = [
        row
        for part in ("known", "later")
        for row in rows_of(made / part / "edges.parquet")
        if (row["shift"], row["shaft"], row["edge"]) == (shift, "layshaft", "rise")
    ]
    assert found.samples.tolist() == [row["index"] for row in edges]
    assert np.allclose(found.timestamps * 1e6, [row["time_us"] for row in edges], atol=0.01)
    assert slip.unit == "rpm"


def test_edges_and_reference_make_the_true_phase(made, thesis) -> None:
    """What is given to compute a phase by is right to within the teeth's and reference's errors."""
    shifts, gearbox = sys.modules["known"].read_shifts(made)
    edges = pq.read_table(made / "later/edges.parquet").to_pylist()
    for shift in shifts:
        angles = []
        for shaft in ("layshaft", "main"):
            kind = (shift.row["shift"], shaft, "rise")
            later = [e for e in edges if (e["shift"], e["shaft"], e["edge"]) == kind]
            times, index = shift.edges(shaft)
            times = np.concatenate((times, [each["time_us"] for each in later]))
            index = np.concatenate((index, [each["index"] for each in later]))
            number = np.interp(shift.contact_us, times, index)
            angles.append(number * 360.0 / gearbox["wheel_teeth"][shaft])
        true = _contact(made, shift.row["shift"])["phase_deg"]
        pitch = shift.row["pitch_deg"]
        off = shift.phase_deg(*angles) - true
        assert abs(off - pitch * round(off / pitch)) < MOST_OFF_DEG


def _contact(folder, shift) -> dict:
    return next(row for row in rows_of(folder / "truth/contacts.parquet") if row["shift"] == shift)


@pytest.fixture(scope="module")
def thesis():
    """The baseline as a stranger runs it: beside its `known.py`."""
    sys.path.insert(0, str(TASK))
    try:
        spec = importlib.util.spec_from_file_location("thesis_baseline", TASK / "thesis.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        yield module
    finally:
        sys.path.remove(str(TASK))
        sys.modules.pop("known", None)


def test_the_baseline_thesis_is_the_controllers_thesis_filter(made, thesis) -> None:
    shifts, gearbox = sys.modules["known"].read_shifts(made)
    for shift in shifts:
        angle, _ = thesis.layshaft_at_contact(shift, gearbox)
        assert angle == pytest.approx(_by_kernels(thesis, shift, gearbox), abs=SAME_RAD)


def _by_kernels(thesis, shift, gearbox) -> float:
    """The layshaft's angle at contact (rad) by the compiled filter that the controller has."""
    times, index = shift.edges("layshaft")
    pitch = 2.0 * math.pi / gearbox["wheel_teeth"]["layshaft"]
    before = times <= thesis.free_since_us(shift)
    angle, speed = thesis.held(times[before], index[before] * pitch)
    memory, tuning = RecordMemory(THESIS_FILTER), gearbox["thesis_filter"]
    memory.part("w")[:] = [
        tuning[f"w_{of}"] for of in ("angle_rad_s", "speed_rad_s2", "pressure_pa_s")
    ]
    memory.part("r_rad2")[0] = tuning["r_angle_rad"] ** 2
    brake = gearbox["brake"]
    inertia = gearbox["gears"][str(shift.row["to_gear"])]["inertia_kgm2"]
    memory.part("model")[:] = [
        gearbox["friction_nms"] / inertia,
        1.0 / brake["time_constant_s"],
        brake["torque_nm_per_pa"] / inertia,
        brake["supply_gauge_pa"],
    ]
    x = memory.part("x")
    memory.part("time_us")[0], x[:] = times[before][-1], (angle, speed, 0.0)
    sd = (0.1 * pitch, 0.05 * abs(speed) + 1.0, thesis.SD_PRESSURE_PA)
    memory.part("p")[:] = np.diag(np.square(sd))
    switches = np.array(thesis.switches_of(shift, brake["valve_delay_s"] * 1e6)).T
    thesis_filter(memory.flat, times[~before], index[~before] * pitch, switches)
    end = np.array(x)
    at_us, model = memory.part("time_us").item(), np.array(memory.part("model"))
    propagate(end, at_us, float(shift.contact_us), switches, model)
    return float(end[0])


def test_a_folder_with_something_in_it_is_left_alone(made, capsys) -> None:
    with pytest.raises(SystemExit):
        main(["--out", str(made), *ARGUMENTS])
    assert "allowed is a new folder" in capsys.readouterr().err
