"""The demo's summary: learning apart from aiming, strategies over the same shifts of the plan."""

from __future__ import annotations

from dataclasses import replace

import pytest
from rich.console import Console

from meshpoint.bench.simulate import Setup, simulate
from meshpoint.campaigns.figures import frontier
from meshpoint.controller.plan.strategist import STRATEGIES
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.report.collect import ReportCollector
from meshpoint.report.comparison import (
    KNOWN,
    LEARNING,
    STRATEGY_WORDS,
    compare,
    comparison_table,
    explain,
    headline,
    strategies_explained,
    verdict,
)
from meshpoint.report.page import page
from meshpoint.report.run import Report, ReportRun
from meshpoint.results.rows import ShiftRow
from meshpoint.rig_sim.settings import Preset

SHEET = load_sheet("truck12")
GEARBOX = "sheet truck12, profile typical"


def row(
    strategy: str, gears: tuple[int, int], reference: str, contact: str | None, ms: float
) -> ShiftRow:
    return ShiftRow(
        from_=gears[0], to=gears[1], strategy=strategy, reference=reference, result="engaged",
        duration_ms=ms, slip_rpm=1.0, phase_error_deg=0.5 if contact else None, pitch_deg=7.5,
        contact=contact, attempts=1, predicted_phase_deg=None, predicted_phase_sd_deg=None,
        delay_ms=None, request_us=0, contact_us=None, end_us=0, fault="none",
    )  # fmt: skip


def window(*known: str) -> list[ShiftRow]:
    rows = [row("speed_window", (8, 10), "unknown", "gap", 900.0)]
    return rows + [row("speed_window", (8, 10), "known", each, 500.0) for each in known]


def aimed(*known: str) -> list[ShiftRow]:
    rows = [row("speed_window", (8, 10), "unknown", "tooth", 800.0)]
    return rows + [row("target_phase", (8, 10), "known", each, 400.0) for each in known]


def test_both_strategies_have_the_same_shifts() -> None:
    groups = compare(
        {"speed_window": window("gap", "tooth", "tooth"), "target_phase": aimed(*["gap"] * 3)}
    )
    assert [(g.kind, g.strategy, g.gap, g.shifts) for g in groups] == [
        (KNOWN, "speed_window", 1, 3),
        (KNOWN, "target_phase", 3, 3),
        (LEARNING, "speed_window", 1, 1),
        (LEARNING, "target_phase", 0, 1),
    ]
    assert [g.mean_duration_ms for g in groups] == [500.0, 400.0, 900.0, 800.0]
    assert [g.phase_error_rms_deg for g in groups] == [None, 0.5, None, None]


def test_shifts_whose_sleeve_was_aborted_are_counted_of_each_strategy() -> None:
    rows = [replace(each, aborts=k) for k, each in enumerate(aimed("gap", "gap", "gap"))]
    groups = compare({"speed_window": window("gap", "tooth", "tooth"), "target_phase": rows})
    assert [(g.kind, g.strategy, g.aborted) for g in groups] == [
        (KNOWN, "speed_window", 0),
        (KNOWN, "target_phase", 3),
        (LEARNING, "speed_window", 0),
        (LEARNING, "target_phase", 0),
    ]
    console = Console(width=80)
    with console.capture() as captured:
        console.print(comparison_table(groups, GEARBOX))
    lines = [line.split() for line in captured.get().splitlines()]
    assert lines[3][-2:] == ["ms", "abort"]
    assert [line[-1] for line in lines[4:]] == ["0", "3", "0", "0"]


def test_a_shift_known_to_one_run_alone_is_not_compared_as_aimed() -> None:
    late = [row("target_phase", (8, 10), "unknown", "tooth", 700.0), *aimed("gap")]
    groups = compare({"speed_window": window("gap", "gap"), "target_phase": late})
    assert [(g.kind, g.shifts) for g in groups] == [
        (KNOWN, 1), (KNOWN, 1), (LEARNING, 2), (LEARNING, 2),
    ]  # fmt: skip


def test_an_own_strategy_that_aims_has_its_error_and_no_folder_in_the_table() -> None:
    name = "/a/folder/far/down/" + "in_it/" * 12 + "own_strategy.py:NextGap"
    rows = [row("speed_window", (8, 10), "unknown", "tooth", 800.0)]
    rows += [row(name, (8, 10), "known", "gap", 400.0)] * 2
    own, learning = compare({name: rows})
    assert (learning.phase_error_rms_deg, own.phase_error_rms_deg) == (None, 0.5)
    assert own.strategy == name
    console = Console(width=80)
    with console.capture() as captured:
        console.print(comparison_table([own], GEARBOX))
    assert "own_strategy.py:NextGap" in captured.get()
    assert "folder" not in captured.get()


def test_contacts_that_nobody_knows_are_no_misses() -> None:
    (group,) = compare({"speed_window": [row("speed_window", (8, 10), "known", None, 1.0)] * 2})
    assert group.contacts == 0
    console = Console(width=80, record=True, file=None)
    with console.capture() as captured:
        console.print(comparison_table([group], GEARBOX))
    assert "0 of 2" not in captured.get()


