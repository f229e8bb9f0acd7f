"""What a campaign's records come to: a figure a strategy, ratios between them, curves."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from meshpoint.campaigns.columns import Shifts
from meshpoint.campaigns.intervals import (
    FEW_RUNS,
    Mean,
    Quantile,
    Rate,
    Resampled,
    finite,
    interval,
    quantile,
    rate_interval,
    rate_ratio_interval,
    resample,
    telling_runs,
)
from meshpoint.campaigns.spec import TRUE_STATE, is_blind
from meshpoint.kernels.records import Integers, Vector
from meshpoint.results.better import Judged, less_is_better, named, sentence
from meshpoint.results.rows import SOURCES
from meshpoint.results.shift_parts import PARTS

P99: Final = 0.99
LEAST_SD_DEG: Final = 1e-6
Figure = Callable[["Shots"], tuple[Vector, Integers]]


class Shots:
    """The judged shifts of one strategy that were not refused; `cluster` numbers their runs."""

    def __init__(self, shifts: Shifts, cluster: Integers) -> None:
        made = ~shifts.refused
        self.shifts, self.cluster = shifts.where(made), cluster[made]
        self.refused = int(shifts.refused.sum())
        """Requests that the controller has not begun: no shifts."""
        self.is_gap = self.shifts.is_gap
        self.meets = self.shifts.meet_teeth
        """Of the shifts, those that bring dog teeth together."""
        self.impact_j: Vector = self.shifts.column("impact_j")
        self._durations: Vector = self.shifts.column("duration_ms")

    def gaps(self) -> tuple[Vector, Integers]:
        """1 where the first contact was in a gap, of the shifts with teeth to meet, and the
        runs."""
        return self.is_gap[self.meets].astype(np.float64), self.cluster[self.meets]

    def rate(self, which: NDArray[np.bool_], among: NDArray[np.bool_] | None = None) -> Rate:
        """Share of the shifts (`among` them) that are so, with its interval; NaN where there was no
        shift."""
        chosen = np.ones(which.size, dtype=np.bool_) if among is None else among
        which, clusters = which[chosen], np.unique(self.cluster[chosen], return_inverse=True)[1]
        share = float(which.mean()) if which.size else math.nan
        return Rate(share, *rate_interval(which, clusters))

    def gap_rate(self) -> Rate:
        """Share of first contacts in a gap, of the shifts with teeth to meet."""
        return self.rate(self.is_gap, self.meets)

    def promise(self) -> tuple[Vector, NDArray[np.bool_]]:
        """Of the shifts fired once with a phase predicted: the probability of its gap that the
        controller saw when it fired, and whether the tooth met a gap."""
        column = self.shifts.column
        phase, sd = column("predicted_phase_deg"), column("predicted_phase_sd_deg")
        once = ~np.isnan(phase) & (column("attempts") == 1)
        half = 0.5 * column("pitch_deg") * column("backlash_percent") / 100.0
        sd = np.maximum(sd, LEAST_SD_DEG)
        said = ndtr((half - phase) / sd) - ndtr((-half - phase) / sd)
        return said[once], self.is_gap[once]

    def impacts(self) -> tuple[Vector, Integers]:
        """Loss in flank impacts, J, and the runs."""
        return self.impact_j, self.cluster

    def durations(self) -> tuple[Vector, Integers]:
        """From request to outcome, ms, of all shifts that came to an outcome, and the runs."""
        has = ~np.isnan(self._durations)
        return self._durations[has], self.cluster[has]

    def after_ramp_ms(self) -> Vector:
        """From the end of the torque ramp to outcome, ms; NaN of shifts that came to none. What the
        ramp takes is the driveline's, and the same for every strategy."""
        ramp_ms = self.shifts.column("ramp_ms")
        return self._durations - np.where(np.isnan(ramp_ms), 0.0, ramp_ms)


class Resamples:
    """Figures of every strategy in each resample of the runs."""

    def __init__(self, shots: dict[str, Shots], runs: int) -> None:
        wanted: dict[tuple[str, str], Resampled] = {}
        for name, shot in shots.items():
            for figure, of in FIGURES.items():
                wanted[name, figure] = Mean(*of(shot), runs)
            durations, owners = shot.durations()
            if durations.size:
                wanted[name, DURATION_P99] = Quantile(durations, owners, P99, runs)
        self._found = dict(zip(wanted, resample(runs, list(wanted.values())), strict=True))

    def of(self, strategy: str, figure: str) -> Vector:
        """One of `FIGURES`, or `DURATION_P99`."""
        return self._found[strategy, figure]


def by_strategy(shifts: Shifts, names: tuple[str, ...]) -> dict[str, Shots]:
    """The shifts of one point of the sweep, by strategy."""
    runs = np.unique(shifts.column("seed"), return_inverse=True)[1]
    found = {}
    for name in names:
        own = shifts.is_("strategy", name)
        found[name] = Shots(shifts.where(own), runs[own])
    return found


