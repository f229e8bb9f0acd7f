"""What `--json` has of a replay."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from meshpoint.logs.logged_frames import LoggedFrames
from meshpoint.replays.replay_rows import ReplayRows
from meshpoint.replays.session import Session
from meshpoint.report.judged_rows import commanded


def replay_values(
    namespace: argparse.Namespace,
    files: list[Path],
    sessions: list[Session],
    rows: ReplayRows,
    events: list[tuple[int, str]],
    log: LoggedFrames,
) -> dict[str, Any]:
    """The replay as plain values."""
    judged = rows.judged if rows.open_loop else None
    shifts = (
        [row.to_json() for row in rows.rows]
        if judged is None
        else [row.to_json(rows.asked) for row in judged]
    )
    values: dict[str, Any] = {
        "log": str(namespace.log[0]),
        "logs": [str(path) for path in files],
        "mode": "as recorded" if judged is None else "open loop",
        "gearbox": None if rows.header is None else rows.header.sheet.name,
        "sessions": [_session_json(session) for session in sessions],
        "account": log.account.to_json(),
        "log_clock": log.clock.to_json(),
        "interrupted": log.interrupted,
        "shifts": shifts,
        "events": [{"time_us": time_us, "event": line} for time_us, line in events],
    }
    if rows.open_loop is not None:
        values["commanded"] = [commanded(row) for row in shifts]
        values["unfinished_shifts"] = rows.open_loop.unfinished
    return values


def _session_json(session: Session) -> dict[str, Any]:
    return {
        "verdict": session.verdict.value,
        "step": session.step,
        "reason": session.reason,
        "steps": session.steps,
        "frames": session.frames,
        "holes": [hole._asdict() for hole in session.holes],
        "run_hash": f"{session.run_hash:016x}",
        "intruders": {f"{can_id:08X}": n for can_id, n in sorted(session.intruders.items())},
    }
