"""Every table of every command in a terminal of 80 columns: no header and no label is cut."""

from __future__ import annotations

import ast
import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import create_autospec

import pytest
from rich.console import Console
from rich.markup import render
from rich.table import Table

import benchmarks
import meshpoint
from benchmarks.envelope.table import on_screen
from benchmarks.studies import command as study_command
from benchmarks.studies.record import Finding, Statement, ThesisVerdict
from benchmarks.studies.registry import STUDY_NAMES, load
from benchmarks.studies.runner import StudyRecord
from benchmarks.swarm.command import reached_table
from benchmarks.swarm.swarm import Swarm
from meshpoint.campaigns import table as campaign_table
from meshpoint.campaigns.record import JudgedShift
from meshpoint.campaigns.verdict_words import against_table
from meshpoint.cli import show_calibration as calibration_command
from meshpoint.cli import show_gearbox as gearbox_command
from meshpoint.cli import show_messages as messages_command
from meshpoint.cli.main import main
from meshpoint.commission.check_command import findings_table
from meshpoint.commission.commission_command import measured_table
from meshpoint.commission.finding import Finding as CheckFinding
from meshpoint.commission.finding import Verdict
from meshpoint.controller.run.kept import read_file
from meshpoint.controller.settings.learned import Calibration
from meshpoint.controller.settings.settings import STRATEGY_NAMES
from meshpoint.dbc.schema import SCHEMA
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.derived import sheet_figures
from meshpoint.gearbox.sheet import SHEET_NAMES
from meshpoint.identify.held_out import HeldOut
from meshpoint.identify.identify import identify
from meshpoint.identify.identify_command import checks_table, figures_table
from meshpoint.identify.log_reader import LogContent
from meshpoint.logs import captures_command
from meshpoint.logs.captures import CaptureRow
from meshpoint.logs.seen_shift import SeenShift
from meshpoint.replays import compare_command
from meshpoint.replays.replay_sensors import seen_table
from meshpoint.report.comparison import compare, comparison_table
from meshpoint.report.judged import Decision, Judged, Parting
from meshpoint.report.judged_rows import JudgedRow, judged_table
from meshpoint.results.output import rows_table
from meshpoint.results.rows import ShiftRow
from meshpoint.results.shift_parts import PARTS
from meshpoint.rig_sim.truck.as_built import draw_as_built
from meshpoint.run.describe import faults_table, parameters_table

WIDTH = 80
LONGEST = "speed_window_anticipating"
STRATEGIES = (*STRATEGY_NAMES, "true_state")

ROW = ShiftRow(
    from_=10, to=12, strategy=LONGEST, reference="unknown", result="ended_between_gears",
    duration_ms=10_440.0, slip_rpm=-123.4, phase_error_deg=-3.75, pitch_deg=7.5, contact="tooth",
    attempts=3, predicted_phase_deg=None, predicted_phase_sd_deg=None, delay_ms=None, request_us=0,
    contact_us=None, end_us=0, fault="guard_blocked", impact_j=0.0, face_ms=0.0, ratchets=0,
    blocked=0, reference_source="none", speed_lost_kmh=None,
)  # fmt: skip
RECORD = JudgedShift(
    sweep="", sweep_value=0.0, seed=1, shift=0, strategy=LONGEST, from_gear=10, to_gear=12,
    main_gear="third", ratio=1.0, layshaft_rpm=1400.0, reference_known=False,
    reference_source="none", result="ended_between_gears", fault="none", contact="tooth",
    duration_ms=10_436.0, slip_rpm=-123.4, phase_error_deg=-3.75, pitch_deg=7.5,
    predicted_phase_deg=None, predicted_phase_sd_deg=None, delay_ms=None, attempts=3,
    impact_j=123.45, face_ms=0.0, ratchets=0, blocked=0, backlash_percent=20.0, gap_share=0.2,
    delay_sd_ms=1.0, oil_c=None, slope_percent=None, mass_kg=None, supply_offset_bar=None,
    bound_ms=None,
    **dict.fromkeys(PARTS),
)  # fmt: skip
AGAINST = {
    "reference": "origin/a-branch-with-a-name (0123456789ab of /srv/somebody/else/truck/node)",
    "strategy": LONGEST, "strategy_before": "target_phase", "verdict": "not decided",
    "runs": 100_000, "pairs": 1_000_000, "worse": 100_000, "better": 100_000,
    "missed_by_both": 100_000, "misses_before": 0.123, "misses_after": 0.123,
    "baseline": {"shifts": 1_000_000, "misses": 100_000}, "evidence": -12.34, "margin": 0.125,
    "judged": {
        "first_contact_gap": {"verdict": "not decided"},
        "duration_ms": {
            "verdict": "not decided",
            "ratio": 12.345,
            "interval": [10.123, 14.567],
            "margin": 0.125,
        },
    },
}  # fmt: skip
CAPTURE = CaptureRow(
    "crank-60-2-cold-start.csv", "60-2", 60, "Channel 0", "inverted", 123_456, 123_400, 12_345.6,
    123, 123, 12, 1_234, 123, 123_400, 123, [0.1], 12_345.6, 12_345.6, 1_234.5, [],
)  # fmt: skip