def strategy_figures(name: str, shots: Shots, resamples: Resamples) -> dict[str, Any]:
    """The figures of one strategy; null where there is nothing to say."""
    shifts = shots.shifts
    durations = shots.durations()[0]
    after_ramp = shots.after_ramp_ms()
    after_ramp = after_ramp[~np.isnan(after_ramp)]
    errors = shifts.known("phase_error_deg")
    aborts = shifts.column("aborts")
    return {
        "shifts": len(shifts),
        "refused": shots.refused,
        "first_contact_gap": _rate(shots.gap_rate()),
        "promise": _promise(name, shots),
        "duration_ms": {
            "mean": _mean(durations),
            "mean_ci95": interval(resamples.of(name, "duration_ms_mean")),
            "p50": quantile(durations, 0.5) if durations.size else None,
            "p99": quantile(durations, P99) if durations.size else None,
            "p99_ci95": (
                interval(resamples.of(name, DURATION_P99)) if durations.size else [None, None]
            ),
        },
        "after_ramp_ms": {
            "mean": _mean(after_ramp),
            "p50": quantile(after_ramp, 0.5) if after_ramp.size else None,
            "p99": quantile(after_ramp, P99) if after_ramp.size else None,
        },
        "impact_j": {
            "mean": _mean(shots.impact_j),
            "mean_ci95": interval(resamples.of(name, "impact_j_mean")),
            "p99": quantile(shots.impact_j, P99) if shots.impact_j.size else None,
            "incomplete": int((~shifts.column("impact_complete")).sum()),
        },
        "phases_ms": {part: _mean(shifts.known(part)) for part in PARTS},
        "bound_ms": _mean(shifts.known("bound_ms")),
        "over_minimum": _over_minimum(shots),
        "aborted": _rate(shots.rate(aborts > 0)),
        "aborts_mean": _mean(aborts),
        "retries": int(np.maximum(0, shifts.column("attempts") - 1).sum()),
        "blocked": int(shifts.column("blocked").sum()),
        "outside_window": int(shifts.column("outside_window").sum()),
        "bounced_off": int((shots.is_gap & (shifts.column("ratchets") > 0)).sum()),
        "ratchets": int(shifts.column("ratchets").sum()),
        "not_engaged": int((~shifts.engaged).sum()),
        "phase_error_mean_deg": finite(errors.mean()) if errors.size else None,
        "phase_error_sd_deg": finite(errors.std(ddof=1)) if errors.size > 1 else None,
        "slip_rpm_mean": _mean(shifts.known("slip_rpm")),
        "reference_known": _mean(shifts.column("reference_known")),
        "reference_sources": {
            source: _mean(shifts.is_("reference_source", source)) for source in SOURCES
        },
        "by_gear": _by_gear(shots),
    }


def _promise(name: str, shots: Shots) -> dict[str, Any]:
    """None of a strategy that does not aim, whatever phase it was predicted to meet."""
    if is_blind(name):
        return {"shifts": 0, "said": None, "kept": None}
    said, kept = shots.promise()
    return {"shifts": said.size, "said": _mean(said), "kept": _mean(kept)}


def _over_minimum(shots: Shots) -> float | None:
    """Mean duration from the end of the torque ramp on over the mean bound, of the shifts that have
    a bound."""
    bound_ms, spent_ms = shots.shifts.column("bound_ms"), shots.after_ramp_ms()
    has = ~np.isnan(bound_ms) & ~np.isnan(spent_ms)
    if not has.any():
        return None
    # one after the other, as results have been summed that figures are compared with
    spent, bound = (float(np.add.accumulate(part[has])[-1]) for part in (spent_ms, bound_ms))
    return finite(spent / bound) if bound else None


def ratios(names: tuple[str, str], shots: dict[str, Shots], resamples: Resamples) -> dict[str, Any]:
    """The figures of the first strategy over the second's, on the same draws."""
    of, to = (shots[name] for name in names)

    def resampled(figure: str) -> Vector:
        with np.errstate(invalid="ignore", divide="ignore"):
            return resamples.of(names[0], figure) / resamples.of(names[1], figure)

    found = {}
    for name, figure in FIGURES.items():
        found[name] = _ratio(_mean(figure(of)[0]), _mean(figure(to)[0]), resampled(name))
    if any(telling_runs(shots.is_gap, shots.cluster) < FEW_RUNS for shots in (of, to)):
        found["first_contact_gap_rate"]["ci95"] = rate_ratio_interval(of.gap_rate(), to.gap_rate())
    a, b = of.durations()[0], to.durations()[0]
    if a.size and b.size:
        found[DURATION_P99] = _ratio(quantile(a, P99), quantile(b, P99), resampled(DURATION_P99))
    return found


