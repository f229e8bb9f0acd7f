"""Figure 6.6: prediction by Euler's method."""

from __future__ import annotations

from benchmarks.studies.prediction import Predictions, Settings
from benchmarks.studies.record import Finding, Given, Statement, Study, ThesisVerdict


def _conclude(given: Given[Settings]) -> Finding:
    predictions = Predictions(given)
    euler, linear = predictions.euler(), predictions.linear()
    values, linear_values = predictions.figures(euler), predictions.figures(linear)
    around, elsewhere = values["most_around_switches_rpm"], values["most_elsewhere_rpm"]
    delayed = Statement(
        "the prediction is late by 45 ms when the brake's input changes",
        f"error up to {predictions.around(values)}, within 45 ms; up to {elsewhere:.1f} rpm "
        "elsewhere",
        ThesisVerdict.AGREES if around > elsewhere else ThesisVerdict.DIFFERS,
        "a switch after the prediction was made is not in it",
    )
    key = "engaging_speed_rms_rpm"
    closer = Statement(
        "after the release the prediction comes nearer the simulated speed than the linear one",
        f"{values[key]:.2f} rpm RMS against {linear_values[key]:.2f} rpm, "
        f"{values['engaging_angle_rms_percent_of_pitch']:.2f} % of pitch against "
        f"{linear_values['engaging_angle_rms_percent_of_pitch']:.2f} %",
        ThesisVerdict.AGREES if values[key] < linear_values[key] else ThesisVerdict.DIFFERS,
        "it knows pressure and friction; what is left is its step, see study step",
    )
    chart = predictions.chart("euler", "Prediction by Euler's method, 45 ms ahead", euler, linear)
    return Finding((delayed, closer), values | {"linear": linear_values}, (chart,))


STUDY = Study("euler", "Prediction: Euler's method", ("figure 6.6",), Settings, _conclude)
