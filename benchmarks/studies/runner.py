"""Runs studies on all processors; the results do not depend on how many there are."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from benchmarks.studies.draw import write_files
from benchmarks.studies.record import Finding, Given, Study, StudyJob, figures
from benchmarks.studies.registry import load
from benchmarks.studies.settings import StudySettings, si_values
from meshpoint.bus.light_can import load_can

Progress = Callable[[str, int, int], None]
"""What is done, how many parts are done, how many there are."""


@dataclass(frozen=True)
class StudyRecord:
    """A study's finding and the files it was written to, relative to the folder of all."""

    study: str
    title: str
    of: tuple[str, ...]
    finding: Finding
    files: tuple[str, ...]
    settings: dict[str, Any]

    @property
    def gearbox(self) -> tuple[str, str]:
        """Data sheet and profile: the study's own, else those of all studies."""
        values = {**self.settings["common"], **self.settings}
        return values["gearbox"], values["profile"]

    def to_json(self, provenance: dict[str, Any]) -> dict[str, Any]:
        """As `--json` has it."""
        statements = self.finding.statements
        return {
            "title": self.title,
            "of": list(self.of),
            "thesis": _joined(each.thesis for each in statements),
            "ours": figures(self.finding.figures),
            "agrees": self.finding.verdict.value,
            "reason": _joined(each.reason for each in statements),
            "statements": [
                {
                    "thesis": each.thesis,
                    "ours": each.ours,
                    "agrees": each.verdict.value,
                    "reason": each.reason,
                }
                for each in statements
            ],
            "files": list(self.files),
            "settings": figures(self.settings),
            "provenance": provenance,
        }


def _joined(texts: Iterable[str]) -> str:
    """Each once."""
    return "; ".join(dict.fromkeys(texts))


@dataclass(frozen=True)
class _Conclude:
    """The end of a study in a process of its own: conclude, draw, write."""

    name: str
    given: Given[Any]
    folder: Path

    def run(self) -> StudyRecord:
        """The record, its files written."""
        study = load(self.name)
        finding = study.conclude(self.given)
        files = tuple(
            f"{self.name}/{file}" for file in write_files(finding, self.folder / self.name)
        )
        return StudyRecord(study.name, study.title, study.of, finding, files, si_values(self.given))


def run_studies(
    studies: list[Study[Any]],
    settings: StudySettings,
    folder: Path,
    workers: int,
    progress: Progress = lambda _name, _done, _total: None,
) -> list[StudyRecord]:
    """All studies, in their order. With one worker everything runs in this process."""
    given = {study.name: settings.given(study) for study in studies}
    jobs = {study.name: study.jobs(given[study.name]) for study in studies}
    schedule = _Schedule(studies, given, jobs, folder, progress)
    if workers == 1:
        return schedule.alone()
    return schedule.together(workers)


class _Schedule:
    """Jobs first, each once; a study concludes when its jobs are done."""

    def __init__(
        self,
        studies: list[Study[Any]],
        given: dict[str, Given[Any]],
        jobs: dict[str, tuple[StudyJob, ...]],
        folder: Path,
        progress: Progress,
    ) -> None:
        self._studies = studies
        self._given = given
        self._jobs = jobs
        self._folder = folder
        self._progress = progress
        self._unique: list[StudyJob] = list(
            dict.fromkeys(job for own in jobs.values() for job in own)
        )
        self._results: dict[StudyJob, Any] = {}
        self._total = len(self._unique) + len(studies)
        self._done = 0

    def alone(self) -> list[StudyRecord]:
        """Without further processes."""
        for job in self._unique:
            self._results[job] = job.run()
            self._count(type(job).__name__)
        records = []
        for study in self._studies:
            records.append(self._conclusion(study.name).run())
            self._count(study.name)
        return records

    def together(self, workers: int) -> list[StudyRecord]:
        """On several processes, started afresh so that they are alike on every platform."""
        context = multiprocessing.get_context("spawn")
        records: dict[str, StudyRecord] = {}
        with ProcessPoolExecutor(workers, mp_context=context, initializer=load_can) as pool:
            try:
                self._run(pool, records)
            except BaseException:
                pool.shutdown(wait=True, cancel_futures=True)
                raise
        return [records[study.name] for study in self._studies]

    def _run(self, pool: ProcessPoolExecutor, records: dict[str, StudyRecord]) -> None:
        pending: dict[Future[Any], StudyJob | str] = {
            pool.submit(job.run): job for job in self._unique
        }
        waiting = [study.name for study in self._studies]
        while pending or waiting:
            for name in [name for name in waiting if self._ready(self._jobs[name])]:
                waiting.remove(name)
                pending[pool.submit(self._conclusion(name).run)] = name
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                ended = pending.pop(future)
                if isinstance(ended, str):
                    records[ended] = future.result()
                    self._count(ended)
                else:
                    self._results[ended] = future.result()
                    self._count(type(ended).__name__)

    def _ready(self, jobs: Iterable[StudyJob]) -> bool:
        return all(job in self._results for job in jobs)

    def _conclusion(self, name: str) -> _Conclude:
        results = {job: self._results[job] for job in self._jobs[name]}
        return _Conclude(name, replace(self._given[name], results=results), self._folder)

    def _count(self, name: str) -> None:
        self._done += 1
        self._progress(name, self._done, self._total)


__all__ = ["StudyRecord", "run_studies"]
