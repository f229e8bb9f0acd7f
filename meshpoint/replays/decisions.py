"""`meshpoint compare A.toml B.toml --log LOG`: what two settings decide in each shift of a log."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

from meshpoint.base.errors import CommandError
from meshpoint.bus.logs.files import log_files
from meshpoint.cli.interrupt import interruptible
from meshpoint.controller.settings.header import RunHeader
from meshpoint.controller.settings.settings import load_settings
from meshpoint.dbc.frame import Frame
from meshpoint.logs.log_progress import logged_frames
from meshpoint.logs.logged_frames import LoggedFrames
from meshpoint.replays.chosen import Chosen, other_header, recorded_header
from meshpoint.replays.replay import LogReplay
from meshpoint.replays.session import Session, Verification
from meshpoint.replays.two_controllers import JudgedTwice, TwoControllers
from meshpoint.report.judged import Parting
from meshpoint.results.difference import Allowed, Difference, differences

COLUMNS: Final = (
    "shift",
    "gears",
    "differs, ms",
    "in",
    "A fires, ms",
    "B fires, ms",
    "fields that differ",
)


class Decided(NamedTuple):
    """Every shift as both decide it, what differs, and how far the log went."""

    shifts: list[JudgedTwice]
    differences: list[list[Difference]]
    """Of each shift."""
    unfinished: int
    incomplete: str
    """Why not all of the log could be used; empty: it was."""

    @property
    def differing(self) -> int:
        """Shifts in which a field differs or the controllers part."""
        return sum(
            bool(found) or shift.parting is not None
            for shift, found in zip(self.shifts, self.differences, strict=True)
        )


def decide(a: Path, b: Path, log: Path, header_dir: Path | None, allowed: Allowed) -> Decided:
    """Both settings on one log. CommandError where no run of it can be repeated."""
    for path in (a, b):
        load_settings(path)
    files = log_files([log])
    two = TwoControllers(_change(a), _change(b), allowed)
    replay = LogReplay(
        header_dir or files[0].parent,
        verify=False,
        change=lambda header: recorded_header(header, None, verify=False),
        onlooker=two,
    )
    with interruptible() as stop, logged_frames(files, None, stop) as read:
        sessions = replay.run(_frames(read))
    if not any(session.steps for session in sessions):
        raise CommandError(f"{log}: {sessions[0]}")
    found = [
        list(differences(one.to_json(), other.to_json(), allowed, f"shifts.{k}"))
        for k, (one, other) in enumerate(shift.judged for shift in two.shifts)
    ]
    return Decided(two.shifts, found, two.unfinished, _incomplete(read, sessions))


def _change(path: Path) -> Callable[[RunHeader], RunHeader]:
    return lambda header: other_header(header, Chosen(settings=path))


def _frames(read: LoggedFrames) -> Iterator[Frame]:
    for _, frame in read:
        yield frame


def _incomplete(read: LoggedFrames, sessions: list[Session]) -> str:
    if read.interrupted:
        return f"interrupted after {read.frames} frames of the log"
    if read.defect is not None:
        return f"the log cannot be read on: {read.defect}"
    broken = [str(s) for s in sessions if s.verdict is Verification.NOT_VERIFIABLE]
    return "; ".join(broken)


def decided_rows(decided: Decided) -> list[tuple[str, ...]]:
    """A row for each shift, in the order of COLUMNS."""
    rows = []
    for k, (shift, found) in enumerate(zip(decided.shifts, decided.differences, strict=True)):
        a, b = shift.judged
        parting = shift.parting
        fires = (one.status if one.fired_ms is None else f"{one.fired_ms:.1f}" for one in (a, b))
        fields = ", ".join(one.path.removeprefix(f"shifts.{k}.") for one in found)
        at = ("-", "-") if parting is None else (_ms(parting), ", ".join(parting.differ))
        rows.append((str(k + 1), f"{a.from_} to {a.to}", *at, *fires, fields or "-"))
    return rows


def knew_heading(number: int, parting: Parting[Any]) -> str:
    """Over what each knew in the step in which they first differ; number: of the shift, from 1."""
    return (
        f"Shift {number} differs {_ms(parting)} ms after the request, in "
        f"{', '.join(parting.differ)}. What each knew there"
    )


def decided_json(decided: Decided) -> dict[str, Any]:
    """By name, as `compare --json` has it."""
    return {
        "shifts": [
            {
                "a": shift.judged[0].to_json(),
                "b": shift.judged[1].to_json(),
                "parting": None
                if shift.parting is None
                else {
                    "at_ms": shift.parting.at_ms,
                    "messages": list(shift.parting.differ),
                    "a": shift.parting.knew[0],
                    "b": shift.parting.knew[1],
                },
                "differences": [one.path.split(".", 2)[2] for one in found],
            }
            for shift, found in zip(decided.shifts, decided.differences, strict=True)
        ],
        "unfinished_shifts": decided.unfinished,
        "incomplete": decided.incomplete,
    }


def _ms(parting: Parting[Any]) -> str:
    return f"{parting.at_ms:.1f}"
