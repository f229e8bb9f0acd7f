"""Figure 6.12 and table 6.1: estimation of the layshaft's speed over two shifts."""

from __future__ import annotations

import numpy as np

from benchmarks.studies.estimate import NO_MATCH, Estimated, conclude
from benchmarks.studies.excitation import (
    BASELINE,
    THESIS_BASELINE_RPM,
    THESIS_ESTIMATOR,
    THESIS_SPEED_RPM,
    Matched,
    Settings,
    runs,
)
from benchmarks.studies.record import Finding, Given, Statement, Study, ThesisVerdict
from meshpoint.controller.motion.linear_kernels import Vector
from meshpoint.testbench.results.estimation import Sample
from meshpoint.units import RPM


def _true_rpm(samples: list[Sample]) -> Vector:
    return np.array([sample.omega_rad_s for sample in samples]) / RPM


def _error_rpm(samples: list[Sample]) -> Vector:
    return np.array([sample.omega_error_rad_s for sample in samples]) / RPM


SPEED = Estimated(
    name="speed",
    unit="rpm",
    table="6.1",
    of=lambda figures: figures.speed_rpm,
    true=_true_rpm,
    error=_error_rpm,
    axis="rpm",
    thesis={BASELINE: THESIS_BASELINE_RPM, THESIS_ESTIMATOR: THESIS_SPEED_RPM},
    levels={
        "thesis, production": sum(THESIS_BASELINE_RPM) / 2.0,
        "thesis, its filter": sum(THESIS_SPEED_RPM) / 2.0,
    },
)


def _conclude(given: Given[Settings]) -> Finding:
    return conclude(SPEED, given, _statements)


def _statements(match: Matched | None) -> tuple[Statement, ...]:
    thesis = (
        f"production {THESIS_BASELINE_RPM[0]} and {THESIS_BASELINE_RPM[1]} rpm RMS, the filter "
        f"{THESIS_SPEED_RPM[0]} and {THESIS_SPEED_RPM[1]} rpm: slightly better"
    )
    if match is None:
        return (Statement(thesis, "-", ThesisVerdict.NOT_COMPARABLE, NO_MATCH),)
    ours = {name: f.speed_rpm for name, f in match.figures.items()}
    better = ours[THESIS_ESTIMATOR] < ours[BASELINE]
    size = sum(THESIS_SPEED_RPM) / len(THESIS_SPEED_RPM)
    first = Statement(
        thesis,
        f"with a brake of {match.brake_nm:.0f} Nm the production speed reads "
        f"{ours[BASELINE]:.2f} rpm (so chosen), the thesis's filter "
        f"{ours[THESIS_ESTIMATOR]:.2f} rpm",
        ThesisVerdict.AGREES if better else ThesisVerdict.DIFFERS,
        "compared at the excitation at which the production speed's error is the thesis's; the "
        "verdict is on the order alone",
    )
    second = Statement(
        f"the filter's error is {size:.2f} rpm",
        f"{ours[THESIS_ESTIMATOR]:.2f} rpm, {ours[THESIS_ESTIMATOR] / size:.2f} times the thesis's",
        ThesisVerdict.NOT_COMPARABLE,
        "simulated figures are not rig figures: our reference encoder has no error of its own, a "
        "real rig has more than the virtual one knows of, and Q and R were tuned anew",
    )
    return (first, second, *_others(ours))


def _others(ours: dict[str, float]) -> tuple[Statement, ...]:
    names = [name for name in ours if name not in (BASELINE, THESIS_ESTIMATOR)]
    return tuple(
        Statement(
            f"(not in the thesis) estimator {name}",
            f"{ours[name]:.2f} rpm, {ours[name] / ours[THESIS_ESTIMATOR]:.2f} times the thesis's "
            "filter in the same runs",
            ThesisVerdict.NOT_COMPARABLE,
            "the product's own; the thesis has none",
        )
        for name in names
    )


STUDY = Study(
    "speed_estimate",
    "Estimation of the layshaft's speed",
    ("figure 6.12", "table 6.1"),
    Settings,
    _conclude,
    runs,
)
