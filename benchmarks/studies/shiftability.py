"""Beyond the thesis: how probable it is that a gear engages, against what the teeth are like.

Published work on dog clutches gives shapes, no absolute curve: the probability rises with teeth,
axial speed and backlash, falls with slip and overlap (Aljawabrah and Lovas), falls again at very
low slip (Boka 2010), and an input side 10 to 50 rpm fast engages well (US 5,425,284).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final

import numpy as np

from benchmarks.studies.jobs import AsBuilt
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
)
from benchmarks.studies.teeth import Engagements, Tried
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.tables import count, quantity
from meshpoint.units import RPM

PATENT_RPM: Final = (10.0, 50.0)
BASE: Final = "as the data sheet"


@dataclass(frozen=True)
class Settings:
    """Slips, phases a slip, and what is varied around the base."""

    slowest_rad_s: float = quantity("slowest_rpm", 0.5, 500.0, RPM)
    fastest_rad_s: float = quantity("fastest_rpm", 0.5, 500.0, RPM)
    slips: int = count("slips", 3, 100)
    phases: int = count("phases", 10, 100_000)
    patience_s: float = quantity("patience_ms", 50.0, 10_000.0, 1e-3)
    """An engagement that takes longer has failed."""
    compared_rad_s: float = quantity("compared_rpm", 0.5, 500.0, RPM)
    """The slip at which the variants are compared."""
    speed_m_s: float = quantity("speed_m_s", 0.02, 2.0)
    """Axial speed of the base."""
    speed_factor: float = quantity("speed_factor", 1.01, 5.0)
    backlash_factor: float = quantity("backlash_factor", 1.01, 2.0)
    """At as many teeth: each gap is wider."""
    teeth_factor: float = quantity("teeth_factor", 1.01, 2.0)
    """At as wide a gap: there are more of them."""
    overlap_mm: float = quantity("overlap_mm", 0.1, 5.0)
    overlap_factor: float = quantity("overlap_factor", 1.01, 5.0)
    likely_share: float = quantity("likely_percent", 1.0, 100.0, 0.01)
    """A slip at which as many engage counts as good."""


def _slips(own: Settings) -> tuple[float, ...]:
    spaced = np.geomspace(own.slowest_rad_s, own.fastest_rad_s, own.slips).tolist()
    return tuple(sorted({*spaced, own.compared_rad_s}))


def _variants(given: Given[Settings]) -> dict[str, tuple[GearboxSheet, AsBuilt]]:
    own = given.own
    sheet = replace(given.sheet, sleeve=replace(given.sheet.sleeve, speed_m_s=own.speed_m_s))
    dog = sheet.dog
    wide = replace(dog, backlash_share=dog.backlash_share * own.backlash_factor)
    teeth = round(dog.teeth * own.teeth_factor)
    # the gap's angle stays: as many more of them make it a larger share of the pitch
    many = replace(dog, teeth=teeth, backlash_share=dog.backlash_share * teeth / dog.teeth)
    quick = replace(sheet.sleeve, speed_m_s=own.speed_m_s * own.speed_factor)
    base = _teeth(own.overlap_mm)
    return {
        BASE: (sheet, base),
        f"gap {own.backlash_factor:g} times as wide": (replace(sheet, dog=wide), base),
        f"{teeth} teeth, gap as wide": (replace(sheet, dog=many), base),
        f"sleeve {own.speed_factor:g} times as fast": (replace(sheet, sleeve=quick), base),
        f"overlap {own.overlap_factor:g} times": (
            sheet,
            _teeth(own.overlap_mm * own.overlap_factor),
        ),
    }


def _teeth(overlap_mm: float) -> AsBuilt:
    """A sleeve of constant axial speed, that of the sheet."""
    return (("dog.overlap_mm", overlap_mm), ("sleeve.model", 0.0))


def _jobs(given: Given[Settings]) -> tuple[Engagements, ...]:
    own = given.own
    return tuple(
        Engagements(sheet, changed, _slips(own), own.phases, 1e6 * own.patience_s)
        for sheet, changed in _variants(given).values()
    )


def _conclude(given: Given[Settings]) -> Finding:
    own = given.own
    tried: dict[str, dict[float, list[Tried]]] = {
        name: given.results[job] for name, job in zip(_variants(given), _jobs(given), strict=True)
    }
    slips = _slips(own)
    rpm = [slip / RPM for slip in slips]
    clean = {name: [_share(t[s], "clean") for s in slips] for name, t in tried.items()}
    engaged = {name: [_share(t[s], "locked") for s in slips] for name, t in tried.items()}
    compared = {name: values[slips.index(own.compared_rad_s)] for name, values in clean.items()}
    closed = [_closed_form(given.sheet, own, slip) for slip in slips]
    far = max(abs(a - b) for a, b in zip(closed, clean[BASE], strict=True))
    statements = (
        _signs(compared, own),
        _falls(clean[BASE], rpm),
        _low_slip(engaged[BASE], rpm),
        _good_slips(engaged[BASE], rpm, own),
    )
    values: dict[str, Any] = {
        "slip_rpm": rpm,
        "clean_first_pass": clean,
        "engaged": engaged,
        "clean_at_compared_slip": compared,
        "most_off_closed_form": far,
    }
    return Finding(statements, values, (_chart(rpm, clean, closed, engaged),))


def _share(tried: list[Tried], what: str) -> float:
    hits: int = sum(getattr(each, what) for each in tried)
    return hits / len(tried)


def _closed_form(sheet: GearboxSheet, own: Settings, slip: float) -> float:
    """P = max(0, b - |dw| x_ov / v) / p: the first pass without a flank's impact."""
    dog = sheet.dog
    moved = slip * own.overlap_mm * 1e-3 / own.speed_m_s
    return max(0.0, dog.backlash_rad - moved) / dog.pitch_rad


