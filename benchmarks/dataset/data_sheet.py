"""README.md of the set: what it is, how it was made, what each column is, licence and citation."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow.parquet as pq

from benchmarks.dataset.column_words import FILES, words_of
from benchmarks.dataset.parts import ShiftParts
from benchmarks.dataset.plan import HELD_OUT, MOMENTS, PAIRS, PROFILE, SHEET, TEST, Plan
from meshpoint.base.provenance import provenance
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile

SCORE_COLUMNS: Final = ("shifts", "rms_deg", "in_half_gap", "in_1_sd", "in_2_sd")
UNITS: Final = (
    ("_us", "us"), ("_ms", "ms"), ("_bar", "bar"), ("_mm", "mm"), ("_rpm", "rpm"), ("_deg", "deg"),
    ("_percent", "%"), ("_km_h", "km/h"), ("_kg", "kg"), ("_j", "J"), ("_c", "degC"),
)  # fmt: skip
Scores = dict[str, dict[str, dict[str, Any]]]
"""Of each baseline, row and figure."""

HEAD: Final = """# Shifts of simulated dog-clutch gearboxes, and a task on them

{shifts} gear changes of a heavy truck's gearbox without synchromesh: tooth edges, pressures, sleeve
positions, valves, what the controller believed, and what was true. **All of it is simulated**:
gearbox, truck, sensors and bus are models, and the values are representative of heavy trucks, not
measured on one. The controller is the real program. Nothing here was recorded on silicon or in a
vehicle.

## The task

Predict the phase at which sleeve and gear meet, from what was known 45 ms before. 45 ms is how long
a sleeve takes from its valve to the teeth: who fires it has to know the phase by then.

- Known is `shifts.parquet`, `gearbox.json` and all of `known/`: rows whose frame had reached the
  controller 45 ms before the contact (`arrival_us <= cutoff_us`). When the contact comes is given
  (`cutoff_us` + 45,000), what it meets is asked for. Arrivals are late by up to 1 ms, never early.
- Learn from `train`, of which `later/` and `truth/` may be used as well. Be judged on `test`: one
  gearbox of {held_out} of each kind is held out, with all of its shifts.
- `phase = gear_ratio * layshaft angle - main shaft angle + reference_deg`, modulo `pitch_deg`;
  angles are those of rising edges.
- Half of the shifts were fired by phase control, and their phase is near 0 because of that. The
  others were fired by the slip alone, and meet any phase: the row `strategy speed_window` is the
  one that a constant 0 does not get.

```sh
python task/hold.py . -o hold.csv                          # numpy and pyarrow are all it needs
python task/score.py hold.csv truth/contacts.parquet       # --help: formats and exit codes
```

`hold` keeps both speeds, `thesis` is the Kalman filter and prediction of the 2019 thesis by the
data sheet's figures, `ours` is what meshpoint's controller said on the bus. They learn nothing of
the set. Split `{split}`:

{table}

`rms_deg`: root of the mean square error. `in_half_gap`: share of errors of at most {half_gap:g}
deg. `in_1_sd`, `in_2_sd`: share within one and two of the standard deviations given.
Predictions by lot would have {lot_rms:.3f} deg and {lot_share:g}.

## How it was made

Each gearbox is a draw of every part within its tolerance, of a gear change, and of load, road,
oil and air (profile `{profile}`, data sheet `{sheet}`). It made {learned} shifts in which its
controller learned. Then each of {moments} requests was answered twice from the same state, by
`target_phase` and by `speed_window`. Each series runs from 400 ms before the request to 100 ms
after the shift's end, or as long as the bus was recorded.

| | |
|---|---|
| command | `python -m benchmarks.dataset --out DIR {arguments}` |
| seeds | upshifts from {up_seed}, downshifts from {down_seed}, one a gearbox (`gearbox_seed`) |
| gear changes | upshifts {up_pairs}; downshifts {down_pairs} |
| left out | {left} |
| meshpoint | {version}, data sheet {sheet_hash}, DBC {dbc_hash} |

The same command with the same versions of meshpoint, numpy, numba, pyarrow and asammdf writes the
same bytes on the same kind of machine (`SHA256SUMS`).

## What is simulated, and what that leaves out

- Sensors err as the profile draws them: teeth off their places, pressures and positions with noise,
  lag and offset. No fault is injected: no edge is lost, no valve sticks.
