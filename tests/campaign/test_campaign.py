"""A campaign's results depend on its arguments alone, and nothing done is ever lost."""

from __future__ import annotations

import json
import re
from concurrent.futures import Future
from html import escape
from pathlib import Path
from typing import Any, cast

import pytest
from campaigns import SMALL, Outcome, campaign, judged_shift

from meshpoint.base.exits import Exit
from meshpoint.campaigns import runner
from meshpoint.campaigns.columns import Shifts
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.campaigns.run import RunResult, run_many
from meshpoint.campaigns.spec import CampaignSpec, Job
from meshpoint.campaigns.summary import summarise
from meshpoint.campaigns.table import CELLS
from meshpoint.cli.json_keys import STRATEGY_KEYS
from meshpoint.cli.main import main
from meshpoint.results.rows import ShiftRow

RUNS = ("--runs", "2", "--true-state")


@pytest.fixture(scope="module")
def by_one(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return campaign(tmp_path_factory.mktemp("one"), *RUNS, "--jobs", "1")


@pytest.mark.long
def test_two_workers_give_the_same_bytes_as_one(by_one: Outcome, tmp_path: Path) -> None:
    by_two = campaign(tmp_path, *RUNS, "--jobs", "2")
    assert by_one.code == by_two.code == Exit.DONE
    assert by_two.text == by_one.text
    assert by_two.table == by_one.table


@pytest.mark.long
def test_a_dask_cluster_gives_the_same_bytes(by_one: Outcome, cluster: str, tmp_path: Path) -> None:
    assert campaign(tmp_path, *RUNS, "--dask", cluster).text == by_one.text


def test_every_strategy_is_judged_on_the_same_draws(by_one: Outcome) -> None:
    table = by_one.table
    assert len(table) == 2 * 3
    key = ("seed", "shift", "from_gear", "to_gear", "layshaft_rpm", "backlash_percent")
    draws = {
        name: [tuple(row[k] for k in key) for row in table if row["strategy"] == name]
        for name in ("speed_window", "target_phase", "true_state")
    }
    assert draws["speed_window"] == draws["target_phase"] == draws["true_state"]
    assert len({row["layshaft_rpm"] for row in table}) == 2


def test_the_json_says_what_was_asked(by_one: Outcome) -> None:
    values = by_one.values
    assert values["runs"] == 2
    assert values["failed"] == []
    assert list(values["strategies"]) == ["speed_window", "target_phase", "true_state"]
    for strategy, figures in values["strategies"].items():
        low, high = figures["first_contact_gap"]["ci95"]
        assert low <= figures["first_contact_gap"]["rate"] <= high
        assert {"mean", "p50", "p99"} <= set(figures["duration_ms"])
        assert {"mean", "p99"} <= set(figures["impact_j"])
        ramp_ms = figures["phases_ms"]["ramp_ms"] or 0.0
        after_ms = figures["duration_ms"]["mean"] - ramp_ms
        assert figures["after_ramp_ms"]["mean"] == pytest.approx(after_ms)
        for key in (
            "retries", "blocked", "not_engaged", "phase_error_sd_deg", "reference_known",
        ):  # fmt: skip
            assert isinstance(figures[key], (int, float))
        known_from = sum(figures["reference_sources"].values())
        assert strategy == "true_state" or known_from == pytest.approx(figures["reference_known"])
    assert "target_phase/speed_window" in values["ratios"]


def test_one_sentence_says_whether_the_strategy_named_last_is_better(by_one: Outcome) -> None:
    """As measured: two runs tell nothing beyond chance."""
    verdict, strategies = by_one.values["verdict"], by_one.values["strategies"]
    assert verdict.startswith("On the same 2 shifts phase control ")
    for key, unit, digits in (("duration_ms", "ms", 0), ("impact_j", "J", 2)):
        means = [strategies[name][key]["mean"] for name in ("target_phase", "speed_window")]
        if any(means):
            told = f"{means[0]:.{digits}f} instead of {means[1]:.{digits}f} {unit}"
            assert told in verdict
    assert escape(verdict) in (by_one.folder / "report.html").read_text()


@pytest.mark.parametrize(
    ("impact_j", "words"),
    [
        (1.0, "is better than the speed window (today) in first contact in a gap and worse in imp"),
        (0.1, "is better than the speed window (today): first contact in a gap 100.0 instead of "),
    ],
)
def test_the_sentence_has_the_sign_that_was_measured(impact_j: float, words: str) -> None:
    """20 runs, each alike: every difference is beyond chance, whichever way it goes."""
    records = [
        judged_shift(seed=seed, strategy=name, duration_ms=400.0, contact=contact, impact_j=j)
        for seed in range(20)
        for name, contact, j in (
            ("speed_window", "gap" if seed % 5 == 0 else "tooth", 0.5),
            ("target_phase", "gap", impact_j),
        )
    ]
    verdict = summarise(Shifts.of(records), ("speed_window", "target_phase"))["verdict"]
    assert verdict.startswith(f"On the same 20 shifts phase control {words}")
    assert "time 400 instead of 400 ms;" in verdict


def test_shifts_whose_impact_is_not_complete_are_counted() -> None:
    records = [
        judged_shift(seed=seed, strategy="target_phase", impact_complete=seed > 2)
        for seed in range(8)
    ]
    figures = summarise(Shifts.of(records), ("target_phase",))["strategies"]["target_phase"]
    assert CELLS["impact incomplete"](figures) == "3"


def test_every_figure_is_in_the_reference() -> None:
    figures = summarise(Shifts.of([judged_shift(strategy="x")]), ("x",))["strategies"]["x"]
    assert set(figures) == set(STRATEGY_KEYS)


def test_shifts_with_an_abort_and_aborts_in_all_are_figures_of_each_strategy() -> None:
    """Three of eight shifts, four aborts: the rate with its interval, and the mean."""
    aborts = [2, 1, 1, 0, 0, 0, 0, 0]
    records = [
        judged_shift(seed=seed, strategy="target_phase", duration_ms=400.0, aborts=count)
        for seed, count in enumerate(aborts)
    ]
    figures = summarise(Shifts.of(records), ("target_phase",))["strategies"]["target_phase"]
    assert figures["aborts_mean"] == pytest.approx(4 / 8)
    assert figures["aborted"]["rate"] == pytest.approx(3 / 8)
    low, high = figures["aborted"]["ci95"]
    assert low < 3 / 8 < high
    assert CELLS["aborted"](figures).startswith("37.5 % (")
    assert CELLS["aborts a shift"](figures) == "0.50"


def test_the_table_on_disk_and_the_page_have_the_aborts(by_one: Outcome) -> None:
    for row in by_one.table:
        assert row["aborts"] >= 0
        assert (row["halt_mm"] is None) == (row["aborts"] == 0)
    page = (by_one.folder / "report.html").read_text()
    lines = page.partition("<h2>Strategies</h2>")[2].partition("</table>")[0]
    assert re.findall(r"<tr><td>([^<]*)</td>", lines) == list(CELLS)


def test_the_report_draws_every_figure_without_a_network(by_one: Outcome) -> None:
    page = (by_one.folder / "report.html").read_text()
    assert "default-src 'none'" in page
    text = page.partition("id='data'>")[2].partition("</script>")[0]
    for name, figure in json.loads(text).items():
        assert f'id="{name}"' in page
        assert {trace["name"] for trace in figure["data"]} == set(by_one.values["strategies"])
        assert all(trace["x"] for trace in figure["data"])


def test_ctrl_c_waits_for_one_run_of_a_worker_and_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Four runs were handed over together: minutes on a busy machine, in silence."""
    handed: list[Future[list[RunResult]]] = []

    class Run(Future[list[RunResult]]):
        def result(self, timeout: float | None = None) -> list[RunResult]:
            self.set_result([])  # it ends while it is waited for
            return super().result(timeout)

    class OneWorker:
        def submit(self, _work: object, _spec: object, jobs: list[int]) -> Future[list[RunResult]]:
            assert len(jobs) == 1
            handed.append(Run())
            return handed[-1]

    class Interrupted:
        def put(self, future: Future[list[RunResult]]) -> None:
            """Never looked at."""

        def get(self) -> Future[list[RunResult]]:
            handed[0].set_running_or_notify_cancel()
            raise KeyboardInterrupt

    monkeypatch.setattr(runner, "SimpleQueue", Interrupted)
    taken: list[list[RunResult]] = []
    jobs: Any = list(range(40))
    assert not runner.run_all(cast(Any, None), jobs, cast(Any, OneWorker()), taken.append)
    assert taken == [[]]
    assert "interrupted: ending the runs in work first, 1 of them" in capsys.readouterr().err
    assert all(future.cancelled() for future in handed[1:])


def test_an_interrupted_campaign_goes_on_to_the_same_result(
    by_one: Outcome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(spec: CampaignSpec, jobs: list[Job]) -> list[RunResult]:
        if jobs[0].seed == 1_000_001:
            raise KeyboardInterrupt
        return run_many(spec, jobs)

    with monkeypatch.context() as patch:
        patch.setattr(runner, "run_many", interrupted)
        assert campaign(tmp_path, *RUNS, "--jobs", "1").code == Exit.INTERRUPTED
    made: list[int] = []

    def counted(spec: CampaignSpec, jobs: list[Job]) -> list[RunResult]:
        made.extend(job.seed for job in jobs)
        return run_many(spec, jobs)

    monkeypatch.setattr(runner, "run_many", counted)
    resumed = campaign(tmp_path, *RUNS, "--jobs", "1", "--resume")
    assert made == [1_000_001]
    assert resumed.text == by_one.text
    assert resumed.table == by_one.table
    assert not (tmp_path / "parts").exists()


@pytest.mark.long
def test_a_finished_campaign_grows(by_one: Outcome, tmp_path: Path) -> None:
    campaign(tmp_path, "--runs", "1", "--true-state", "--jobs", "1")
    grown = campaign(tmp_path, *RUNS, "--jobs", "1", "--resume")
    assert grown.text == by_one.text


def test_a_failed_run_is_named_by_its_seed_and_the_others_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shift, begin = ClosedLoop.shift, ClosedLoop.__init__
    seeds: dict[int, int] = {}

    def note(loop: ClosedLoop, sheet, settings, preset, drawn, **more) -> None:  # type: ignore[no-untyped-def]
        begin(loop, sheet, settings, preset, drawn, **more)
        seeds[id(loop)] = drawn.seed

    def breaks(loop: ClosedLoop) -> ShiftRow | None:
        if seeds.get(id(loop)) == 1_000_001:
            raise ArithmeticError("the gearbox flew apart")
        return shift(loop)

    monkeypatch.setattr(ClosedLoop, "__init__", note)
    monkeypatch.setattr(ClosedLoop, "shift", breaks)
    found = campaign(tmp_path, "--runs", "2", "--jobs", "1")
    assert found.code == Exit.FAILED
    assert found.values["runs"] == 1
    assert found.values["failed"] == [
        {"seed": 1_000_001, "error": "ArithmeticError: the gearbox flew apart"}
    ]
    assert "--only 1000001" in capsys.readouterr().err
    # alone, it fails again, with its traceback
    assert main(["campaign", *SMALL, "--only", "1000001"]) == Exit.FAILED
    assert "in breaks" in capsys.readouterr().err


def test_one_run_alone_has_the_shifts_it_had_among_all(by_one: Outcome, tmp_path: Path) -> None:
    alone = campaign(tmp_path, "--true-state", "--only", "1000001")
    assert alone.values["shifts"] == [row for row in by_one.table if row["seed"] == 1_000_001]


def test_a_sweep_makes_the_same_draws_with_one_thing_changed(tmp_path: Path) -> None:
    few = ("--runs", "2", "--jobs", "1", "--learn", "0", "--strategy", "speed_window")
    found = campaign(tmp_path, *few, "--sweep", "backlash_percent=10,40")
    rows = found.table
    assert [point["value"] for point in found.values["sweep"]] == [10.0, 40.0]
    unswept = {row["seed"]: row["backlash_percent"] for row in rows if row["sweep"] == ""}
    assert set(unswept) == {1_000_000, 1_000_001}
    assert (
        unswept[1_000_000] != unswept[1_000_001]
    )  # each gearbox has its own, about the sheet's 20
    for value in (10.0, 40.0):
        swept = [row for row in rows if row["sweep_value"] == value]
        assert {row["seed"] for row in swept} == set(unswept)
        for row in swept:
            assert row["backlash_percent"] == pytest.approx(unswept[row["seed"]] * value / 20.0)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--sweep", "window.aim_rpm=1"), "keys of 'window' are"),
        (("--sweep", "backlash_percent=90"), "allowed is a number from 2 to 50"),
        (("--sweep", "nonsense=1"), "allowed are backlash_percent"),
        (("--seed", "2", "--resume"), "different in provenance"),
        ((), "--resume goes on with it"),
        (("--runs", "1", "--resume"), "leaves out 1 of the runs that it has; --runs"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(
    arguments: tuple[str, ...],
    said: str,
    by_one: Outcome,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert campaign(by_one.folder, *RUNS, *arguments).code == Exit.BAD_INPUT
    error = capsys.readouterr().err.strip()
    assert said in error
    assert len(error.splitlines()) == 1


def test_an_unknown_strategy_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["campaign", "--strategy", "luck"])
    assert "allowed are speed_window" in capsys.readouterr().err
