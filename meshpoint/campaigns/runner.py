"""All runs of a campaign over an executor: this process, processes here, or a Dask cluster.

The result does not depend on which: a run depends on its spec and its job alone, and results are
put in order of their jobs.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from contextlib import contextmanager
from queue import SimpleQueue
from typing import Any, Final

from meshpoint.base.errors import CommandError, RunError
from meshpoint.campaigns.run import RunResult, run_many
from meshpoint.campaigns.spec import CampaignSpec, Job
from meshpoint.campaigns.workers import worker_pool
from meshpoint.results.output import complain

IN_FLIGHT: Final = 1024
"""Runs handed over and not yet done: enough for as many workers, and little memory."""
KILLED: Final = "KilledWorker"
"""Dask's error for work during which one worker after the other died: four, by its defaults. Known
by its name, as Dask is an extra."""
DIED: Final = "every worker that made it died; the workers' logs say why, often memory"
MOST_DEATHS: Final = 3
DASK_EXTRA: Final = "--dask needs the extra: pip install 'meshpoint[dask]'"


class WorkersLostError(RunError):
    """Nobody is left to make runs; those that came to their end are kept."""


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
    may_begin: Callable[[], bool] = lambda: True,
    in_flight: int | None = None,
) -> bool:
    """Makes all runs, handing over results as they come; False where it was interrupted.

    `take` gets every result exactly once, in any order. A run whose workers die, one after the
    other, fails alone. WorkersLostError where there is nobody left to make runs. Once there is a
    run that `may_begin` no more, none is begun; all that are begun come to their end, so that those
    made are the first ones. `in_flight`: most handed over at a time (None: `IN_FLIGHT`)."""
    if where is None:
        return _one_by_one(spec, jobs, take, may_begin)
    work = _Work(spec, jobs, where, take, may_begin, in_flight or IN_FLIGHT)
    try:
        work.run()
    except KeyboardInterrupt:
        at_work = work.cancel()
        complain(f"interrupted: ending the runs in work first, {len(at_work)} of them")
        for future, job in at_work.items():
            take(work.result(future, job))
        return False
    except WorkersLostError:
        work.cancel()
        raise
    return True


class _Work:
    """Runs handed to an executor, this many at a time: a future takes kilobytes."""

    def __init__(
        self,
        spec: CampaignSpec,
        jobs: list[Job],
        where: Executor,
        take: Callable[[list[RunResult]], None],
        may_begin: Callable[[], bool],
        in_flight: int,
    ) -> None:
        self._spec, self._waiting, self._where, self._take = spec, iter(jobs), where, take
        self._may_begin, self._in_flight = may_begin, in_flight
        self._left: dict[Future[list[RunResult]], Job] = {}
        self._done: SimpleQueue[Future[list[RunResult]]] = SimpleQueue()
        self._deaths = 0
        """Runs in a row whose workers died."""

    def run(self) -> None:
        """Every run to its result."""
        self._hand_over()
        while self._left:
            future = self._done.get()
            job = self._left.pop(future)
            self._take(self.result(future, job))
            self._hand_over()

    def cancel(self) -> dict[Future[list[RunResult]], Job]:
        """What is not begun is not made; the runs in work, or made and not yet taken."""
        left = {future: job for future, job in self._left.items() if not future.cancel()}
        self._left.clear()
        return left

    def _hand_over(self) -> None:
        for job in itertools.islice(self._waiting, self._in_flight - len(self._left)):
            if not self._may_begin():
                self._waiting = iter(())
                return
            # One at a time: it takes seconds, which is what Ctrl-C waits for.
            try:
                future = self._where.submit(run_many, self._spec, [job])
            except (BrokenExecutor, RuntimeError) as error:  # the latter: a client that is closed
                raise WorkersLostError(f"no worker takes runs any more: {error}") from error
            self._left[future] = job
            future.add_done_callback(self._done.put)

    def result(self, future: Future[list[RunResult]], job: Job) -> list[RunResult]:
        """What came of a run, waited for. WorkersLostError where nobody can say."""
        try:
            results = future.result()
        except CancelledError as error:  # not by us: those are not asked any more
            raise WorkersLostError("the connection to the scheduler is lost") from error
        except BrokenExecutor as error:
            raise WorkersLostError(f"a worker ended before its work: {error}") from error
        except Exception as error:  # what a run raises is in its result: this is of the workers
            if type(error).__name__ != KILLED:
                raise WorkersLostError(
                    f"a worker cannot make runs: {type(error).__name__}: {error}"
                ) from error
            self._deaths += 1
            if self._deaths == MOST_DEATHS:
                raise WorkersLostError(
                    f"{MOST_DEATHS} runs in a row ended the workers that made them, the last one "
                    f"that of seed {job.seed}: the workers' logs say why, often memory"
                ) from error
            return [RunResult(job, error=f"{KILLED}: {DIED}")]
        self._deaths = 0
        return results


def _one_by_one(
    spec: CampaignSpec,
    jobs: list[Job],
    take: Callable[[list[RunResult]], None],
    may_begin: Callable[[], bool],
) -> bool:
    try:
        for job in jobs:
            if not may_begin():
                break
            take(run_many(spec, [job]))
    except KeyboardInterrupt:
        return False
    return True
