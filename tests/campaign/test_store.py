"""A campaign's folder: few files while it runs, nothing lost or counted twice, old ones read."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from campaigns import small_spec

from meshpoint.base.errors import CommandError
from meshpoint.campaigns import store as stores
from meshpoint.campaigns.columns import FIELDS, ShiftColumns, Shifts
from meshpoint.campaigns.record import JudgedShift
from meshpoint.campaigns.result import Collected
from meshpoint.campaigns.run import RunResult
from meshpoint.campaigns.spec import Job
from meshpoint.campaigns.store import MERGED, Store
from meshpoint.campaigns.stored import read_shifts, write_shifts
from meshpoint.campaigns.sweep import SweepPoint

SPEC = small_spec(true_state=False, judged=2)
POINT = SweepPoint("backlash_percent", 10.0)


def record(seed: int, shift: int, strategy: str, **changes: Any) -> JudgedShift:
    values: dict[str, Any] = {
        name: None if field.is_optional else field.kind(seed % 7) for name, field in FIELDS.items()
    }
    values |= {"sweep": "", "sweep_value": 0.0, "seed": seed, "shift": shift, "strategy": strategy}
    return JudgedShift(**values | {"contact": "gap" if seed % 3 else None} | changes)


def run_of(job: Job, **changes: Any) -> list[JudgedShift]:
    return [
        record(job.seed, shift, name, sweep=job.point.name, sweep_value=job.point.value, **changes)
        for name in SPEC.names
        for shift in range(SPEC.judged)
    ]


def kept(folder: Path, jobs: list[Job]) -> list[JudgedShift]:
    return Collected(SPEC, jobs, Store(folder, SPEC, resume=True).shifts).records


def parts(folder: Path) -> list[str]:
    return sorted(path.stem for path in (folder / "parts").glob("*.parquet"))


def test_records_come_back_from_columns_and_from_a_file_as_they_were(tmp_path: Path) -> None:
    records = [
        record(2**62 + k, k, "own/file.py:A" if k % 2 else "speed_window", duration_ms=0.1 * k,
               fault="none", reference_known=k % 3 == 0, contact=None if k % 5 else "tooth")
        for k in range(3000)
    ]  # fmt: skip
    assert list(Shifts.of(records)) == records
    write_shifts(tmp_path / "a.parquet", Shifts.of(records))
    again = ShiftColumns()
    read_shifts(tmp_path / "a.parquet", again)
    assert list(again.all()) == records
    assert pq.read_table(tmp_path / "a.parquet").to_pylist() == [r.to_row() for r in records]


def test_many_parts_become_few_and_hold_every_run(tmp_path: Path) -> None:
    jobs = SPEC.jobs(3 * MERGED + 5)
    store = Store(tmp_path, SPEC, resume=False)
    for number, job in enumerate(jobs):
        store.add(run_of(job))
        if number % MERGED == 0:
            assert len(parts(tmp_path)) < MERGED + 3
    assert parts(tmp_path)[:4] == ["000001-000064", "000065-000128", "000129-000192", "000193"]
    assert kept(tmp_path, jobs) == [each for job in jobs for each in run_of(job)]


def test_merged_parts_are_merged_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stores, "MERGED", 3)
    jobs = SPEC.jobs(20)
    for number, job in enumerate(jobs):  # interrupted after every one
        Store(tmp_path, SPEC, resume=number > 0).add(run_of(job))
    assert parts(tmp_path) == ["000001-000009", "000010-000018", "000019", "000020"]
    assert kept(tmp_path, jobs) == [each for job in jobs for each in run_of(job)]


def test_killed_while_it_merged_or_ended_it_counts_no_run_twice(tmp_path: Path) -> None:
    """The merged file stands beside what it was made of, or the whole table beside its parts."""
    jobs = SPEC.jobs(4)
    store = Store(tmp_path, SPEC, resume=False)
    for job in jobs:
        store.add(run_of(job))
    merged = Shifts.of([each for job in jobs[:3] for each in run_of(job)])
    write_shifts(tmp_path / "parts" / "000001-000003.parquet", merged)
    assert kept(tmp_path, jobs) == [each for job in jobs for each in run_of(job)]
    assert parts(tmp_path) == ["000001-000003", "000004"]
    write_shifts(tmp_path / "shifts.parquet", merged)
    assert kept(tmp_path, jobs) == [each for job in jobs for each in run_of(job)]


def test_parts_of_before_with_words_as_text_are_gone_on_with(tmp_path: Path) -> None:
    jobs = SPEC.jobs(2)
    Store(tmp_path, SPEC, resume=False)
    rows = [each.to_row() for each in run_of(jobs[0])]
    kinds = {int: pa.int64(), float: pa.float64(), str: pa.string(), bool: pa.bool_()}
    schema = pa.schema([pa.field(f.name, kinds[f.kind]) for f in FIELDS.values()])
    pq.write_table(pa.Table.from_pylist(rows, schema=schema), tmp_path / "parts" / "000001.parquet")
    store = Store(tmp_path, SPEC, resume=True)
    store.add(run_of(jobs[1]))
    assert kept(tmp_path, jobs) == [each for job in jobs for each in run_of(job)]


@pytest.mark.parametrize("lacks", ["gap_share", "seed"])
def test_a_table_that_lacks_something_is_refused_by_its_name(lacks: str, tmp_path: Path) -> None:
    rows = [each.to_row() for each in run_of(Job(1))]
    table = pa.Table.from_pylist(rows)
    pq.write_table(table.drop_columns([lacks]), tmp_path / "a.parquet")
    with pytest.raises(CommandError, match=f"a.parquet: not a part.*no column {lacks}"):
        read_shifts(tmp_path / "a.parquet", ShiftColumns())
    nothing = pa.Table.from_pylist([row | {lacks: None} for row in rows[:1]], schema=table.schema)
    pq.write_table(nothing, tmp_path / "b.parquet")
    with pytest.raises(CommandError, match=f"b.parquet: not a part.*{lacks}.*with null"):
        read_shifts(tmp_path / "b.parquet", ShiftColumns())


def test_the_table_has_words_once_and_a_sweep_point_a_row_group(tmp_path: Path) -> None:
    """Who asks for one point reads that point alone; the bytes do not say who was ready first."""
    spec = dataclasses.replace(SPEC, sweep=(POINT,))
    jobs = spec.jobs(30)
    results = [RunResult(job, run_of(job)) for job in jobs]
    for name, order in (("a", results), ("b", results[::-1])):
        collected = Collected(spec, jobs)
        for result in order:
            collected.take([result])
        write_shifts(tmp_path / name, collected.shifts)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    file = pq.ParquetFile(tmp_path / "a")
    assert pa.types.is_dictionary(file.schema_arrow.field("strategy").type)
    place = file.schema_arrow.names.index("sweep")
    said = [file.metadata.row_group(k).column(place).statistics for k in range(2)]
    assert file.num_row_groups == 2
    assert [(s.min, s.max) for s in said] == [("", ""), (POINT.name, POINT.name)]
    assert list(collected.at(POINT)) == [each for job in jobs[30:] for each in run_of(job)]


def test_a_table_with_a_damaged_name_of_a_column_is_refused_or_read_as_it_was(
    tmp_path: Path,
) -> None:
    """pyarrow raises KeyError where two lists of names in a file are not alike."""
    write_shifts(tmp_path / "good.parquet", Shifts.of(run_of(Job(1))))
    good = (tmp_path / "good.parquet").read_bytes()
    refused = 0
    for place in (k for k in range(len(good)) if good.startswith(b"main_gear", k)):
        damaged = tmp_path / "damaged.parquet"
        damaged.write_bytes(good[:place] + b"main_geaq" + good[place + 9 :])
        columns = ShiftColumns()
        try:
            read_shifts(damaged, columns)
        except CommandError as error:
            assert "damaged.parquet: not a part of a campaign: " in str(error)
            refused += 1
        else:
            assert list(columns.all()) == run_of(Job(1))
    assert refused
