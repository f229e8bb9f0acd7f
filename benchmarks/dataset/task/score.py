"""Scores predictions of the phase at contact. Needs numpy and pyarrow alone.

    python score.py PREDICTIONS SET/truth/contacts.parquet [--split test] [--json]

PREDICTIONS is a CSV or Parquet file with a row for each shift: `shift`, the name; `phase_deg` or
`phase_rad`, the phase expected at contact; `sd_deg` or `sd_rad`, its standard deviation, which may
be left out or be empty. An error is predicted less true, within half a pitch either way: a phase is
the same a pitch further on. Printed are, over all shifts and for each kind and strategy:

    shifts          how many
    rms_deg         root of the mean square error, in degrees
    mean_deg        mean error, in degrees
    in_half_gap     share of errors of at most half a gap: a sleeve fired by it would meet the gap
    in_1_sd, in_2_sd  share of errors within one and two of the standard deviations given (0.683 and
                    0.954 where these are right and the errors normal); empty where none is given

Exit codes: 0 scored; 1 scored, and rms_deg over all shifts exceeds --most-rms; 2 a file or an
argument is wrong, and nothing was scored.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq

SCORED, OVER, WRONG = 0, 1, 2
UNITS = {"deg": 1.0, "rad": 180.0 / math.pi}
"""Degrees in each unit."""
PHASES = tuple(f"phase_{unit}" for unit in UNITS)
SDS = tuple(f"sd_{unit}" for unit in UNITS)
COLUMNS = ("shift", *PHASES, *SDS)
TRUTH = ("shift", "kind", "split", "strategy", "phase_deg", "pitch_deg", "half_gap_deg")
SPLITS = ("test", "train", "all")
NAMED = 3
"""Shifts that an error names at most."""


class InputError(ValueError):
    """A file that cannot be scored: the message names file, key, what was found and allowed."""


def read_table(path: Path) -> pa.Table:
    """A CSV or Parquet file, by its ending."""
    if path.suffix not in (".csv", ".parquet"):
        raise InputError(f"{path}: ends in {path.suffix!r}, allowed are .csv and .parquet")
    try:
        if path.suffix == ".parquet":
            return pq.read_table(path)
        as_text = pc.ConvertOptions(column_types={"shift": pa.string()})
        return pc.read_csv(path, convert_options=as_text)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    except pa.ArrowException as error:
        raise InputError(f"{path}: no {path.suffix[1:]} file: {error}") from error


def read_truth(path: Path, split: str) -> tuple[list[dict[str, Any]], set[str]]:
    """The contacts of a split, and the names of all shifts."""
    table = read_table(path)
    for name in TRUTH:
        if name not in table.column_names:
            raise InputError(f"{path}: no column {name!r}; this is not truth/contacts.parquet")
    rows = table.select(TRUTH).to_pylist()
    chosen = [row for row in rows if split in ("all", row["split"])]
    if not chosen:
        raise InputError(f"{path}: split: no shift of {split!r}")
    return chosen, {row["shift"] for row in rows}


def one_of(path: Path, found: Sequence[str], names: Sequence[str], *, needed: bool) -> str | None:
    """The one column of these that a file has."""
    mine = [name for name in names if name in found]
    if len(mine) > 1:
        raise InputError(f"{path}: columns {' and '.join(mine)}, allowed is one of them")
    if needed and not mine:
        listed = ", ".join(found) or "none"
        raise InputError(f"{path}: no column {' or '.join(names)}; found are {listed}")
    return mine[0] if mine else None


def numbers(path: Path, table: pa.Table, name: str, *, may_lack: bool) -> np.ndarray:
    """A column in degrees; NaN where a value is left out."""
    column = table[name]
    if pa.types.is_null(column.type) and may_lack:
        return np.full(table.num_rows, np.nan)
    if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
        raise InputError(f"{path}: {name}: holds {column.type}, allowed are numbers")
    is_missing = column.is_null().to_numpy()
    values = column.cast(pa.float64()).fill_null(math.nan).to_numpy() * UNITS[name[-3:]]
    is_bad = ~np.isfinite(values) & ~(is_missing & may_lack)
    is_bad |= (values <= 0.0) if may_lack else False
    if is_bad.any():
        row = int(np.flatnonzero(is_bad)[0])
        allowed = "a number above 0, or nothing" if may_lack else "a finite number"
        shift = table["shift"][row].as_py()
        found = table[name][row].as_py()
        what = "no number" if found is None else found
        raise InputError(f"{path}: {name} of shift {shift!r}: {what}, allowed is {allowed}")
    return np.asarray(values)


def named(shifts: Sequence[str]) -> str:
    """Some shifts by name."""
    more = f" and {len(shifts) - NAMED} more" if len(shifts) > NAMED else ""
    return ", ".join(map(repr, shifts[:NAMED])) + more


def read_predictions(path: Path) -> dict[str, tuple[float, float]]:
    """Phase and standard deviation (deg; NaN: none) of each shift."""
    table = read_table(path)
    found = table.column_names
    one_of(path, found, ("shift",), needed=True)
    phase = one_of(path, found, PHASES, needed=True)
    sd = one_of(path, found, SDS, needed=False)
    if unknown := [name for name in found if name not in COLUMNS]:
        raise InputError(f"{path}: column {unknown[0]!r}, allowed are {', '.join(COLUMNS)}")
    shifts = [str(shift) for shift in table["shift"].to_pylist()]
    if twice := sorted({shift for shift in shifts if shifts.count(shift) > 1}):
        raise InputError(f"{path}: shift: {named(twice)} more than once, allowed is one row each")
    phases = numbers(path, table, str(phase), may_lack=False)
    none = np.full(len(shifts), np.nan)
    sds = none if sd is None else numbers(path, table, sd, may_lack=True)
    return dict(zip(shifts, zip(phases.tolist(), sds.tolist(), strict=True), strict=True))


def figures(
    rows: Sequence[dict[str, Any]], predicted: dict[str, tuple[float, float]]
) -> dict[str, Any]:
    """The score over these shifts."""
    said = np.array([predicted[row["shift"]] for row in rows])
    true, pitch, half = np.array(
        [(row["phase_deg"], row["pitch_deg"], row["half_gap_deg"]) for row in rows]
    ).T
    error = said[:, 0] - true
    error -= pitch * np.floor(error / pitch + 0.5)
    sd = said[:, 1]
    has_sd = ~np.isnan(sd)
    within = np.abs(error[has_sd]) / sd[has_sd]
    return {
        "shifts": len(rows),
        "rms_deg": round(float(np.sqrt(np.mean(error**2))), 4),
        "mean_deg": round(float(np.mean(error)), 4),
        "in_half_gap": round(float(np.mean(np.abs(error) <= half)), 4),
        **{
            f"in_{times}_sd": round(float(np.mean(within <= times)), 4) if has_sd.any() else None
            for times in (1, 2)
        },
    }


def score(predictions: Path, truth: Path, split: str) -> dict[str, dict[str, Any]]:
    """Figures over all shifts of the split, and by kind and strategy. InputError: a bad file."""
    rows, all_shifts = read_truth(truth, split)
    predicted = read_predictions(predictions)
    if unknown := sorted(predicted.keys() - all_shifts):
        raise InputError(f"{predictions}: shift: {named(unknown)}, allowed are those of {truth}")
    if missing := sorted({row["shift"] for row in rows} - predicted.keys()):
        of = f"{len(missing)} of the {len(rows)} shifts of the split {split!r} are missing"
        raise InputError(f"{predictions}: shift: {of}: {named(missing)}; all have to be there")
    found = {"all": figures(rows, predicted)}
    for key in ("kind", "strategy"):
        for value in sorted({row[key] for row in rows}):
            mine = [row for row in rows if row[key] == value]
            found[f"{key} {value}"] = figures(mine, predicted)
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the score."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("predictions", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("--split", choices=SPLITS, default="test", help="default: test")
    parser.add_argument("--most-rms", type=float, metavar="DEG", help="exit code 1 above it")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args(argv)
    try:
        found = score(asked.predictions, asked.truth, asked.split)
    except InputError as error:
        print(f"score.py: {error}", file=sys.stderr)
        return WRONG
    print(json.dumps(found) if asked.json else words(found))
    is_over = asked.most_rms is not None and found["all"]["rms_deg"] > asked.most_rms
    return OVER if is_over else SCORED


def words(found: dict[str, dict[str, Any]]) -> str:
    """The score as a table."""
    names = list(found["all"])
    lines = [f"{'':24}" + "".join(f"{name:>13}" for name in names)]
    for row, of in found.items():
        cells = ["" if of[name] is None else f"{of[name]:g}" for name in names]
        lines.append(f"{row:24}" + "".join(f"{cell:>13}" for cell in cells))
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
