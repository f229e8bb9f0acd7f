"""The page of a replay."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from meshpoint.logs.log_progress import log_name
from meshpoint.replays.replay_rows import ReplayRows
from meshpoint.replays.session import Session
from meshpoint.report.judged_rows import judged_words
from meshpoint.report.run import Report, ReportRun
from meshpoint.report.write import report_provenance, write_report


def write_replay_page(
    namespace: argparse.Namespace,
    out: Any,
    files: list[Path],
    sessions: list[Session],
    rows: ReplayRows,
    interrupted: bool,
) -> None:
    """The page; without a run header there is no data sheet to draw anything by."""
    header = rows.header
    if header is None or rows.report is None:
        out.print("no report: no run of this log could be repeated")
        return
    name, shifts = header.settings.strategy_name, rows.report.finish()
    notes = [f"run {n} of {len(sessions)}: {session}" for n, session in enumerate(sessions, 1)]
    if not namespace.verify:
        notes = []
    if interrupted:
        notes.append("Interrupted: what came later in the log is not in here.")
    subtitle = (
        "A recorded bus through the same controller, as recorded; sensors, valves and truth are "
        "those of the log."
    )
    if rows.open_loop is not None:
        judged = rows.judged
        shifts = [replace(s, replayed=j.judged) for s, j in zip(shifts, judged, strict=True)]
        subtitle = (
            f"A recorded bus, and what {rows.asked} decides on the same frames: each shift "
            "judged from the state in which it was begun. Outcomes are the log's; the other "
            "strategy has none."
        )
        notes.append(judged_words(judged, rows.asked))
    report = Report(
        title=f"meshpoint replay: {log_name(files)}",
        subtitle=subtitle,
        sheet=header.sheet,
        runs=[ReportRun(name, shifts, notes)],
        asked=rows.asked if rows.open_loop else None,
        provenance=report_provenance(
            header.sheet,
            seed=None,
            preset=None,
            profile=None,
            **{
                "log": ", ".join(path.name for path in files),
                "recorded with version": header.version,
                "run headers": ", ".join(f"{session.run_hash:016x}" for session in sessions),
            },
        ),
    )
    write_report(namespace.report, report)