def campaign_values() -> dict[str, Any]:
    """Figures as wide as they come."""
    span = {"mean": 12_436.0, "p50": 12_436.0, "p99": 12_436.0}
    figures = {
        "shifts": 2_000_000,
        "first_contact_gap": {"rate": 0.9912, "ci95": [0.9861, 0.9945]},
        "duration_ms": span,
        "impact_j": span | {"incomplete": 2_000_000},
        "slip_rpm_mean": -123.4,
        "phases_ms": dict.fromkeys(PARTS, 12_436.7),
        "bound_ms": 12_436.0,
        "over_minimum": 12.345,
        "after_ramp_ms": {"mean": 12345.6, "p50": 12345.6, "p99": 12345.6},
        "bounced_off": 2_000_000,
        "aborted": {"rate": 0.1234, "ci95": [0.1061, 0.1345]},
        "aborts_mean": 12.39,
        "retries": 2_000_000,
        "blocked": 2_000_000,
        "outside_window": 2_000_000,
        "not_engaged": 2_000_000,
        "refused": 2_000_000,
        "promise": {"shifts": 2_000_000, "said": 0.8912, "kept": 0.9234},
        "phase_error_sd_deg": 12.39,
        "reference_known": 1.0,
    }
    ratio = {"ratio": 14.51, "ci95": [14.28, 14.79]}
    keys = ("first_contact_gap_rate", "duration_ms_mean", "duration_ms_p99", "impact_j_mean")
    pairs = [(a, b) for a in STRATEGIES for b in STRATEGIES if a != b]
    return {
        "runs": 1_000_000,
        "strategies": dict.fromkeys(STRATEGIES, figures),
        "ratios": {f"{a}/{b}": dict.fromkeys(keys, ratio) for a, b in pairs},
        "verdict": "",
    }


def of_a_campaign(values: dict[str, Any]) -> list[Table]:
    """The tables that are printed of it: strategies, parts, and the ratios last."""
    out = create_autospec(Console, instance=True)
    campaign_table.print_tables(out, values, GEARBOX)
    printed = [each for call in out.print.call_args_list for each in call.args]
    return [each for each in printed if isinstance(each, Table)]


def envelope_values() -> dict[str, Any]:
    """Two rows as wide as they come, one of them against a commit."""
    row = {
        "shifts": 10_000,
        "gap": {"rate": 0.9912, "ci95": [0.9861, 0.9945]},
        "true_state": 0.9912,
        "after_ramp_ms": {"mean": 12345.6, "p99": 12345.6},
        "duration_ms": 12345.6,
        "impact_j": 12.345,
        "outside_window": 123,
        "not_engaged": 123,
        "refused": 123,
        "reference_known": 0.9912,
        "promised": 0.9912,
        "met": 0.9912,
    }
    return {"splitter_down": row, "clean": row | {"against": {"verdict": "doubtful"}}}


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    path = tmp_path_factory.mktemp("calibration") / "box.toml"
    run = ["simulate", "--preset", "thesis", "--shifts", "2", "--calibration", str(path)]
    assert main([*run, "--json", str(path.with_name("j"))]) == 0
    return read_file(path, None)


