"""Figures 6.5 to 6.7: predictions over the sleeve's delay against the simulated value (thesis 6.3).

Every sample is predicted t_delay ahead, and the prediction delayed by as much is compared with the
simulated value: by constant speed, by Euler's method, and by zero-order hold with and without the
future commands.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmarks.studies.record import (
    Chart,
    Finding,
    Given,
    Line,
    Panel,
    Statement,
    Study,
    Style,
    ThesisVerdict,
    rms,
)
from benchmarks.studies.simulated import SimulatedShift, simulate_shift
from benchmarks.studies.thesis_predictions import predict_euler, predict_hold, predict_linear
from meshpoint.controller.models.layshaft import LayshaftState
from meshpoint.controller.models.thesis import layshaft_model
from meshpoint.gearbox import Split
from meshpoint.gearbox.tables import count, quantity
from meshpoint.kernels.records import Vector
from meshpoint.units import MS_US, RPM, US

SAMPLE_US: Final = 1_000
SPLIT: Final = Split.HIGH
Method = Callable[[LayshaftState, float], LayshaftState]


@dataclass(frozen=True)
class Settings:
    """Euler's step, and the time after the release in which a gear would be engaged."""

    euler_step_s: float = quantity("euler_step_ms", 0.01, 45.0, 1e-3)
    engaging_ms: int = count("engaging_ms", 10, 1000)


@dataclass(frozen=True)
class Predicted:
    """One method over the shift: what it said of each sample 45 ms before, and its errors."""

    name: str
    time_ms: Vector
    speed_rpm: Vector
    speed_error_rpm: Vector
    angle_error_pct: Vector
    """Of the layshaft, in per cent of a pitch."""


