"""What a campaign's records come to: a figure a strategy, ratios between them, curves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from meshpoint.testbench.campaign.intervals import (
    FEW_RUNS,
    Bootstrap,
    Floats,
    Integers,
    Rate,
    finite,
    interval,
    quantile,
    rate_interval,
    rate_ratio_interval,
    telling_runs,
)
from meshpoint.testbench.campaign.record import JudgedShift
from meshpoint.testbench.campaign.spec import TRUE_STATE
from meshpoint.testbench.results.phases import PHASES
from meshpoint.testbench.results.rows import SOURCES

P99: Final = 0.99
Figure = Callable[["Shots"], tuple[Floats, Integers]]


class Shots:
    """The judged shifts of one strategy as arrays; `cluster` numbers their runs."""

    def __init__(self, records: list[JudgedShift], runs: dict[int, int]) -> None:
        self.records = records
        self.cluster: Integers = np.array([runs[r.seed] for r in records], dtype=np.int64)
        self.is_gap = np.array([r.is_gap for r in records], dtype=bool)
        self.impact_j: Floats = np.array([r.impact_j for r in records])
        self._durations = np.array(
            [np.nan if r.duration_ms is None else r.duration_ms for r in records]
        )

    def gaps(self) -> tuple[Floats, Integers]:
        """1 where the first contact was in a gap, and the runs."""
        return self.is_gap.astype(np.float64), self.cluster

    def gap_rate(self) -> Rate:
        """Share of first contacts in a gap, with its interval."""
        return (float(self.is_gap.mean()), *rate_interval(self.is_gap, self.cluster))

    def impacts(self) -> tuple[Floats, Integers]:
        """Loss in flank impacts, J, and the runs."""
        return self.impact_j, self.cluster

    def durations(self) -> tuple[Floats, Integers]:
        """From request to outcome, ms, of all shifts that came to an outcome, and the runs."""
        has = ~np.isnan(self._durations)
        return self._durations[has], self.cluster[has]

    def after_ramp_ms(self) -> Floats:
        """From the end of the torque ramp to outcome, ms, of all shifts that came to one. What the
        ramp takes is the driveline's, and the same for every strategy."""
        return np.array(
            [r.duration_ms - (r.ramp_ms or 0.0) for r in self.records if r.duration_ms is not None]
        )


def by_strategy(records: list[JudgedShift], names: tuple[str, ...]) -> dict[str, Shots]:
    """The records of one point of the sweep, by strategy."""
    seeds = sorted({record.seed for record in records})
    runs = {seed: number for number, seed in enumerate(seeds)}
    return {name: Shots([r for r in records if r.strategy == name], runs) for name in names}


def strategy_figures(shots: Shots, bootstrap: Bootstrap) -> dict[str, Any]:
    """The figures of one strategy; null where there is nothing to say."""
    records = shots.records
    durations, owners = shots.durations()
    after_ramp = shots.after_ramp_ms()
    errors = np.array([r.phase_error_deg for r in records if r.phase_error_deg is not None])
    low, high = rate_interval(shots.is_gap, shots.cluster)
    return {
        "shifts": len(records),
        "first_contact_gap": {
            "rate": _mean(shots.is_gap),
            "ci95": [finite(low), finite(high)],
        },
        "duration_ms": {
            "mean": _mean(durations),
            "mean_ci95": interval(bootstrap.means(durations, owners)),
            "p50": quantile(durations, 0.5) if durations.size else None,
            "p99": quantile(durations, P99) if durations.size else None,
            "p99_ci95": _quantile_interval(bootstrap, durations, owners),
        },
        "after_ramp_ms": {
            "mean": _mean(after_ramp),
            "p50": quantile(after_ramp, 0.5) if after_ramp.size else None,
            "p99": quantile(after_ramp, P99) if after_ramp.size else None,
        },
        "impact_j": {
            "mean": _mean(shots.impact_j),
            "mean_ci95": interval(bootstrap.means(*shots.impacts())),
            "p99": quantile(shots.impact_j, P99) if shots.impact_j.size else None,
        },
        "phases_ms": {
            name: _mean(np.array([at for r in records if (at := getattr(r, name)) is not None]))
            for name in PHASES
        },
        "bound_ms": _mean(np.array([r.bound_ms for r in records if r.bound_ms is not None])),
        "over_bound": _over_bound(records),
        "retries": sum(max(0, r.attempts - 1) for r in records),
        "blocked": sum(r.blocked for r in records),
        "thrown_back": sum(r.is_gap and r.ratchets > 0 for r in records),
        "ratchets": sum(r.ratchets for r in records),
        "given_up": sum(not r.engaged for r in records),
        "phase_error_mean_deg": finite(errors.mean()) if errors.size else None,
        "phase_error_sd_deg": finite(errors.std(ddof=1)) if errors.size > 1 else None,
        "slip_rpm_mean": _mean(np.array([r.slip_rpm for r in records if r.slip_rpm is not None])),
        "reference_known": _mean(np.array([r.reference_known for r in records])),
        "reference_sources": {
            source: _mean(np.array([r.reference_source == source for r in records]))
            for source in SOURCES
        },
        "by_gear": _by_gear(shots),
    }