def study_record(name: str) -> StudyRecord:
    study = load(name)
    said = Statement(
        "so", "ours is 12.3 +- 0.4 deg, where theirs is 12.4", ThesisVerdict.NOT_COMPARABLE, ""
    )
    settings = {"common": {"gearbox": "truck12", "profile": "typical"}}
    return StudyRecord(name, study.title, study.of, Finding((said, said), {}), (), settings)


def judged(strategy: str) -> JudgedRow:
    last = Decision(1_000.0, "committed", 900.0, 12_345.6, 12_390.6, -12.34, 10.23, 34.5)
    shift = Judged(
        10, 12, 0, strategy, "known", "fired", "none", last, last,
        Parting(12_345.6, ("brake",), (last, last)), 1_000.0, 12_390.6, "",
    )  # fmt: skip
    return JudgedRow(replace(ROW, strategy=strategy), shift)


GEARBOX = "sheet truck12, profile typical, 3 as-built values overridden"
TABLES: dict[str, Callable[[], Table]] = {
    "results.output.rows_table": lambda: rows_table("title", [ROW]),
    "report.comparison.comparison_table": lambda: comparison_table(
        compare({name: [ROW] * 1000 for name in STRATEGIES}), GEARBOX
    ),
    "envelope.table.on_screen": lambda: on_screen(envelope_values(), "title"),
    "campaigns.table._strategies": lambda: of_a_campaign(campaign_values())[0],
    "campaigns.table._parts": lambda: of_a_campaign(campaign_values())[-2],
    "campaigns.table._ratios": lambda: of_a_campaign(campaign_values())[-1],
    "campaigns.verdict_words.against_table": lambda: against_table(AGAINST, GEARBOX),
    "campaigns.table.records_table": lambda: campaign_table.records_table("run 1", [RECORD]),
    "report.judged_rows.judged_table": lambda: judged_table("title", [judged(LONGEST)]),
    "swarm.command.reached_table": lambda: reached_table(Swarm().to_json(1.0), GEARBOX),
    "replays.compare_command.compared_table": lambda: compare_command.compared_table(
        "Shifts that differ", ("field", "A", "B"), [("shifts.0.slip_rpm", "20.1", "25.3")]
    ),
    "commission.check_command.findings_table": lambda: findings_table(
        [
            CheckFinding(
                "shafts", "layshaft to propeller, main gear second", Verdict.UNKNOWN, "of " * 50
            )
        ]
    ),
    "commission.commission_command.measured_table": lambda: measured_table(
        [
            {
                "key": "clutch.kiss_tolerance_percent",
                "measured": 3.25678,
                "sheet": 5.0,
                "interval": "0.01234 to 0.05678",
                "how": "of " * 9,
            }
        ]
    ),
    "identify.identify_command.figures_table": lambda: figures_table(
        [
            replace(one, value=-0.01234, low=-0.01987, high=-0.01123, sheet=-0.01234, samples=1234)
            for one in identify(LogContent(), load_sheet("truck12")).figures
        ]
    ),
    "identify.identify_command.checks_table": lambda: checks_table(
        [HeldOut("layshaft speed at the end of a run", "rpm", 12_345, 0.00012345, 0.00012345)]
    ),
    "logs.captures_command.counts_table": lambda: captures_command.counts_table([CAPTURE]),
    "logs.captures_command.errors_table": lambda: captures_command.errors_table([CAPTURE]),
    "replays.replay_sensors.seen_table": lambda: seen_table(
        "shifts that the log shows, by the ratio of speeds",
        [SeenShift(10, 12, 86_400_000_000, 86_400_500_000)],
    ),
    "studies.command.list_table": lambda: study_command.list_table(
        [load(name) for name in STUDY_NAMES]
    ),
    "studies.command._table": lambda: study_command._table(
        [study_record(name) for name in STUDY_NAMES]
    ),
    "run.describe.parameters_table": lambda: parameters_table(
        draw_as_built(7, {}), {"brake_gain": 1.0}
    ),
    "run.describe.faults_table": faults_table,
    "cli.show_messages.messages_table": messages_command.messages_table,
    "cli.show_messages.signals_table": lambda: messages_command.signals_table(SCHEMA.messages[11]),
    "cli.show_gearbox._gear_table": lambda: gearbox_command._gear_table(
        load_sheet("truck12"), sheet_figures(load_sheet("truck12"))
    ),
}
"""By module and function; those of `show calibration` need a file and stand below."""
WITH_A_FILE = ("cli.show_calibration._wheel_table", "cli.show_calibration._gear_table")


