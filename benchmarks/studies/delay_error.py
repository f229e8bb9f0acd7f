"""Figure 6.11: what an error of the sleeve's delay costs, by slip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.studies.record import (
    Chart,
    Finding,
    Given,
    Line,
    Panel,
    Statement,
    Study,
    Table,
    ThesisVerdict,
)
from benchmarks.studies.sensitivity import Release
from meshpoint.gearbox.tables import count, quantity
from meshpoint.kernels.records import Vector
from meshpoint.units import DEG, RPM

LOW_PCT, HIGH_PCT = 4.0, 16.0


@dataclass(frozen=True)
class Settings:
    """Slips at nominal contact, delay errors, and how near the thesis's figures must be."""

    slip_low_rad_s: float = quantity("slip_low_rpm", 1.0, 200.0, RPM)
    slip_high_rad_s: float = quantity("slip_high_rpm", 1.0, 200.0, RPM)
    slips: int = count("slips", 2, 20)
    widest_s: float = quantity("widest_ms", 1.0, 40.0, 1e-3)
    compared_s: float = quantity("compared_ms", 1.0, 40.0, 1e-3)
    points: int = count("points", 3, 1000)
    tolerance_share: float = quantity("tolerance_percent", 0.1, 100.0, 0.01)


def _conclude(given: Given[Settings]) -> Finding:
    own, release = given.own, Release(given)
    slips = np.linspace(own.slip_low_rad_s, own.slip_high_rad_s, own.slips)
    errors_s = np.linspace(-own.widest_s, own.widest_s, own.points)
    drawn = {slip: _effects(release, slip, errors_s) for slip in slips.tolist()}
    compared = np.array([-own.compared_s, own.compared_s])
    at = {slip: np.abs(_effects(release, slip, compared)) for slip in slips.tolist()}
    low, high = (float(np.mean(at[slip])) for slip in (slips[0], slips[-1]))
    chart = Chart(
        "delay_error",
        "Angle between layshaft and main shaft against its value at 45 ms",
        "error of the delay, ms",
        (
            Panel(
                "% of pitch at the layshaft",
                tuple(
                    Line(f"{slip / RPM:.0f} rpm at 45 ms", 1e3 * errors_s, values)
                    for slip, values in drawn.items()
                ),
            ),
        ),
    )
    ms = 1e3 * own.compared_s
    rows = tuple((slip / RPM, float(v[0]), float(v[1])) for slip, v in at.items())
    columns = ("slip at contact, rpm", f"-{ms:g} ms, % of pitch", f"+{ms:g} ms, % of pitch")
    values = {
        "mean_at_lowest_slip_percent_of_pitch": low,
        "mean_at_highest_slip_percent_of_pitch": high,
        "by_slip_rpm": {f"{row[0]:.0f}": {"early": row[1], "late": row[2]} for row in rows},
    }
    table = Table("slips", "By slip", columns, rows)
    statements = (_size(low, high, given), _sides(at))
    return Finding(statements, values, (chart,), (table,))


def _effects(release: Release, slip_rad_s: float, errors_s: Vector) -> Vector:
    """Angle of the layshaft against the main shaft, as felt at the layshaft, less that at the
    nominal contact; the main shaft turns so that the slip is `slip_rad_s` there (4.16)."""
    nominal = release.after(release.delay_s)
    main_rad_s = nominal.omega_rad_s - slip_rad_s
    angles = [
        release.after(release.delay_s + error).theta_rad - nominal.theta_rad - main_rad_s * error
        for error in errors_s.tolist()
    ]
    return 100.0 * np.array(angles) / release.sheet.dog.pitch_rad


def _size(low: float, high: float, given: Given[Settings]) -> Statement:
    own, dog = given.own, given.sheet.dog
    near = all(
        abs(ours - theirs) <= own.tolerance_share * theirs
        for ours, theirs in ((low, LOW_PCT), (high, HIGH_PCT))
    )
    slips = f"{own.slip_low_rad_s / RPM:g} to {own.slip_high_rad_s / RPM:g} rpm"
    return Statement(
        f"+-5 ms costs around {LOW_PCT:g} to {HIGH_PCT:g} % of a cog gap, by the slip used (6.4.3)",
        f"{low:.1f} to {high:.1f} % at {slips}, the mean of early and late",
        ThesisVerdict.BY_CONSTRUCTION if near else ThesisVerdict.DIFFERS,
        f"within {100 * own.tolerance_share:g} %; the mean of both sides is slip times 5 ms "
        f"over the pitch (here {dog.pitch_rad / DEG:g} deg, {dog.teeth} teeth). The thesis does "
        "not give the slips of its curves: chosen ones, and the sheet `thesis` has its pitch "
        "from the figures with them, so this shows consistency and is no witness",
    )


def _sides(at: dict[float, Vector]) -> Statement:
    larger_early = all(values[0] > values[1] for values in at.values())
    worst = max(float(values[0] - values[1]) for values in at.values())
    return Statement(
        "errors are larger for delays that are shorter than expected",
        f"early costs up to {worst:.1f} % of pitch more than late",
        ThesisVerdict.AGREES if larger_early else ThesisVerdict.DIFFERS,
        "the brake still dies away, so the slip was larger before the nominal contact than it is "
        "after it",
    )


STUDY = Study("delay_error", "Sensitivity: sleeve delay", ("figure 6.11",), Settings, _conclude)