class Predictions:
    """The simulated shift, the methods, and the times that matter."""

    def __init__(self, given: Given[Settings]) -> None:
        self.sheet, self.own = given.sheet, given.own
        self.delay_us = round(self.sheet.sleeve.delay_s / US)
        self.model = layshaft_model(self.sheet, SPLIT)
        self.shift: SimulatedShift = simulate_shift(self.sheet, given.common.shift, SAMPLE_US)
        self.on_us, self.off_us = self.shift.switch_us.tolist()

    def linear(self) -> Predicted:
        """Constant speed (5.12)."""
        return self._over("linear (5.12)", predict_linear)

    def euler(self) -> Predicted:
        """Euler steps with the input held (5.15)."""
        step_s = self.own.euler_step_s

        def method(state: LayshaftState, to_us: float) -> LayshaftState:
            _, u = self.shift.known_at(state.time_us)
            held = float(u[-1]) if u.size else 0.0
            return predict_euler(state, to_us, held, self.model, step_s)

        return self._over(f"Euler, steps of {1e3 * step_s:g} ms (5.15)", method)

    def hold(self) -> Predicted:
        """Zero-order hold with the input held (5.17)."""

        def method(state: LayshaftState, to_us: float) -> LayshaftState:
            return predict_hold(state, to_us, self.shift.known_at(state.time_us), self.model)

        return self._over("ZOH (5.17)", method)

    def hold_future(self) -> Predicted:
        """As the node predicts: zero-order hold over the commands that are planned."""
        switches = np.array((self.shift.switch_us, self.shift.switch_u))

        def method(state: LayshaftState, to_us: float) -> LayshaftState:
            return predict_hold(state, to_us, switches, self.model)

        return self._over("ZOH over the known future commands", method)

    def _over(self, name: str, method: Method) -> Predicted:
        shift, ahead = self.shift, self.delay_us // SAMPLE_US
        count_ = shift.time_us.size - ahead
        theta, omega = np.empty(count_), np.empty(count_)
        for i in range(count_):
            state = shift.state(i)
            then = method(state, state.time_us + self.delay_us)
            theta[i], omega[i] = then.theta_rad, then.omega_rad_s
        pitch_rad = self.sheet.dog.pitch_rad
        return Predicted(
            name,
            shift.time_ms[ahead:],
            omega / RPM,
            (omega - shift.omega_rad_s[ahead:]) / RPM,
            100.0 * (theta - shift.theta_rad[ahead:]) / pitch_rad,
        )

    def after_switch(self, predicted: Predicted, switch_us: float) -> Any:
        """Mask of the samples predicted before a switch that came until then."""
        time_us = predicted.time_ms * MS_US
        return (time_us > switch_us) & (time_us < switch_us + self.delay_us)

    def engaging(self, predicted: Predicted) -> Any:
        """Mask of the time in which a gear would be engaged: from the first prediction that knows
        of the release on."""
        time_us, from_us = predicted.time_ms * MS_US, self.off_us + self.delay_us
        return (time_us >= from_us) & (time_us < from_us + self.own.engaging_ms * MS_US)

    def figures(self, predicted: Predicted) -> dict[str, float]:
        """Errors around brake on and off and in the time of engagement."""
        on, off = (self.after_switch(predicted, at_us) for at_us in (self.on_us, self.off_us))
        engaging = self.engaging(predicted)
        speed, angle = np.abs(predicted.speed_error_rpm), np.abs(predicted.angle_error_pct)
        return {
            "most_around_switches_rpm": float(speed[on | off].max()),
            "most_around_on_rpm": float(speed[on].max()),
            "most_around_off_rpm": float(speed[off].max()),
            "most_around_on_percent_of_pitch": float(angle[on].max()),
            "most_around_off_percent_of_pitch": float(angle[off].max()),
            "most_elsewhere_rpm": float(speed[~(on | off)].max()),
            "engaging_speed_rms_rpm": rms(predicted.speed_error_rpm[engaging]),
            "engaging_angle_rms_percent_of_pitch": rms(predicted.angle_error_pct[engaging]),
        }

    @staticmethod
    def around(values: dict[str, float]) -> str:
        """In words: the largest errors within the delay of either switch."""
        return " and ".join(
            f"{values[f'most_around_{switch}_rpm']:.1f} rpm, "
            f"{values[f'most_around_{switch}_percent_of_pitch']:.0f} % of pitch after brake "
            f"{switch}"
            for switch in ("on", "off")
        )

    def chart(self, name: str, title: str, *methods: Predicted) -> Chart:
        """Speed simulated and predicted, and the errors."""
        shift = self.shift
        moments = {"brake reacts: on": self.on_us / MS_US, "off": self.off_us / MS_US}
        simulated = Line("simulated", shift.time_ms, shift.omega_rpm)
        speeds = tuple(Line(m.name, m.time_ms, m.speed_rpm, Style.DASHED) for m in methods)
        return Chart(
            name,
            title,
            "ms since the main box came free",
            (
                Panel("layshaft, rpm", (simulated, *speeds), moments=moments),
                Panel(
                    "speed error, rpm",
                    tuple(Line(m.name, m.time_ms, m.speed_error_rpm) for m in methods),
                    moments=moments,
                ),
                Panel(
                    "angle error, % of pitch",
                    tuple(Line(m.name, m.time_ms, m.angle_error_pct) for m in methods),
                    moments=moments,
                ),
            ),
        )


def _linear(given: Given[Settings]) -> Finding:
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


LINEAR = Study("linear", "Prediction: constant speed", ("figure 6.5",), Settings, _linear)


def _euler(given: Given[Settings]) -> Finding:
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


EULER = Study("euler", "Prediction: Euler's method", ("figure 6.6",), Settings, _euler)


EXACT_RPM = 1e-6


def _hold(given: Given[Settings]) -> Finding:
    predictions = Predictions(given)
    hold, future = predictions.hold(), predictions.hold_future()
    values = predictions.figures(hold)
    elsewhere = values["most_elsewhere_rpm"]
    exact = Statement(
        "exactly the simulated value in each sampling point, except when the input changes",
        f"at most {elsewhere:.1e} rpm off where no switch lies within the horizon",
        ThesisVerdict.BY_CONSTRUCTION if elsewhere < EXACT_RPM else ThesisVerdict.DIFFERS,
        f"exact is taken as {EXACT_RPM:g} rpm. The simulated value is the rig's closed form of the "
        "same equations, written independently of the predictor's: a difference would be a mistake "
        "in one of them",
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


HOLD = Study("hold", "Prediction: zero-order hold", ("figure 6.7",), Settings, _hold)
