"""Figure 6.7: prediction by zero-order hold, and what knowing the future commands adds."""

from __future__ import annotations

import numpy as np

from benchmarks.studies.prediction import Predictions, Settings
from benchmarks.studies.record import Finding, Given, Statement, Study, ThesisVerdict

EXACT_RPM = 1e-6


def _conclude(given: Given[Settings]) -> Finding:
    predictions = Predictions(given)
    hold, future = predictions.hold(), predictions.hold_future()
    values = predictions.figures(hold)
    elsewhere = values["most_elsewhere_rpm"]
    exact = Statement(
        "exactly the simulated value in each sampling point, except when the input changes",
        f"at most {elsewhere:.1e} rpm off where no switch lies within the horizon",
        ThesisVerdict.AGREES if elsewhere < EXACT_RPM else ThesisVerdict.DIFFERS,
        f"exact is taken as {EXACT_RPM:g} rpm. The simulated value is the rig's closed form, "
        "written independently of the predictor's",
    )
    around = values["most_around_switches_rpm"]
    delayed = Statement(
        "as with Euler there is a delay when the brake is engaged and disengaged",
        f"error up to {predictions.around(values)}, within 45 ms",
        ThesisVerdict.AGREES if around > elsewhere else ThesisVerdict.DIFFERS,
        "the thesis's predictor holds the input; a switch in the horizon is not in it",
    )
    known = float(np.abs(future.speed_error_rpm).max())
    known_pct = float(np.abs(future.angle_error_pct).max())
    beyond = Statement(
        "(not in the thesis) the node knows its own commands of the next 45 ms",
        f"with them at most {known:.1e} rpm and {known_pct:.1e} % of pitch off everywhere, the "
        "switches included",
        ThesisVerdict.NOT_COMPARABLE,
        "valve commands carry an activation time, so each switch is a step of its own",
    )
    values |= {"known_future_most_rpm": known, "known_future_most_percent_of_pitch": known_pct}
    chart = predictions.chart("hold", "Prediction by zero-order hold, 45 ms ahead", hold, future)
    return Finding((exact, delayed, beyond), values, (chart,))


STUDY = Study("hold", "Prediction: zero-order hold", ("figure 6.7",), Settings, _conclude)