- The driveline twists and has backlash, and the road moves it. Nobody uses the wheel brakes.
- Only the main box changes gear, one main gear at a time; splitter and range stay.
- The controller chose when to fire. A set of other moments would have other phases.

## Files

`known/` and `later/` have the same files; together they are the whole series, no row is in both.
`mf4/` has each shift whole, truth included, as an MDF 4 file for viewers, with the same names.
`baselines/` has the predictions of the table. No value: it was not there, or does not apply.
"""
TAIL: Final = """
## Licence and citation

The data are under CC-BY-4.0 (https://creativecommons.org/licenses/by/4.0/), the programs of `task/`
under the MIT licence as meshpoint is (`task/LICENSE`). Cite as:

> The meshpoint authors: Shifts of simulated dog-clutch gearboxes, {shifts} shifts, seed {seed},
> made with meshpoint {version}.
"""


def score_table(scores: Scores) -> str:
    """A row for each baseline and group of shifts, as Markdown."""
    lines = [
        f"| baseline | shifts of | {' | '.join(SCORE_COLUMNS)} |",
        "|---|---|" + "---:|" * len(SCORE_COLUMNS),
    ]
    for name, rows in scores.items():
        for row, of in rows.items():
            cells = ["" if of[key] is None else f"{of[key]:g}" for key in SCORE_COLUMNS]
            lines.append(f"| `{name}` | {row} | {' | '.join(cells)} |")
    return "\n".join(lines)


def write_sheet(
    folder: Path, plan: Plan, shifts: Sequence[ShiftParts], left: Counter[str], scores: Scores
) -> None:
    """README.md of a set of which all else is written."""
    sheet = load_sheet(SHEET)
    of = provenance(sheet, plan.seed, Preset.TRUCK.value, Profile(PROFILE))
    pitch_deg, half_gap_deg = (shifts[0].shift[name] for name in ("pitch_deg", "half_gap_deg"))
    facts: dict[str, Any] = {
        "shifts": len(shifts), "held_out": HELD_OUT, "split": judged(shifts),
        "table": score_table(scores), "arguments": plan.arguments,
        "half_gap": half_gap_deg, "lot_rms": pitch_deg / math.sqrt(12.0),
        "lot_share": 2.0 * half_gap_deg / pitch_deg, "profile": PROFILE, "sheet": SHEET,
        "learned": plan.learned, "moments": MOMENTS, "seed": plan.seed, "left": _left(left),
        "version": of["version"], "sheet_hash": of["gearbox_sha256"][:12],
        "dbc_hash": of["dbc_sha256"][:12],
    }  # fmt: skip
    for short, kind in (("up", "upshift"), ("down", "downshift")):
        facts[f"{short}_seed"] = next(plan.gearboxes(kind)).seed
        facts[f"{short}_pairs"] = ", ".join(f"{old}-{new}" for old, new in PAIRS[kind])
    text = HEAD.format(**facts) + "".join(_file(path, folder) for path in _files(folder))
    (folder / "README.md").write_text(text + TAIL.format(**facts), encoding="utf-8")


def judged(shifts: Sequence[ShiftParts]) -> str:
    """The split that baselines are scored on: a small set has no gearbox held out."""
    return TEST if any(shift.shift["split"] == TEST for shift in shifts) else "all"


def _left(left: Counter[str]) -> str:
    if not left:
        return "none"
    return "; ".join(f"{count} shifts {why}" for why, count in sorted(left.items()))


def _files(folder: Path) -> list[Path]:
    """One of each kind: those of `later` are as those of `known`."""
    parts = [folder / "shifts.parquet", *sorted((folder / "known").glob("*.parquet"))]
    return [*parts, *sorted((folder / "truth").glob("*.parquet"))]


def _file(path: Path, folder: Path) -> str:
    """A file's columns as a table."""
    lines = [f"\n### {path.relative_to(folder).as_posix()}\n", FILES[path.stem], ""]
    lines += ["| column | unit | what |", "|---|---|---|"]
    for name in pq.read_schema(path).names:
        unit = next((unit for end, unit in UNITS if name.endswith(end)), "")
        lines.append(f"| `{name}` | {unit} | {words_of(path.stem, name)} |")
    return "\n".join(lines) + "\n"