DURATION_P99: Final = "duration_ms_p99"
FIGURES: Final[dict[str, Figure]] = {
    "first_contact_gap_rate": Shots.gaps,
    "duration_ms_mean": Shots.durations,
    "impact_j_mean": Shots.impacts,
}


def compare(shots: dict[str, Shots], resamples: Resamples) -> dict[str, Any]:
    """Every strategy over each one before it in the list, and over `true_state`."""
    names = list(shots)
    found: dict[str, Any] = {}
    for k, name in enumerate(names):
        others = names[:k] + ([TRUE_STATE] if TRUE_STATE in names else [])
        for other in others if name != TRUE_STATE else []:
            found[f"{name}/{other}"] = ratios((name, other), shots, resamples)
    return found


def summarise(shifts: Shifts, names: tuple[str, ...]) -> dict[str, Any]:
    """`strategies`, `ratios` and `verdict` for the shifts of one point of the sweep."""
    shots = by_strategy(shifts, names)
    resamples = Resamples(shots, max(1, np.unique(shifts.column("seed")).size))
    strategies = {name: strategy_figures(name, shot, resamples) for name, shot in shots.items()}
    ratios = compare(shots, resamples)
    return {"strategies": strategies, "ratios": ratios, "verdict": _verdict(strategies, ratios)}


MEANS: Final = (
    ("duration_ms", "duration_ms_mean", "time", "ms", 0),
    ("impact_j", "impact_j_mean", "impact", "J", 2),
)
"""Figures of which less is better: their names among a strategy's figures and among the ratios,
their word, unit and digits."""


def _verdict(strategies: dict[str, Any], ratios: dict[str, Any]) -> str:
    """Whether the strategy that is named last is better than the first: a sentence; empty where
    there are no two. Beyond chance is what the ratio's 95 % interval leaves out 1 of."""
    names = [name for name in strategies if name != TRUE_STATE]
    if len(names) < 2:
        return ""
    name, other = names[-1], names[0]
    mine, theirs, ratio = strategies[name], strategies[other], ratios[f"{name}/{other}"]
    gap, gap_theirs = mine["first_contact_gap"]["rate"], theirs["first_contact_gap"]["rate"]
    judged = []
    if gap is not None and gap_theirs is not None:
        values = f"{100 * gap:.1f} instead of {100 * gap_theirs:.1f} %"
        better = None if gap == gap_theirs else gap > gap_theirs
        beyond = _is_beyond(ratio["first_contact_gap_rate"])
        judged.append(Judged("first contact in a gap", values, better, beyond))
    for key, of_ratio, word, unit, digits in MEANS:
        a, b = mine[key]["mean"], theirs[key]["mean"]
        if a is not None and b is not None and (a or b):
            beyond = _is_beyond(ratio[of_ratio])
            judged.append(less_is_better(word, a, b, unit, digits, beyond))
    return sentence(named(name), named(other), mine["shifts"], judged)


def _is_beyond(ratio: dict[str, Any]) -> bool | None:
    low, high = ratio["ci95"]
    return None if low is None or high is None else not low <= 1.0 <= high


def curve_point(shifts: Shifts, names: tuple[str, ...]) -> dict[str, Any]:
    """What a curve needs at one point: rate with its interval, time and energy a strategy."""
    found = {}
    for name, shots in by_strategy(shifts, names).items():
        found[name] = {
            "shifts": len(shots.shifts),
            "first_contact_gap": _rate(shots.gap_rate()),
            "duration_ms_mean": _mean(shots.durations()[0]),
            "impact_j_mean": _mean(shots.impact_j),
        }
    return found


def _by_gear(shots: Shots) -> dict[str, Any]:
    found = {}
    for gear in sorted(map(str, shots.shifts.words_of("main_gear"))):
        chosen = shots.shifts.is_("main_gear", gear)
        found[gear] = {
            "ratio": finite(shots.shifts.column("ratio")[chosen][0]),
            "shifts": int(chosen.sum()),
            "first_contact_gap": _rate(shots.rate(shots.is_gap, chosen & shots.meets)),
            "impact_j_mean": _mean(shots.impact_j[chosen]),
        }
    return found


def _mean(values: np.ndarray[Any, Any]) -> float | None:
    return finite(values.mean()) if values.size else None


def _rate(rate: Rate) -> dict[str, Any]:
    return {"rate": finite(rate.share), "ci95": [finite(rate.low), finite(rate.high)]}


def _ratio(a: float | None, b: float | None, resampled: Vector) -> dict[str, Any]:
    value = None if a is None or not b else finite(a / b)
    return {"ratio": value, "ci95": interval(resampled)}
