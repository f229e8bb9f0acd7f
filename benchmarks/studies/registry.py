"""All studies by name.

How a study is added: a file in `benchmarks/studies/` with a frozen dataclass of its settings and a
constant `STUDY: Study`; a table `[NAME]` in `studies.toml` with a value for every setting; the
study in `STUDIES`, at the place where it should stand on the page; a line in `docs/thesis.md`. What
takes longer than a second goes into jobs (`jobs.py` has the closed loop), which run in parallel;
`conclude` makes statements, figures, charts and tables of their results. Drawing, CSV, JSON and the
page are the frame's.
"""

from __future__ import annotations

from typing import Any, Final

from benchmarks.studies import (
    bound,
    campaign_statistics,
    commission,
    counterfactual,
    delay,
    delay_error,
    estimate,
    hardware,
    identify,
    layshaft,
    parameters,
    prediction,
    shiftability,
    splitter,
    start_error,
    step,
    target,
    torque,
    valve,
)
from benchmarks.studies.record import Study
from meshpoint.base.columns import folded
from meshpoint.base.errors import CommandError

STUDIES: Final[tuple[Study[Any], ...]] = (
    valve.STUDY,
    torque.STUDY,
    layshaft.STUDY,
    delay.STUDY,
    prediction.LINEAR,
    prediction.EULER,
    prediction.HOLD,
    splitter.STUDY,
    parameters.STUDY,
    start_error.ANGLE,
    start_error.SPEED,
    delay_error.STUDY,
    estimate.SPEED_STUDY,
    estimate.ANGLE_STUDY,
    step.STUDY,
    bound.STUDY,
    shiftability.STUDY,
    hardware.STUDY,
    target.STUDY,
    counterfactual.STUDY,
    identify.STUDY,
    commission.STUDY,
    campaign_statistics.STUDY,
)
"""In the order of the thesis, then what goes beyond it."""
STUDY_NAMES: Final = tuple(study.name for study in STUDIES)
ALL: Final = "all"
_BY_NAME: Final = dict(zip(STUDY_NAMES, STUDIES, strict=True))


def load(name: str) -> Study[Any]:
    """The study of this name. KeyError where there is none."""
    return _BY_NAME[name]


def chosen(words: list[str]) -> list[Study[Any]]:
    """The studies asked for, each once, in the order of `STUDY_NAMES`.

    A word is a study's name, `all`, or what it reproduces (`figure 6.8`, `table 6.1`); a number
    alone (`6.8`) is a figure's, where a figure has it. CommandError on anything else."""
    wanted: set[str] = set()
    for word in words:
        found = list(STUDY_NAMES) if word == ALL else _found(word)
        if not found:
            names = folded(", ".join(("all", "list", *STUDY_NAMES)))
            raise CommandError(f"no study {word!r}; allowed are\n  {names}")
        wanted.update(found)
    return [study for study in STUDIES if study.name in wanted]


def _found(word: str) -> list[str]:
    """Names of the studies that answer to a word."""
    for said in (word, f"figure {word}", f"table {word}", f"section {word}"):
        names = [study.name for study in STUDIES if said == study.name or said in study.of]
        if names:
            return names
    return []
