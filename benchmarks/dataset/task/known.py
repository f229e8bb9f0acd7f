"""Reads what was known of each shift 45 ms before contact. Needs numpy and pyarrow alone.

shifts, gearbox = read_shifts(folder)
for shift in shifts:
    shift.row["reference_deg"], shift.edges("layshaft")
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow.parquet as pq

AHEAD_US = 45_000
"""From the end of what is known (`cutoff_us`) to the contact."""


class Prediction(NamedTuple):
    """The phase expected at contact; sd_deg: its standard deviation, where there is one."""

    phase_deg: float
    sd_deg: float | None = None


class Shift(NamedTuple):
    """One shift: its row of shifts.parquet, and its rows of each file of known/."""

    row: dict[str, Any]
    tables: dict[str, dict[str, np.ndarray]]

    @property
    def contact_us(self) -> int:
        """When sleeve and gear meet: that is given, what they meet with is asked for."""
        return self.row["cutoff_us"] + AHEAD_US

    def edges(self, shaft: str) -> tuple[np.ndarray, np.ndarray]:
        """Times (us) and running numbers of a shaft's rising edges."""
        edges = self.tables["edges"]
        mine = (edges["shaft"] == shaft) & (edges["edge"] == "rise")
        return edges["time_us"][mine].astype(float), edges["index"][mine].astype(float)

    def phase_deg(self, layshaft_deg: float, main_deg: float) -> float:
        """The phase that these angles make, within half a pitch either way (deg)."""
        row = self.row
        phase = row["gear_ratio"] * layshaft_deg - main_deg + row["reference_deg"]
        pitch = row["pitch_deg"]
        return phase - pitch * float(np.floor(phase / pitch + 0.5))


def read_shifts(folder: Path) -> tuple[list[Shift], dict[str, Any]]:
    """All shifts of a set, and gearbox.json."""
    rows = pq.read_table(folder / "shifts.parquet").to_pylist()
    files = sorted((folder / "known").glob("*.parquet"))
    tables = {file.stem: _by_shift(file) for file in files}
    shifts = [
        Shift(row, {name: of[row["shift"]] for name, of in tables.items() if row["shift"] in of})
        for row in rows
    ]
    return shifts, json.loads((folder / "gearbox.json").read_text(encoding="utf-8"))


def _by_shift(file: Path) -> dict[str, dict[str, np.ndarray]]:
    """The columns of each shift, whose rows stand together."""
    table = pq.read_table(file)
    columns = {name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names}
    ids = columns.pop("shift")
    starts = [0, *(np.flatnonzero(ids[1:] != ids[:-1]) + 1)] if len(ids) else []
    ends = [*starts[1:], len(ids)]
    return {
        ids[start]: {name: of[start:end] for name, of in columns.items()}
        for start, end in zip(starts, ends, strict=True)
    }


def write_predictions(path: Path, predicted: Iterable[tuple[str, Prediction]]) -> None:
    """As score.py reads them."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("shift", "phase_deg", "sd_deg"))
        for shift, (phase_deg, sd_deg) in predicted:
            writer.writerow((shift, f"{phase_deg:.5f}", "" if sd_deg is None else f"{sd_deg:.5f}"))


def run(predict: Callable[[Shift, dict[str, Any]], Prediction], about: str | None) -> int:
    """A baseline as a command: python NAME.py SET -o FILE."""
    parser = argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("set", type=Path, help="the data set's folder")
    parser.add_argument("-o", "--output", type=Path, required=True, help="predictions (CSV)")
    asked = parser.parse_args()
    try:
        shifts, gearbox = read_shifts(asked.set)
    except OSError as error:
        print(f"{asked.set}: not a data set: {error}", file=sys.stderr)
        return 2
    write_predictions(
        asked.output, ((shift.row["shift"], predict(shift, gearbox)) for shift in shifts)
    )
    print(f"{asked.output}: {len(shifts)} predictions")
    return 0
