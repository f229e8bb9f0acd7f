"""Workers that die and a scheduler that is lost: a clear error, and nothing done is lost."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import pytest
from campaigns import campaign, small_spec

from meshpoint.base.exits import Exit
from meshpoint.campaigns import runner
from meshpoint.campaigns.run import RunResult, run_many
from meshpoint.campaigns.runner import MOST_DEATHS, WorkersLostError, run_all
from meshpoint.campaigns.spec import CampaignSpec, Job

SPEC = small_spec()
CHEAP = ("--runs", "3", "--learn", "0", "--strategy", "speed_window", "--preset", "thesis")


class KilledWorker(Exception):
    """As Dask's: known by its name."""


class Workers(Executor):
    """Makes each run at once, or what `ends` has for its number instead."""

    def __init__(self, ends: dict[int, BaseException | None], make: Any = None) -> None:
        self._ends, self._make = ends, make
        self.in_flight = self.most_in_flight = 0

    def submit(self, _work: Any, spec: Any, jobs: list[Job]) -> Future[Any]:  # type: ignore[override]
        future: Future[list[RunResult]] = Future()
        number = jobs[0].seed % 1_000_000
        self.in_flight += 1
        self.most_in_flight = max(self.in_flight, self.most_in_flight)
        if number not in self._ends:
            made = [RunResult(jobs[0])] if self._make is None else self._make(spec, jobs)
            future.set_result(made)
        elif (error := self._ends[number]) is None:
            future.cancel()  # as futures of a client are when its scheduler is lost
        else:
            future.set_exception(error)
        return future


def made_by(workers: Workers, runs: int) -> tuple[list[int], list[RunResult], str]:
    """Seeds that were made, those that failed, and what was raised."""
    taken: list[RunResult] = []

    def take(results: list[RunResult]) -> None:
        workers.in_flight -= 1
        taken.extend(results)

    raised = ""
    try:
        assert run_all(SPEC, SPEC.jobs(runs), workers, take)
    except WorkersLostError as error:
        raised = str(error)
    made = [each.job.seed - 1_000_000 for each in taken if each.error is None]
    return made, [each for each in taken if each.error is not None], raised


def test_a_run_that_ends_its_workers_fails_and_the_others_are_made() -> None:
    made, failed, raised = made_by(Workers({2: KilledWorker("task"), 5: KilledWorker("task")}), 8)
    assert made == [0, 1, 3, 4, 6, 7]
    assert [each.job.seed for each in failed] == [1_000_002, 1_000_005]
    assert failed[0].reason.startswith("KilledWorker: every worker that made it died; ")
    assert raised == ""


def test_workers_that_die_run_after_run_end_the_campaign() -> None:
    ends: dict[int, BaseException | None] = {k: KilledWorker("task") for k in range(3, 90)}
    made, failed, raised = made_by(Workers(ends), 90)
    assert made == [0, 1, 2]
    assert len(failed) == MOST_DEATHS - 1
    assert raised.startswith("3 runs in a row ended the workers that made them, the last one that ")
    assert "of seed 1000005" in raised


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (None, "the connection to the scheduler is lost"),
        (BrokenProcessPool("terminated abruptly"), "a worker ended before its work: terminated"),
        (ModuleNotFoundError("No module named 'meshpoint'"), "a worker cannot make runs: Module"),
    ],
)
def test_what_was_done_before_the_workers_were_lost_is_handed_over(
    error: BaseException | None, said: str
) -> None:
    made, failed, raised = made_by(Workers({3: error}), 8)
    assert made == [0, 1, 2]
    assert not failed
    assert raised.startswith(said)


def test_ctrl_c_takes_what_was_done_by_then_and_what_failed() -> None:
    taken: list[RunResult] = []

    def take(results: list[RunResult]) -> None:
        taken.extend(results)
        if len(taken) == 1:
            raise KeyboardInterrupt

    workers = Workers({2: KilledWorker("task")})
    assert not run_all(SPEC, SPEC.jobs(4), workers, take)
    assert [each.job for each in taken] == SPEC.jobs(4)
    assert [each.error is None for each in taken] == [True, True, False, True]


def test_a_pool_that_takes_no_more_work_is_lost() -> None:
    class Broken(Workers):
        def submit(self, *_work: Any) -> Future[Any]:  # type: ignore[override]
            raise BrokenExecutor("broken")

    assert made_by(Broken({}), 2)[2] == "no worker takes runs any more: broken"


def test_a_million_runs_are_not_handed_over_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "IN_FLIGHT", 7)
    workers = Workers({})
    assert made_by(workers, 100)[0] == list(range(100))
    assert workers.most_in_flight == 7


def test_a_campaign_whose_workers_are_lost_says_what_is_kept_and_goes_on_from_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def made(_spec: CampaignSpec, jobs: list[Job]) -> list[RunResult]:
        return [whole[job] for job in jobs]

    whole: dict[Job, RunResult] = {}

    def noted(spec: CampaignSpec, jobs: list[Job]) -> list[RunResult]:
        results = run_many(spec, jobs)
        whole.update({result.job: result for result in results})
        return results

    @contextmanager
    def workplace(*_where: Any) -> Iterator[Executor]:
        yield Workers(cast(Any, ends), made)

    for name in ("whole", "a"):
        (tmp_path / name).mkdir()
    with monkeypatch.context() as patch:
        patch.setattr(runner, "run_many", noted)
        wanted = campaign(tmp_path / "whole", *CHEAP, "--jobs", "1")
    monkeypatch.setattr("meshpoint.campaigns.campaign_command.workplace", workplace)
    ends: dict[int, None] = {1: None}
    broken = campaign(tmp_path / "a", *CHEAP, "--dask", "tcp://10.0.0.1:8786")
    assert broken.code == Exit.FAILED
    assert broken.values["interrupted"] is True
    assert broken.values["runs"] == 1
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.startswith("meshpoint campaign: the connection to the scheduler is lost: 1 of 3 ")
    assert said.endswith(f"runs done and kept in {tmp_path / 'a'}; --resume goes on")
    ends.clear()
    resumed = campaign(tmp_path / "a", *CHEAP, "--dask", "tcp://10.0.0.1:8786", "--resume")
    assert resumed.code == Exit.DONE
    assert resumed.text == wanted.text
    assert resumed.table == wanted.table


DEADLY = """
import os

class Deadly:
    aims = False
    fire_slip_rad_s = 3.0

    def __init__(self, sheet, settings):
        pass

    def release(self, predictor, now_us, earliest_us):
        os._exit(1)

    def contact(self, predictor, now_us, earliest_us):
        os._exit(1)
"""


@pytest.mark.long
def test_a_run_that_ends_its_worker_is_named_and_said_to_be_failed(
    cluster: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    deadly = tmp_path / "deadly.py"
    deadly.write_text(DEADLY)
    own = ("--strategy", f"speed_window,{deadly}:Deadly")
    found = campaign(tmp_path, *CHEAP, *own, "--runs", "1", "--dask", cluster)
    assert found.code == Exit.FAILED
    (failed,) = found.values["failed"]
    assert failed["seed"] == 1_000_000
    assert failed["error"].startswith("KilledWorker: every worker that made it died; ")
    assert "run 1000000 failed: KilledWorker" in capsys.readouterr().err