def _signs(compared: dict[str, float], own: Settings) -> Statement:
    base, wide, many, quick, overlap = compared.values()
    right = min(wide, many, quick) > base > overlap
    return Statement(
        "published: an engagement without impact is more probable with more teeth, a faster "
        "sleeve and more backlash, less with more overlap",
        f"at {own.compared_rad_s / RPM:.0f} rpm: "
        + ", ".join(f"{name} {100 * value:.1f} %" for name, value in compared.items()),
        ThesisVerdict.AGREES if right else ThesisVerdict.DIFFERS,
        "signs are compared, not sizes: no absolute curve is published. More teeth are taken at "
        "the same width of a gap; with the gap the same share of the pitch they would not help",
    )


def _falls(clean: list[float], rpm: list[float]) -> Statement:
    falls = all(later <= earlier + 1e-12 for earlier, later in pairwise(clean))
    return Statement(
        "published: it falls with slip",
        f"from {100 * clean[0]:.1f} % at {rpm[0]:.1f} rpm to {100 * clean[-1]:.1f} % at "
        f"{rpm[-1]:.0f} rpm",
        ThesisVerdict.AGREES if falls and clean[-1] < clean[0] else ThesisVerdict.DIFFERS,
        "while the sleeve moves through the overlap the tooth moves on toward the flank; phases "
        "are spread evenly, so by chance the gap's share of the pitch is the most",
    )


def _low_slip(engaged: list[float], rpm: list[float]) -> Statement:
    best = int(np.argmax(engaged))
    return Statement(
        "published and thesis 1.2: at too small a difference of speeds a gear may not engage at "
        "all, tooth on tooth",
        f"{100 * engaged[0]:.0f} % engage at {rpm[0]:.1f} rpm, {100 * engaged[best]:.0f} % at "
        f"{rpm[best]:.0f} rpm",
        ThesisVerdict.AGREES if engaged[0] < engaged[best] else ThesisVerdict.DIFFERS,
        "friction on the faces brings the two to rest before the tooth has slid off",
    )


def _good_slips(engaged: list[float], rpm: list[float], own: Settings) -> Statement:
    good = [r for r, share in zip(rpm, engaged, strict=True) if share >= own.likely_share]
    low, high = PATENT_RPM
    between = [r for r in good if low <= r <= high]
    ours = f"{min(good):.0f} to {max(good):.0f} rpm" if good else "no slip"
    return Statement(
        f"published: an input side {low:.0f} to {high:.0f} rpm fast engages well; thesis 1.2: too "
        "fast, and the teeth slide across each other",
        f"at least {100 * own.likely_share:g} % engage at {ours}; {100 * engaged[-1]:.0f} % at "
        f"{rpm[-1]:.0f} rpm",
        ThesisVerdict.AGREES if between else ThesisVerdict.DIFFERS,
        "agrees where the two ranges overlap; where ours begins and ends depends on friction, "
        "inertia and the time that is allowed",
    )


def _chart(
    rpm: list[float],
    clean: dict[str, list[float]],
    closed: list[float],
    engaged: dict[str, list[float]],
) -> Chart:
    def lines(shares: dict[str, list[float]]) -> tuple[Line, ...]:
        return tuple(
            Line(name, rpm, [100.0 * value for value in values], Style.JOINED)
            for name, values in shares.items()
        )

    limit = Line("base, closed form", rpm, [100.0 * v for v in closed], Style.DASHED)
    return Chart(
        "shiftability",
        "Probability of engagement by chance, phase spread evenly",
        "slip at contact, rpm",
        (
            Panel("first pass without impact, %", (*lines(clean), limit)),
            Panel("engaged in time, %", lines(engaged)),
        ),
        log_x=True,
    )


STUDY = Study(
    "shiftability", "Probability of engagement", ("section 1.2",), Settings, _conclude, _jobs
)
