"""The report of a demo: both strategies in one page, read back from their logs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from meshpoint.bench.live import LiveResult, LiveRun, unpacker
from meshpoint.bus.logs.reader import LogError, read_log
from meshpoint.dbc.frame import Frame
from meshpoint.replays.session import Session
from meshpoint.report.beliefs import Beliefs
from meshpoint.report.run import Report, ReportRun
from meshpoint.report.write import (
    estimator_notes,
    gather,
    report_provenance,
    write_report,
)
from meshpoint.rig_sim.settings import RigSettings


def write_demo_report(
    path: Path,
    lives: dict[str, LiveRun],
    results: dict[str, LiveResult],
    sessions: dict[str, Session],
    beliefs: dict[str, Beliefs],
) -> None:
    """Writes the page; all by strategy. CommandError where it cannot be written."""
    runs, hashes = [], {}
    for name, live in lives.items():
        notes = [f"{name}: replay of the log is {sessions[name]}"]
        notes += estimator_notes(name, results[name].monitor.scores())
        runs.append(demo_run(live, name, notes, beliefs[name]))
        hashes[f"run header, {name}"] = f"{live.header.run_hash:016x}"
    first = next(iter(lives.values()))
    rig: RigSettings = first.rig
    report = Report(
        title="meshpoint demo: the speed window (today) and phase control",
        subtitle="Controller and rig on a CAN bus; the gearbox is simulated, preset "
        f"{rig.preset}, {first.gearbox_words}.",
        sheet=first.header.sheet,
        runs=runs,
        provenance=report_provenance(
            first.header.sheet, seed=rig.seed, preset=rig.preset, profile=rig.profile, **hashes
        ),
    )
    write_report(path, report)


def demo_run(
    live: LiveRun,
    name: str = "",
    notes: list[str] | None = None,
    beliefs: Beliefs | None = None,
) -> ReportRun:
    """The shifts of a finished run, read back from its log."""
    return gather(name, _frames(live), live.header, notes or [], beliefs)


def _frames(live: LiveRun) -> Iterator[Frame]:
    """Our own log as far as it can be read; its verification names a defect."""
    unpack = unpacker(live)
    with suppress(LogError):
        for _, frame in read_log(live.log):
            yield from unpack(frame)
