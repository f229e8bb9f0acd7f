"""All runs of a campaign over an executor: this process, processes here, or a Dask cluster.

The result does not depend on which: a run depends on its spec and its job alone, and results are
put in order of their jobs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, as_completed
from contextlib import contextmanager
from typing import Any, Final

from meshpoint.testbench.campaign.run import RunResult, run_many
from meshpoint.testbench.campaign.spec import CampaignSpec, Job
from meshpoint.testbench.campaign.workers import worker_pool
from meshpoint.testbench.errors import CommandError
from meshpoint.testbench.results.output import complain

DASK_EXTRA: Final = "--dask needs the extra: pip install 'meshpoint[dask]'"


@contextmanager
def executor(workers: int, dask: str | None) -> Iterator[Executor]:
    """Where the runs are made."""
    if dask is not None:
        with _dask(dask) as over_dask:
            yield over_dask
    else:
        with worker_pool(workers) as pool:
            yield pool


@contextmanager
def _dask(address: str) -> Iterator[Executor]:
    try:
        from dask.distributed import Client
    except ImportError as error:
        raise CommandError(DASK_EXTRA) from error
    try:
        connect: Any = Client
        client = connect(address, timeout=10)
    except (OSError, ValueError) as error:
        raise CommandError(f"--dask {address}: cannot be reached: {error}") from error
    with client, client.get_executor(pure=False) as over_dask:
        yield over_dask


@contextmanager
def workplace(workers: int, dask: str | None) -> Iterator[Executor | None]:
    """Where runs are made, for as long as this lasts; None: here, as one worker needs no second
    process."""
    if workers == 1 and dask is None:
        yield None
    else:
        with executor(workers, dask) as where:
            yield where


def run_all(
    spec: CampaignSpec,
    jobs: list[Job],
    where: Executor | None,
    take: Callable[[list[RunResult]], None],
) -> bool:
    """Makes all runs, handing over results as they come; False where it was interrupted.

    `take` gets every result exactly once, in any order."""
    if where is None:
        return _one_by_one(spec, jobs, take)
    # One at a time: it takes seconds, which is what Ctrl-C waits for.
    futures = [where.submit(run_many, spec, [job]) for job in jobs]
    left = set(futures)
    try:
        for future in as_completed(futures):
            left.discard(future)
            take(future.result())
    except KeyboardInterrupt:
        for future in left:
            future.cancel()
        at_work = sum(future.running() for future in left)
        complain(f"interrupted: ending the runs in work first, {at_work} of them")
        _take_what_runs(left, take)
        return False
    except BrokenExecutor as error:
        raise CommandError(f"a worker ended before its work: {error}") from error
    return True


def _one_by_one(
    spec: CampaignSpec, jobs: list[Job], take: Callable[[list[RunResult]], None]
) -> bool:
    try:
        for job in jobs:
            take(run_many(spec, [job]))
    except KeyboardInterrupt:
        return False
    return True


def _take_what_runs(
    futures: set[Future[list[RunResult]]], take: Callable[[list[RunResult]], None]
) -> None:
    """What workers were at when it was interrupted comes to its end and is kept."""
    for future in futures:
        if not future.cancelled():
            take(future.result())