def test_the_summary_fits_80_columns_and_says_what_chance_does() -> None:
    groups = compare(
        {"speed_window": window(*["tooth"] * 60), "target_phase": aimed(*["gap"] * 60)}
    )
    console = Console(width=80)
    with console.capture() as captured:
        console.print(comparison_table(groups, GEARBOX))
        for line in explain(groups, SHEET):
            console.print(line)
    text = captured.get()
    assert "…" not in text and all(len(line) <= 80 for line in text.splitlines())
    assert "60 of 60" in text and "0 of 60" in text
    assert "in 20 % of shifts: gap over pitch" in text


def with_impact(rows: list[ShiftRow], impact_j: float) -> list[ShiftRow]:
    return [replace(each, impact_j=impact_j) for each in rows]


@pytest.mark.parametrize(
    ("runs", "words"),
    [
        (
            {
                "speed_window": with_impact(window("gap", "tooth", "tooth"), 1.5),
                "target_phase": with_impact(aimed(*["gap"] * 3), 0.04),
            },
            "Tooth met gap at first contact in 3 of 3 shifts by phase control, in 1 of 3 by the "
            "speed window (today) (by chance 20 %). On the same 3 shifts phase control is better "
            "than the speed window (today): first contact in a gap 3 instead of 1 of 3 (better, "
            "within chance); time 400 instead of 500 ms (better, beyond chance); impact "
            "0.04 instead of 1.50 J (better, beyond chance). Where tooth meets tooth ",
        ),
        (
            {"target_phase": aimed("gap", "tooth")},
            "Tooth met gap at first contact in 1 of 2 shifts by phase control (by chance 20 %); "
            "400 ms a shift on average. Where tooth meets tooth ",
        ),
        (
            {"speed_window": window("tooth")},
            "Tooth met gap at first contact in 0 of 1 shifts by the speed window (today), which "
            "does not aim (by chance 20 %); 500 ms a shift on average.",
        ),
        ({"target_phase": aimed()}, "No shift was aimed: "),
        (
            {"target_phase": [row("target_phase", (8, 10), "known", None, 400.0)]},
            "The log does not say where the teeth met: ",
        ),
    ],
)
def test_the_first_line_says_what_happened_and_why_it_matters(
    runs: dict[str, list[ShiftRow]], words: str
) -> None:
    assert headline(compare(runs), SHEET, verdict(runs)).startswith(words)


def test_what_aiming_costs_is_said_as_it_was_measured_not_as_it_is_hoped_for() -> None:
    """More impact and no fewer teeth: the first line says so, and by how much."""
    runs = {
        "speed_window": with_impact(window(*["gap"] * 9), 0.5),
        "target_phase": with_impact(aimed(*["gap"] * 9), 1.25),
    }
    said = headline(compare(runs), SHEET, verdict(runs))
    assert "impact 1.25 instead of 0.50 J (worse, beyond chance)" in said
    assert "is better than the speed window (today) in time and worse in impact" in said
    assert "first contact in a gap 9 instead of 9 of 9;" in said


def test_impacts_that_are_not_complete_are_said_under_the_table() -> None:
    rows = [replace(each, impact_complete=False) for each in aimed("gap", "gap")]
    said = explain(compare({"target_phase": rows}), SHEET)
    assert any(
        line.startswith("Of 3 shifts the impact is not complete: the gear had not locked 0.4 s")
        for line in said
    )
    assert not any("not complete" in line for line in explain(compare({"x": aimed("gap")}), SHEET))


def test_every_strategy_of_the_table_is_explained() -> None:
    assert all(name in STRATEGY_WORDS for name in STRATEGIES)
    groups = compare({"/a/b/own.py:Next": [row("/a/b/own.py:Next", (8, 10), "known", "gap", 1.0)]})
    assert strategies_explained(groups) == ["own.py:Next: the strategy of this file."]


@pytest.mark.long
def test_the_page_has_the_same_groups_the_chance_and_a_word_on_few_shifts() -> None:
    setup = Setup(SHEET, ControllerSettings(), Preset.THESIS, seed=1, shifts=8)
    collector = ReportCollector(SHEET)
    simulate(setup, lambda _time_us, frame: collector.receive(frame))
    run = ReportRun("target_phase", collector.finish())
    groups = compare({run.name: [shift.row for shift in run.shifts]})
    assert {group.kind for group in groups} == {LEARNING, KNOWN}
    text = page(Report("few", "", SHEET, [run], {}), {"shifts": {}}, "")
    for group in groups:
        assert f"{group.gap} of {group.shifts}" in text
    assert "gap over pitch" in text and "Small sample" in text


@pytest.mark.parametrize(("points", "mode"), [(1, "markers"), (2, "markers"), (3, "lines+markers")])
def test_no_line_is_drawn_through_two_points(points: int, mode: str) -> None:
    strategies = {"a": {"duration_ms_mean": 400.0, "impact_j_mean": 1.0}}
    figure = frontier([(str(k), strategies) for k in range(points)], ("a",))
    assert figure["data"][0]["mode"] == mode
