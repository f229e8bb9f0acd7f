"""A campaign on disk: parts while it runs, one Parquet table in the end.

campaign.json     what it runs, with a hash: a resumed one must be the same
parts/*.parquet   the runs done so far, written whole or not at all
shifts.parquet    every judged shift, sorted, once all runs are done
"""

from __future__ import annotations

import dataclasses
import json
import shutil
import types
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, get_args, get_type_hints

from meshpoint.gearbox.reading import read_text
from meshpoint.gearbox.tables import TABLE_LIMIT_BYTES
from meshpoint.testbench.campaign.record import JudgedShift
from meshpoint.testbench.campaign.spec import CampaignSpec, Job
from meshpoint.testbench.campaign.sweep import SweepPoint
from meshpoint.testbench.errors import CommandError
from meshpoint.testbench.results.output import folder_for

if TYPE_CHECKING:
    import pyarrow as pa

SHIFTS_FILE: Final = "shifts.parquet"
CAMPAIGN_FILE: Final = "campaign.json"
PARTS: Final = "parts"
FIELDS: Final = tuple(field.name for field in dataclasses.fields(JudgedShift))


class Store:
    """The folder of one campaign. CommandError where it cannot be used."""

    def __init__(self, folder: Path, spec: CampaignSpec, resume: bool) -> None:
        self._folder = folder_for(folder)
        self._parts = folder_for(folder / PARTS)
        self._count = 0
        self.records: list[JudgedShift] = []
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

    def done(self) -> set[Job]:
        """The runs that need not be made again."""
        return {Job(r.seed, SweepPoint(r.sweep, r.sweep_value)) for r in self.records}

    def add(self, records: list[JudgedShift]) -> None:
        """Some whole runs, safe on disk when this returns."""
        if records:
            self._count += 1
            _write(self._parts / f"{self._count:06d}.parquet", records)

    def finish(self, records: list[JudgedShift]) -> None:
        """All runs, in order; the parts are not needed any more."""
        _write(self.table, records)
        shutil.rmtree(self._parts)

    def _begin(self, spec: CampaignSpec, resume: bool) -> None:
        head = self._folder / CAMPAIGN_FILE
        files = [*sorted(self._parts.glob("*.parquet")), *self._folder.glob(SHIFTS_FILE)]
        if files and not resume:
            raise CommandError(
                f"{self._folder}: holds a campaign already; --resume goes on with it, another "
                "--out begins anew"
            )
        if files:
            self._check(head, spec)
            self.records = [record for path in files for record in read_records(path)]
            self._count = max((int(p.stem) for p in self._parts.glob("*.parquet")), default=0)
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


def _plain(value: Any) -> Any:
    return json.loads(json.dumps(value))


def _schema() -> pa.Schema:
    import pyarrow as pa

    kinds = {int: pa.int64(), float: pa.float64(), str: pa.string(), bool: pa.bool_()}
    hints = get_type_hints(JudgedShift)
    fields = []
    for name in FIELDS:
        hint = hints[name]
        is_optional = isinstance(hint, types.UnionType)
        kind = get_args(hint)[0] if is_optional else hint
        fields.append(pa.field(name, kinds[kind], nullable=is_optional))
    return pa.schema(fields)


def _write(path: Path, records: list[JudgedShift]) -> None:
    """Written beside, then renamed: a file with this name is whole."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    # by columns: rows of names and values take several times the records' own memory
    schema = _schema()
    columns = [
        pa.array([getattr(record, field.name) for record in records], field.type)
        for field in schema
    ]
    beside = path.with_suffix(".writing")
    try:
        pq.write_table(pa.table(columns, schema=schema), beside)
        beside.replace(path)
    except OSError as error:
        raise CommandError(f"{path}: cannot be written: {error.strerror or error}") from error


def read_records(path: Path) -> list[JudgedShift]:
    """A table of judged shifts. CommandError where it is none."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        rows = pq.read_table(path, schema=_schema()).to_pylist()
    except (OSError, pa.ArrowException) as error:
        raise CommandError(f"{path}: not a part of a campaign: {error}") from error
    return [JudgedShift(**row) for row in rows]


def read_columns(path: Path, names: tuple[str, ...]) -> list[list[Any]]:
    """Some columns of a table of judged shifts, which may be of another version of the product.
    CommandError where it lacks one."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path, columns=list(names))
        return [table.column(name).to_pylist() for name in names]
    except (OSError, KeyError, pa.ArrowException) as error:
        raise CommandError(f"{path}: not a table of a campaign: {error}") from error