def check(table: Table) -> None:
    """Every word of a header and of a label stands whole in what a terminal shows."""
    out = io.StringIO()
    console = Console(file=out, width=WIDTH, force_terminal=False, color_system=None)
    console.print(table)
    shown = out.getvalue()
    assert "…" not in shown, shown
    assert max(map(len, shown.splitlines())) <= WIDTH
    labels = [str(column.header) for column in table.columns]
    labels += [str(cell) for cell in table.columns[0].cells]
    found = set(shown.split())
    for word in " ".join(render(label).plain for label in labels).split():
        assert word in found, f"{word!r} is cut in:\n{shown}"


@pytest.mark.parametrize("name", TABLES)
def test_a_table_fits_80_columns(name: str) -> None:
    check(TABLES[name]())


def test_more_strategies_than_have_room_stand_in_a_table_below() -> None:
    values, out = campaign_values() | {"ratios": {}}, io.StringIO()
    names = ["one", "two", "three", "four", "five", "six"]
    values["strategies"] = dict.fromkeys(names, next(iter(values["strategies"].values())))
    console = Console(file=out, width=WIDTH, force_terminal=False, color_system=None)
    campaign_table.print_tables(console, values, GEARBOX)
    words = out.getvalue().split()
    assert [words.count(name) for name in names] == [2] * len(names)
    assert "…" not in out.getvalue()


def test_a_ratio_names_both_strategies_each_on_lines_of_its_own() -> None:
    own = "examples/own_strategy.py:NextGap"
    keys = ("first_contact_gap_rate", "duration_ms_mean", "duration_ms_p99", "impact_j_mean")
    ratio = {key: {"ratio": 1.0, "ci95": [0.9, 1.1]} for key in keys}
    values = campaign_values()
    figures = values["strategies"]["target_phase"]
    values["strategies"] = dict.fromkeys(["speed_window", "target_phase", own], figures)
    values["ratios"] = {"target_phase/speed_window": ratio, f"{own}/target_phase": ratio}
    table = of_a_campaign(values)[-1]
    assert list(table.columns[0].cells) == [
        "target_phase\n/ speed_window",
        "own_\nstrategy.py:\nNextGap\n/ target_phase",
    ]


def test_what_was_learned_fits_80_columns(learned: Calibration) -> None:
    check(calibration_command._wheel_table(calibration_command._wheels(learned)))
    check(calibration_command._gear_table(learned))


@pytest.mark.parametrize("name", SHEET_NAMES)
def test_each_data_sheet_fits_80_columns(name: str) -> None:
    sheet = load_sheet(name)
    check(gearbox_command._gear_table(sheet, sheet_figures(sheet)))


@pytest.mark.parametrize("message", SCHEMA.messages, ids=lambda message: message.name)
def test_the_signals_of_each_message_fit_80_columns(message: Any) -> None:
    check(messages_command.signals_table(message))


def makers() -> set[str]:
    """Every function of the command line that makes a table for a terminal."""
    found = set()
    roots = (Path(meshpoint.__file__).parent, Path(benchmarks.__file__).parent)
    for root, path in ((folder, path) for folder in roots for path in folder.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if "from rich.table import Table" not in ast.unparse(tree):
            continue
        module = ".".join(path.relative_to(root).with_suffix("").parts)
        for function in ast.walk(tree):
            if isinstance(function, ast.FunctionDef):
                calls = [call.func for call in ast.walk(function) if isinstance(call, ast.Call)]
                if any(isinstance(call, ast.Name) and call.id == "Table" for call in calls):
                    found.add(f"{module}.{function.name}")
    return found


def test_no_table_is_left_out_here() -> None:
    assert makers() == {*TABLES, *WITH_A_FILE}
