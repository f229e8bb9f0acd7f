"""The report: what it draws is what was on the bus, and the page needs nothing but itself."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import browse
from hypothesis import given, settings
from hypothesis import strategies as st
from page_data import page_data
from scipy.stats import binomtest

from meshpoint.bench.simulate import Setup, simulate
from meshpoint.cli.main import main
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.messages import (
    ControllerState,
    ControllerStatus,
    EngagementEvent,
    MainGear,
    PhaseReference,
    ReferenceEngagement,
    ShiftDecision,
    ShiftOutcome,
    ShiftPrediction,
    ShiftResult,
    SleevesMain,
    Strategy,
)
from meshpoint.gearbox import load_sheet
from meshpoint.report.collect import ReportCollector
from meshpoint.report.page import page
from meshpoint.report.phase import onto_branch, unwrapped_deg
from meshpoint.report.run import Report, ReportRun
from meshpoint.report.write import report_data, report_provenance, write_report
from meshpoint.results.rows import ShiftRow
from meshpoint.results.wilson import wilson
from meshpoint.rig_sim.settings import Preset
from meshpoint.units import DEG, RPM

SHEET = load_sheet("thesis")
PITCH_DEG = 7.5
HOSTILE = "</script><script>alert('no')</script><img src=x onerror=alert(1)>.log"
PLOTLY_STUB = "window.Plotly = {};"
SIZE_LIMIT = 8_000_000


@pytest.fixture(scope="module")
def simulated() -> tuple[Report, list[ShiftRow]]:
    """Four shifts, of which the last two could aim."""
    setup = Setup(SHEET, ControllerSettings(), Preset.THESIS, seed=1, shifts=4)
    collector = ReportCollector(SHEET)
    result = simulate(setup, lambda _time_us, frame: collector.receive(frame))
    run = ReportRun("target_phase", collector.finish(), [f"from {HOSTILE}"])
    provenance = report_provenance(SHEET, seed=1, preset="thesis", log=HOSTILE)
    return Report(f"report of {HOSTILE}", HOSTILE, SHEET, [run], provenance), result.rows


@pytest.fixture(scope="module")
def data(simulated: tuple[Report, list[ShiftRow]]) -> dict[str, Any]:
    values: dict[str, Any] = report_data(simulated[0])
    return values


def trace(figure: dict[str, Any], axis: str, name: str) -> tuple[list[float], list[float]]:
    """The points of a line without its breaks."""
    (found,) = (t for t in figure["data"] if (t["yaxis"], t["name"]) == (axis, name))
    points = [(x, y) for x, y in zip(found["x"], found["y"], strict=True) if y is not None]
    return [x for x, _ in points], [y for _, y in points]


def test_the_report_has_the_rows_of_the_run(simulated: tuple[Report, list[ShiftRow]]) -> None:
    report, rows = simulated
    # the bound needs the gearbox as built, which is not on the bus
    assert [shift.row for shift in report.runs[0].shifts] == [
        replace(row, bound_ms=None) for row in rows
    ]
    assert len(rows) == 4


def test_slip_and_phase_curves_lead_to_the_contact_that_the_rig_reported(
    simulated: tuple[Report, list[ShiftRow]], data: dict[str, Any]
) -> None:
    """Curves come from encoder and phase frames, the contact from an event frame of its own.

    The brake may be on until contact and take 9 rpm of slip in the 10 ms after the last sample: the
    phase goes on from there by the mean of the slips at both ends."""
    for shift, figure in zip(simulated[0].runs[0].shifts, data["shifts"].values(), strict=True):
        contact_ms, row = shift.contact_ms, shift.row
        assert contact_ms is not None
        assert row.slip_rpm is not None
        assert shift.contact_phase_deg is not None
        times, slips = trace(figure, "y2", "truth")
        before = [k for k, at_ms in enumerate(times) if at_ms < contact_ms][-4:]
        curve = np.polyfit([times[k] - contact_ms for k in before], [slips[k] for k in before], 3)
        assert curve[-1] == pytest.approx(row.slip_rpm, abs=0.1)
        times, phases = trace(figure, "y6", "truth")
        k = max(k for k, at_ms in enumerate(times) if at_ms < contact_ms)
        mean_rpm = 0.5 * (np.polyval(curve, times[k] - contact_ms) + row.slip_rpm)
        moved_pct = 100.0 / PITCH_DEG * 0.006 * mean_rpm * (contact_ms - times[k])
        contact_pct = 100.0 / PITCH_DEG * shift.contact_phase_deg
        assert phases[k] + moved_pct == pytest.approx(contact_pct, abs=0.2)


def test_the_estimate_lies_around_the_truth_where_the_model_holds(
    simulated: tuple[Report, list[ShiftRow]], data: dict[str, Any]
) -> None:
    """From the release to 20 ms before contact an aimed shift knows its slip within 1 rpm."""
    shift, figure = simulated[0].runs[0].shifts[3], data["shifts"]["shift-1-4"]
    assert shift.contact_ms is not None
    times, estimate = trace(figure, "y2", "estimate")
    truth = np.interp(times, *trace(figure, "y2", "truth"))
    within = [k for k, at_ms in enumerate(times) if -100 < at_ms - shift.contact_ms < -20]
    assert len(within) >= 7
    assert max(abs(estimate[k] - truth[k]) for k in within) < 1.0


def test_the_gap_is_drawn_as_wide_as_the_sheet_says(data: dict[str, Any]) -> None:
    bands = [shape for shape in data["common"]["shapes"] if shape["yref"] == "y7"]
    assert [(band["y0"], band["y1"]) for band in bands] == [(-10.0, 10.0)]


def test_shifts_that_could_not_aim_show_no_prediction(data: dict[str, Any]) -> None:
    names = [{t["name"] for t in figure["data"]} for figure in data["shifts"].values()]
    assert ["prediction" in found for found in names] == [False, False, True, True]
    assert data["first"] == "shift-1-3"


def test_every_panel_has_its_quantity_and_unit_and_shares_the_time_axis(
    data: dict[str, Any],
) -> None:
    titles = [data["common"][f"yaxis{n or ''}"]["title"]["text"] for n in ("", 2, 3, 5, 6, 7)]
    for title, unit in zip(titles, ("rpm", "rpm", "bar", "mm", "% of pitch", "%"), strict=True):
        assert unit in title
    assert "ms" in data["common"]["xaxis"]["title"]["text"]
    for figure in data["shifts"].values():
        assert all("xaxis" not in t for t in figure["data"])


def aborted_shift(*aborted_ms: int) -> Report:
    """A report of one shift from 8 to 10, 400 ms long, its sleeve stopped at these times after
    half a millimetre more each time."""
    collector, halted_ms = ReportCollector(SHEET), {at + k for at in aborted_ms for k in (0, 10)}
    for at_ms in range(10, 560, 10):
        stood = sum(100 + each <= at_ms for each in aborted_ms)
        is_halted = at_ms - 100 in halted_ms
        state = ControllerState.HALTED if is_halted else ControllerState.ENGAGING
        position_m = (0.5e-3 * stood,) * 10
        collector.take(SleevesMain(sample_time_us=1000 * at_ms, sleeve_first_second_m=position_m))
        collector.take(ControllerStatus(state=state))
        if at_ms == 500:
            outcome = ShiftOutcome(
                8, 10, Strategy.TARGET_PHASE, PhaseReference.KNOWN, result=ShiftResult.ENGAGED,
                attempts=1, request_time_us=100_000, end_time_us=500_000, aborts=len(aborted_ms),
                halt_position_m=position_m[0],
            )  # fmt: skip
            collector.take(outcome)
    return Report("aborted", "", SHEET, [ReportRun("target_phase", collector.finish())], {})


def test_each_abort_is_marked_where_the_sleeve_was_then() -> None:
    (figure,) = report_data(aborted_shift(200, 300))["shifts"].values()
    assert trace(figure, "y5", "aborted") == ([200.0, 300.0], [0.5, 1.0])
    names = [(note["text"], note["x"]) for note in figure["annotations"]]
    assert [x for text, x in names if text == "aborted"] == [200.0, 300.0]
    (figure,) = report_data(aborted_shift())["shifts"].values()
    assert "aborted" not in {drawn["name"] for drawn in figure["data"]}


def test_the_account_of_a_shift_says_how_often_it_was_aborted_and_where_it_stood() -> None:
    def account(report: Report) -> list[list[str]]:
        return list(report_data(report)["shifts"]["shift-1-1"]["account"])

    assert account(aborted_shift(200))[-1] == ["aborted", "–", "once, stood at 0.5 mm", "–"]
    assert account(aborted_shift(200, 300))[-1][2] == "twice, last stood at 1.0 mm"
    assert account(aborted_shift())[-1][0] != "aborted"
    drawn = page(aborted_shift(200, 300), report_data(aborted_shift(200, 300)), PLOTLY_STUB)
    assert '<td class="number" data-name="aborts">2</td>' in drawn
    assert '<td class="number" data-name="with an abort">1</td>' in drawn


def test_the_account_of_a_retried_shift_is_of_the_firing_that_made_the_first_contact() -> None:
    """Fired for -0.04 deg at 300 ms, a tooth at 345 ms; fired again for 0.2 deg at 500 ms."""
    collector = ReportCollector(SHEET)
    for fire_ms, phase_deg in ((300, -0.04), (500, 0.2)):
        collector.take(
            ShiftPrediction(
                1000 * (fire_ms - 10), ShiftDecision.COMMITTED, fire_time_us=1000 * fire_ms,
                contact_time_us=1000 * (fire_ms + 46), phase_rad=phase_deg * DEG,
                phase_sd_rad=0.75 * DEG, slip_rad_s=2.0 * RPM,
            )
        )  # fmt: skip
    tooth = EngagementEvent.TOOTH_CONTACT
    met = ReferenceEngagement(345_000, tooth, MainGear.SECOND, -0.9 * DEG, 5.0 * RPM)
    collector.take(met)
    collector.take(
        ShiftOutcome(
            8, 10, Strategy.TARGET_PHASE, PhaseReference.KNOWN, result=ShiftResult.ENGAGED,
            attempts=2, request_time_us=0, fire_time_us=500_000, predicted_contact_time_us=546_000,
            measured_contact_time_us=545_000, end_time_us=600_000,
            predicted_phase_rad=0.2 * DEG, predicted_phase_sd_rad=0.75 * DEG,
        )
    )  # fmt: skip
    run = ReportRun("target_phase", collector.finish())
    (shown,) = report_data(Report("retried", "", SHEET, [run], {}))["shifts"].values()
    assert shown["account"][:3] == [
        ["contact, ms after the request", "346.0", "–", "345.0"],
        ["phase at contact, % of pitch", "-0.5 ± 10.0", "–", "-12.0"],
        ["slip at contact, rpm", "+2.0", "–", "+5.0"],
    ]


def test_plotly_knows_every_attribute_of_every_figure(data: dict[str, Any]) -> None:
    graph_objects = pytest.importorskip("plotly.graph_objects")
    for figure in data["shifts"].values():
        layout = data["common"] | figure["axes"]
        layout["annotations"] = figure["annotations"]
        layout["shapes"] = data["common"]["shapes"] + figure["shapes"]
        graph_objects.Figure({"data": figure["data"], "layout": layout})
    for figure in data["overview"].values():
        graph_objects.Figure(figure)


def test_names_from_outside_stay_text(
    simulated: tuple[Report, list[ShiftRow]], data: dict[str, Any]
) -> None:
    text = page(simulated[0], data | {"extra": HOSTILE}, PLOTLY_STUB)
    assert "<script>alert" not in text
    assert "<img" not in text
    assert text.count("<script") == text.count("</script>") == 5 + len(data["shifts"])
    assert text.count("&lt;/script&gt;") >= 4
    assert page_data(text) == data | {"extra": HOSTILE}


def test_the_page_refers_to_nothing_outside_itself(
    simulated: tuple[Report, list[ShiftRow]], data: dict[str, Any]
) -> None:
    text = page(simulated[0], data, PLOTLY_STUB)
    assert "http" not in text.replace("http-equiv", "")
    assert "default-src 'none'" in text
    assert not re.search(r"<(link|iframe|object|embed)|\ssrc=", text.replace("img src=x", ""))


def test_sixty_shifts_stay_below_eight_megabytes(
    simulated: tuple[Report, list[ShiftRow]], data: dict[str, Any]
) -> None:
    offline = pytest.importorskip("plotly.offline")
    text = page(simulated[0], data, PLOTLY_STUB)
    assert len(offline.get_plotlyjs()) + 60 / 4 * len(text) < SIZE_LIMIT


@pytest.mark.long
def test_the_same_bus_gives_the_same_page(tmp_path: Path) -> None:
    """Simulated, and replayed from its log; only names and notes differ."""
    pytest.importorskip("plotly")
    log, paths = tmp_path / "run.log", [tmp_path / "one.html", tmp_path / "two.html"]
    arguments = [
        "simulate",
        "--as-built",
        "clean",
        "--shifts",
        "3",
        "--seed",
        "5",
        "--log",
        str(log),
    ]
    assert main([*arguments, "--report", str(paths[0])]) == 0
    assert main(["replay", str(log), "--report", str(paths[1])]) == 0
    found = [page_data(path.read_text(encoding="utf-8")) for path in paths]
    assert len(found[0]["shifts"]) == 3
    assert found[0] == found[1]


def test_on_a_narrow_page_every_cell_of_a_shift_has_its_column_s_name(
    simulated: tuple[Report, list[ShiftRow]], data: dict[str, Any]
) -> None:
    made = page(simulated[0], data, PLOTLY_STUB)
    tables = re.findall(r'<table class="stacked">(.*?)</table>', made, flags=re.DOTALL)
    assert len(tables) == 2
    for each in tables:
        names = re.findall(r"<th[^>]*>([^<]*)</th>", each.split("</thead>")[0])
        rows = [row for row in each.split("</thead>")[1].split("<tr") if "<td" in row]
        assert rows
        for row in rows:
            assert re.findall(r'data-name="([^"]*)"', row) == names


def test_what_happened_comes_first_and_the_estimators_last(
    simulated: tuple[Report, list[ShiftRow]], data: dict[str, Any]
) -> None:
    made = page(simulated[0], data, PLOTLY_STUB)
    places = [
        made.index(words)
        for words in ("</h1>", "Tooth met gap at first contact in ", "<h2>Summary", "<h2>Shifts",
                      "<h2>Estimates and log", "<h2>Provenance")
    ]  # fmt: skip
    assert places == sorted(places)


def test_a_run_without_shifts_is_a_page_too(tmp_path: Path) -> None:
    pytest.importorskip("plotly")
    path = tmp_path / "report.html"
    write_report(path, Report("empty", "", SHEET, [ReportRun("target_phase", [])], {}))
    assert "No shift" in path.read_text(encoding="utf-8")


@settings(deadline=None)
@given(
    start_deg=st.floats(-3.7, 3.7),
    slip_rpm=st.floats(-600.0, 600.0),
    change_rpm_ms=st.floats(-3.0, 3.0),
)
def test_a_wrapped_phase_is_unwrapped_by_its_slip(
    start_deg: float, slip_rpm: float, change_rpm_ms: float
) -> None:
    """A quadratic phase at up to 600 rpm, sampled every 10 ms, many pitches a sample."""
    times = np.arange(0.0, 200.0, 10.0)
    slips = slip_rpm + change_rpm_ms * times
    phase = start_deg + 0.006 * (slip_rpm * times + change_rpm_ms * times**2 / 2)
    wrapped = phase - PITCH_DEG * np.floor(phase / PITCH_DEG + 0.5)
    curve = unwrapped_deg(times, wrapped, slips, PITCH_DEG)
    assert curve - curve[0] == pytest.approx(phase - phase[0], abs=1e-6)
    assert onto_branch(wrapped, phase + 3.0, PITCH_DEG) == pytest.approx(phase, abs=1e-6)


@pytest.mark.parametrize(("hits", "trials"), [(0, 5), (1, 12), (10, 10), (58, 60), (1, 2)])
def test_intervals_of_rates_are_those_of_scipy(hits: int, trials: int) -> None:
    interval = binomtest(hits, trials).proportion_ci(0.95, method="wilson")
    assert wilson(hits, trials) == pytest.approx((interval.low, interval.high), abs=1e-6)


@pytest.mark.device
def test_a_browser_draws_the_shift_in_the_address_and_complains_of_nothing(
    simulated: tuple[Report, list[ShiftRow]], tmp_path: Path
) -> None:
    pytest.importorskip("plotly")
    path = tmp_path / "report & more.html"
    write_report(path, simulated[0])
    shown, console = browse(f"{path.as_uri()}#shift-1-4", tmp_path)
    assert console == []
    drawn = re.sub(r"<script.*?</script>", "", shown, flags=re.DOTALL)
    assert "target_phase, shift 4: gear 10 to 12, tooth met gap" in drawn
    assert drawn.count("main-svg") >= 3
    assert 'id="shift-1-4" class="chosen"' in drawn
    time_line = re.search(r'<div class="cursor" style="[^"]*height: ([\d.]+)px', drawn)
    panels = re.findall(
        r'data-subplot="xy\d*" x="[\d.]+" y="([\d.]+)"[^>]* height="([\d.]+)"', drawn
    )
    assert time_line is not None
    ends = [(float(y), float(y) + float(height)) for y, height in panels]
    high = max(bottom for _, bottom in ends) - min(top for top, _ in ends)
    assert float(time_line[1]) <= high + 1.0, "it strikes through the names of moments"


@pytest.mark.device
def test_on_a_narrow_page_names_and_legends_cover_no_curve_and_nothing_is_cut(
    simulated: tuple[Report, list[ShiftRow]], tmp_path: Path
) -> None:
    pytest.importorskip("plotly")
    path = tmp_path / "report.html"
    write_report(path, simulated[0])
    width = 500
    shown, console = browse(f"{path.as_uri()}#shift-1-4", tmp_path, width=width)
    assert console == []
    drawn = re.sub(r"<script.*?</script>", "", shown, flags=re.DOTALL)
    figure = drawn[drawn.index('id="figure"') :]
    assert "modebar-group" not in figure, "icons lie over the names of moments"
    panels = {
        name.replace("xy", "legend"): float(top)
        for name, top in re.findall(r'data-subplot="(xy\d*)" x="[\d.]+" y="([\d.]+)"', figure)
    }
    legends = re.findall(
        r'<g class="(legend\d*)"[^>]*translate\([\d.]+,([\d.]+)\)"><rect[^>]* height="(\d+)"',
        figure,
    )
    assert len(legends) >= 5
    for name, top, height in legends:
        assert float(top) + float(height) <= panels[name] + 1.0, name
    names = [
        (float(x), float(y), float(wide))
        for x, y, wide in re.findall(
            r'<g class="cursor-pointer" transform="translate\(([-\d.]+),([-\d.]+)\)">'
            r'<rect class="bg" x="[\d.]+" y="[\d.]+" width="([\d.]+)"', figure
        )
    ]  # fmt: skip
    assert len(names) >= 4
    for k, (x, y, wide) in enumerate(names):
        assert x >= 0.0 and x + wide <= width
        others = [(a, w) for a, b, w in names[:k] if abs(b - y) < 10.0]
        assert all(x + wide <= a or a + w <= x for a, w in others)


def test_a_bound_does_not_go_on_across_a_hole(data: dict[str, Any]) -> None:
    """Plotly's fill would: the spread of a prediction that is not there."""
    for figure in data["shifts"].values():
        for trace in figure["data"]:
            if trace.get("fill") == "tonexty":
                assert None not in trace["x"]
                assert max(np.diff(trace["x"]), default=0.0) <= 50.0
