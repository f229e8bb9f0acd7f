"""Figure 6.13 and table 6.2: estimation of the layshaft's angle over two shifts."""

from __future__ import annotations

import numpy as np

from benchmarks.studies.estimate import NO_MATCH, Estimated, conclude
from benchmarks.studies.excitation import (
    BASELINE,
    THESIS_ANGLE_DEG,
    THESIS_ESTIMATOR,
    Matched,
    Settings,
    label,
    runs,
)
from benchmarks.studies.record import Finding, Given, Statement, Study, ThesisVerdict
from meshpoint.controller.motion.linear_kernels import Vector
from meshpoint.testbench.results.estimation import Sample
from meshpoint.units import DEG


def _true_deg(samples: list[Sample]) -> Vector:
    """From the first sample on; the encoder counts turns modulo 256."""
    true: Vector = np.unwrap([sample.theta_rad for sample in samples], period=512.0 * np.pi) / DEG
    passed: Vector = true - true[0]
    return passed


def _error_deg(samples: list[Sample]) -> Vector:
    return np.array([sample.theta_error_rad for sample in samples]) / DEG


ANGLE = Estimated(
    name="angle",
    unit="deg",
    table="6.2",
    of=lambda figures: figures.angle_deg,
    true=_true_deg,
    error=_error_deg,
    axis="deg since the main box came free",
    thesis={THESIS_ESTIMATOR: THESIS_ANGLE_DEG},
    levels={"thesis, its filter": sum(THESIS_ANGLE_DEG) / 2.0},
)


def _conclude(given: Given[Settings]) -> Finding:
    return conclude(ANGLE, given, _statements)


def _statements(match: Matched | None) -> tuple[Statement, ...]:
    size = sum(THESIS_ANGLE_DEG) / len(THESIS_ANGLE_DEG)
    thesis = f"the filter's angle follows the encoder closely: {size:.2f} deg RMS"
    if match is None:
        return (Statement(thesis, "-", ThesisVerdict.NOT_COMPARABLE, NO_MATCH),)
    ours = {name: f.angle_deg for name, f in match.figures.items()}
    first = Statement(
        thesis,
        f"{ours[THESIS_ESTIMATOR]:.3f} deg at the thesis's excitation, "
        f"{ours[THESIS_ESTIMATOR] / size:.2f} times the thesis's",
        ThesisVerdict.AGREES if ours[THESIS_ESTIMATOR] <= size else ThesisVerdict.DIFFERS,
        "closely is taken as no worse than the thesis's own; that ours is smaller says nothing of "
        "a real rig: simulated figures are not rig figures, and our reference encoder has no error "
        "of its own",
    )
    rest = tuple(
        Statement(
            f"(not in the thesis) estimator {label(name)}",
            f"{ours[name]:.3f} deg, {ours[name] / ours[THESIS_ESTIMATOR]:.2f} times the thesis's "
            "filter in the same runs",
            ThesisVerdict.NOT_COMPARABLE,
            "the production controller has no angle; this is the last edge carried on at its speed"
            if name == BASELINE
            else "the product's own; the thesis has none",
        )
        for name in ours
        if name != THESIS_ESTIMATOR
    )
    return (first, *rest)


STUDY = Study(
    "angle_estimate",
    "Estimation of the layshaft's angle",
    ("figure 6.13", "table 6.2"),
    Settings,
    _conclude,
    runs,
)