def _over_bound(records: list[JudgedShift]) -> float | None:
    """Mean duration from the end of the torque ramp on over the mean bound, of the shifts that have
    a bound."""
    bounded = [
        (r.duration_ms - (r.ramp_ms or 0.0), r.bound_ms)
        for r in records
        if r.bound_ms is not None and r.duration_ms is not None
    ]
    spent, bound = (sum(part) for part in zip(*bounded, strict=True)) if bounded else (0.0, 0.0)
    return finite(spent / bound) if bound else None


def ratios(of: Shots, to: Shots, bootstrap: Bootstrap) -> dict[str, Any]:
    """One strategy's figures over another's, on the same draws."""
    found = {}
    for name, figure in FIGURES.items():
        (a, a_runs), (b, b_runs) = figure(of), figure(to)
        with np.errstate(invalid="ignore", divide="ignore"):
            resampled = bootstrap.means(a, a_runs) / bootstrap.means(b, b_runs)
        found[name] = _ratio(_mean(a), _mean(b), resampled)
    if any(telling_runs(shots.is_gap, shots.cluster) < FEW_RUNS for shots in (of, to)):
        found["first_contact_gap_rate"]["ci95"] = rate_ratio_interval(of.gap_rate(), to.gap_rate())
    (a, a_runs), (b, b_runs) = of.durations(), to.durations()
    if a.size and b.size:
        resampled = bootstrap.quantiles(a, a_runs, P99) / bootstrap.quantiles(b, b_runs, P99)
        found["duration_ms_p99"] = _ratio(quantile(a, P99), quantile(b, P99), resampled)
    return found


FIGURES: Final[dict[str, Figure]] = {
    "first_contact_gap_rate": Shots.gaps,
    "duration_ms_mean": Shots.durations,
    "impact_j_mean": Shots.impacts,
}


def compare(shots: dict[str, Shots], bootstrap: Bootstrap) -> dict[str, Any]:
    """Every strategy over each one before it in the list, and over `true_state`."""
    names = list(shots)
    found: dict[str, Any] = {}
    for k, name in enumerate(names):
        others = names[:k] + ([TRUE_STATE] if TRUE_STATE in names else [])
        for other in others if name != TRUE_STATE else []:
            found[f"{name}/{other}"] = ratios(shots[name], shots[other], bootstrap)
    return found


def summarise(records: list[JudgedShift], names: tuple[str, ...]) -> dict[str, Any]:
    """`strategies` and `ratios` for the records of one point of the sweep."""
    shots = by_strategy(records, names)
    bootstrap = Bootstrap(len({record.seed for record in records}))
    return {
        "strategies": {name: strategy_figures(shot, bootstrap) for name, shot in shots.items()},
        "ratios": compare(shots, bootstrap),
    }


def curve_point(records: list[JudgedShift], names: tuple[str, ...]) -> dict[str, Any]:
    """What a curve needs at one point: rate with its interval, time and energy a strategy."""
    found = {}
    for name, shots in by_strategy(records, names).items():
        low, high = rate_interval(shots.is_gap, shots.cluster)
        found[name] = {
            "shifts": len(shots.records),
            "first_contact_gap": {
                "rate": _mean(shots.is_gap),
                "ci95": [finite(low), finite(high)],
            },
            "duration_ms_mean": _mean(shots.durations()[0]),
            "impact_j_mean": _mean(shots.impact_j),
        }
    return found


def _by_gear(shots: Shots) -> dict[str, Any]:
    found = {}
    for gear in sorted({r.main_gear for r in shots.records}):
        chosen = np.array([r.main_gear == gear for r in shots.records])
        clusters = np.unique(shots.cluster[chosen], return_inverse=True)[1]
        low, high = rate_interval(shots.is_gap[chosen], clusters)
        found[gear] = {
            "ratio": finite(next(r.ratio for r in shots.records if r.main_gear == gear)),
            "shifts": int(chosen.sum()),
            "first_contact_gap": {
                "rate": _mean(shots.is_gap[chosen]),
                "ci95": [finite(low), finite(high)],
            },
            "impact_j_mean": _mean(shots.impact_j[chosen]),
        }
    return found


def _mean(values: np.ndarray[Any, Any]) -> float | None:
    return finite(values.mean()) if values.size else None


def _quantile_interval(
    bootstrap: Bootstrap, values: Floats, owners: Integers
) -> list[float | None]:
    return interval(bootstrap.quantiles(values, owners, P99)) if values.size else [None, None]


def _ratio(a: float | None, b: float | None, resampled: Floats) -> dict[str, Any]:
    value = None if a is None or not b else finite(a / b)
    return {"ratio": value, "ci95": interval(resampled)}
