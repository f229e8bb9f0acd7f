"""All studies by name.

How a study is added: a file `benchmarks/studies/NAME.py` with a frozen dataclass of its
settings and a constant `STUDY: Study`; a table `[NAME]` in `studies.toml` with a value for every
setting; its name in `STUDY_NAMES`, at the place where it should stand on the page; a line in
`docs/thesis.md`. What takes longer than a second goes into jobs (`jobs.py` has the closed loop),
which run in parallel; `conclude` makes statements, figures, charts and tables of their results.
Drawing, CSV, JSON and the page are the frame's.
"""

from __future__ import annotations

import importlib
from typing import Any, Final

from benchmarks.studies.record import Study
from meshpoint.testbench.columns import folded
from meshpoint.testbench.errors import CommandError

STUDY_NAMES: Final = (
    "valve",
    "torque",
    "layshaft",
    "delay",
    "linear",
    "euler",
    "hold",
    "parameters",
    "start_angle",
    "start_speed",
    "delay_error",
    "speed_estimate",
    "angle_estimate",
    "step",
    "bound",
    "shiftability",
    "hardware",
    "target",
    "counterfactual",
    "identify",
    "commission",
    "campaign_statistics",
)
"""In the order of the thesis, then what goes beyond it."""
ALL: Final = "all"


def load(name: str) -> Study[Any]:
    """The study of this name. KeyError where there is none."""
    if name not in STUDY_NAMES:
        raise KeyError(name)
    study: Study[Any] = importlib.import_module(f"benchmarks.studies.{name}").STUDY
    return study


def chosen(words: list[str]) -> list[Study[Any]]:
    """The studies asked for, each once, in the order of `STUDY_NAMES`.

    A word is a study's name, `all`, or what it reproduces (`figure 6.8`, `table 6.1`); a number
    alone (`6.8`) is a figure's, where a figure has it. CommandError on anything else."""
    studies = [load(name) for name in STUDY_NAMES]
    wanted: set[str] = set()
    for word in words:
        found = list(STUDY_NAMES) if word == ALL else _found(studies, word)
        if not found:
            names = folded(", ".join(("all", "list", *STUDY_NAMES)))
            raise CommandError(f"no study {word!r}; allowed are\n  {names}")
        wanted.update(found)
    return [study for study in studies if study.name in wanted]


def _found(studies: list[Study[Any]], word: str) -> list[str]:
    """Names of the studies that answer to a word."""
    for said in (word, f"figure {word}", f"table {word}", f"section {word}"):
        names = [study.name for study in studies if said == study.name or said in study.of]
        if names:
            return names
    return []
