"""A campaign on disk: parts while it runs, one Parquet table in the end.

campaign.json     what it runs, with a hash: a resumed one must be the same
parts/*.parquet   the runs done so far, written whole or not at all; many small ones become one
shifts.parquet    every judged shift, sorted, once all runs are done
"""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any, Final

from meshpoint.base.errors import CommandError
from meshpoint.campaigns.columns import ShiftColumns, Shifts
from meshpoint.campaigns.record import JudgedShift
from meshpoint.campaigns.spec import CampaignSpec
from meshpoint.campaigns.stored import read_shifts, write_shifts
from meshpoint.gearbox.reading import read_text
from meshpoint.gearbox.tables import TABLE_LIMIT_BYTES
from meshpoint.results.output import folder_for

SHIFTS_FILE: Final = "shifts.parquet"
CAMPAIGN_FILE: Final = "campaign.json"
PARTS: Final = "parts"
MERGED: Final = 64
"""This many small parts become one, and this many of those become one again."""
LEVELS: Final = 2


class Store:
    """The folder of one campaign. CommandError where it cannot be used."""

    def __init__(self, folder: Path, spec: CampaignSpec, resume: bool) -> None:
        self._folder = folder_for(folder)
        self._parts = Parts(folder_for(folder / PARTS))
        self.shifts = ShiftColumns()
        """What was there already."""
        self._begin(spec, resume)

    @property
    def table(self) -> Path:
        """Where the whole table is in the end."""
        return self._folder / SHIFTS_FILE

    @property
    def report(self) -> Path:
        """Where the report goes."""
        return self._folder / "report.html"

    def add(self, records: list[JudgedShift]) -> None:
        """Some whole runs, safe on disk when this returns."""
        if records:
            self._parts.add(Shifts.of(records))

    def finish(self, shifts: Shifts) -> None:
        """All runs, in order; the parts are not needed any more."""
        write_shifts(self.table, shifts)
        shutil.rmtree(self._parts.folder)

    def _begin(self, spec: CampaignSpec, resume: bool) -> None:
        head = self._folder / CAMPAIGN_FILE
        parts = self._parts.begin()
        files = [*self._folder.glob(SHIFTS_FILE), *parts]
        if files and not resume:
            raise CommandError(
                f"{self._folder}: holds a campaign already; --resume goes on with it, another "
                "--out begins anew"
            )
        if files:
            self._check(head, spec)
            for path in files:
                read_shifts(path, self.shifts)
        values = spec.to_json() | {"sha256": spec.sha256}
        head.write_text(json.dumps(values, indent=1, sort_keys=True) + "\n", encoding="utf-8")

    def _check(self, head: Path, spec: CampaignSpec) -> None:
        try:
            before = json.loads(read_text(head, TABLE_LIMIT_BYTES))
        except (ValueError, RecursionError) as error:
            raise CommandError(f"{head}: cannot be read: {error}") from error
        if not isinstance(before, dict):
            raise CommandError(f"{head}: holds no description of a campaign")
        if before.get("sha256") == spec.sha256:
            return
        now = spec.to_json()
        differs = [k for k, v in now.items() if k != "sweep" and before.get(k) != _plain(v)]
        raise CommandError(
            f"{self._folder}: is another campaign, different in {', '.join(differs) or 'version'}; "
            "--resume needs the same arguments, only --runs and --sweep may grow"
        )


class Parts:
    """Tables of some runs each, numbered. A merged one bears the first and the last number of what
    is in it, so one that was left beside what it was merged of is known.

    Each run is on disk when it is done, and a campaign of a million shifts has some two hundred
    files at the most, in which a shift is written three times."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._levels: list[list[tuple[int, int]]] = [[] for _ in range(LEVELS + 1)]
        """First and last number of each file, by how often it was merged."""
        self._last = 0

    def begin(self) -> list[Path]:
        """What is there already, in order; removes what is in a merged one as well."""
        spans = sorted(
            (span for path in self.folder.glob("*.parquet") if (span := _span(path)) is not None),
            key=lambda span: (span[0], -span[1]),
        )
        found = []
        for first, last in spans:
            if last <= self._last:
                self._path(first, last).unlink()
                continue
            self._last = last
            self._keep(first, last)
            found.append(self._path(first, last))
        return found

    def add(self, shifts: Shifts) -> None:
        """One more, safe on disk when this returns."""
        self._last += 1
        write_shifts(self._path(self._last, self._last), shifts)
        self._keep(self._last, self._last)
        for level in range(LEVELS):
            if len(self._levels[level]) >= MERGED:
                self._merge(level)

    def _keep(self, first: int, last: int) -> None:
        size = last - first + 1
        level = sum(size >= MERGED**k for k in range(1, LEVELS + 1))
        self._levels[level].append((first, last))

    def _merge(self, level: int) -> None:
        """Makes one of all files of a level: they are the youngest that there are, or all younger
        ones are of the levels below, so the numbers from first to last are theirs alone."""
        spans, self._levels[level] = self._levels[level], []
        files = [self._path(*span) for span in spans]
        merged = ShiftColumns()
        for path in files:
            read_shifts(path, merged)
        first, last = spans[0][0], spans[-1][1]
        write_shifts(self._path(first, last), merged.all())
        for path in files:
            path.unlink()
        self._keep(first, last)

    def _path(self, first: int, last: int) -> Path:
        name = f"{first:06d}" if first == last else f"{first:06d}-{last:06d}"
        return self.folder / f"{name}.parquet"


def _span(path: Path) -> tuple[int, int] | None:
    found = re.fullmatch(r"(\d+)(?:-(\d+))?", path.stem)
    return None if found is None else (int(found[1]), int(found[2] or found[1]))


def _plain(value: Any) -> Any:
    return json.loads(json.dumps(value))
