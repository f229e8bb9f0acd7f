"""Figure 6.5: prediction by constant speed."""

from __future__ import annotations

from benchmarks.studies.prediction import Predictions, Settings
from benchmarks.studies.record import Finding, Given, Statement, Study, ThesisVerdict


def _conclude(given: Given[Settings]) -> Finding:
    predictions = Predictions(given)
    linear = predictions.linear()
    values = predictions.figures(linear)
    half_gap_pct = 50.0 * given.sheet.dog.backlash_share
    angle_pct = values["engaging_angle_rms_percent_of_pitch"]
    statement = Statement(
        "sensitive to changes in acceleration and slow to come near the simulated speed after the "
        "brake: ineffective when a gear is to be engaged",
        f"in the {given.own.engaging_ms} ms in which a gear would be engaged the error is "
        f"{values['engaging_speed_rms_rpm']:.1f} rpm and {angle_pct:.1f} % of pitch RMS; up to "
        f"{predictions.around(values)}",
        ThesisVerdict.AGREES if angle_pct > half_gap_pct else ThesisVerdict.DIFFERS,
        f"ineffective is taken as an angle error of more than half a gap ({half_gap_pct:g} % of "
        "pitch): residual pressure and drag go on slowing the layshaft",
    )
    chart = predictions.chart("linear", "Prediction by constant speed, 45 ms ahead", linear)
    return Finding((statement,), values, (chart,))


STUDY = Study("linear", "Prediction: constant speed", ("figure 6.5",), Settings, _conclude)
