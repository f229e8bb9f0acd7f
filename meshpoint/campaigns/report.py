"""`report.html` of a campaign: its figures on one page that opens without a network."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

from meshpoint.base.errors import unwritten
from meshpoint.campaigns.figures import CURVES, frontier, gap_curve, phase_histogram
from meshpoint.campaigns.result import Collected
from meshpoint.campaigns.spec import CampaignSpec
from meshpoint.campaigns.summary import curve_point
from meshpoint.campaigns.sweep import BACKLASH, BASE_POINT, DELAY_SD
from meshpoint.campaigns.table import CELLS
from meshpoint.report.html import (
    NUMBER_CLASS,
    Cell,
    Page,
    definitions,
    table,
    table_row,
)
from meshpoint.results.shift_parts import TITLES as PART_TITLES

FEW_RUNS = 30
SWEPT_BY = {"backlash": BACKLASH, "scatter": DELAY_SD}
TITLES = {
    "phases": "Where the teeth met",
    "frontier": "Time against energy",
    "slip": "Over slip",
    "backlash": "Over backlash",
    "scatter": "Over the scatter of the delay",
}


def write_report(
    path: Path, spec: CampaignSpec, collected: Collected, values: dict[str, Any]
) -> None:
    """Writes the page. CommandError or RunError where it cannot be written."""
    from plotly.offline import get_plotlyjs

    title = f"meshpoint campaign: {values['runs']} runs"
    body = [
        f"<h1>{escape(title)}</h1>",
        f"<p>{escape(_subtitle(spec))}</p>",
        *_size(values["runs"]),
        f'<p class="headline">{escape(values["verdict"])}</p>' if values["verdict"] else "",
        "<h2>Strategies</h2>",
        _strategies(values),
        "<h2>Where the milliseconds go</h2>",
        "<p>Mean of each part over the shifts that have it, by the rig's truth.</p>",
        _parts(values),
        "<h2>Ratios on the same draws</h2>",
        _ratios(values),
        '<h2>Figures</h2>\n<div class="overview">',
        *(f'<div><h3>{escape(t)}</h3><div id="{name}"></div></div>' for name, t in TITLES.items()),
        "</div>",
        "<h2>Provenance</h2>",
        definitions({k: str(v) for k, v in spec.to_json()["provenance"].items()}),
    ]
    page = Page(title, body, figures(spec, collected), get_plotlyjs(), ["campaigns/report.js"])
    try:
        with path.open("w", encoding="utf-8", newline="\n") as file:
            file.writelines(page.pieces())
    except OSError as error:
        raise unwritten(path, error) from error


def figures(spec: CampaignSpec, collected: Collected) -> dict[str, Any]:
    """All figures by the name of their element."""
    names, base = spec.names, collected.at(BASE_POINT)
    points = [
        (str(point) if point != BASE_POINT else "as set", curve_point(collected.at(point), names))
        for point in (BASE_POINT, *spec.sweep)
    ]
    found = {
        "phases": phase_histogram(base, names, 100.0 * spec.sheet.dog.backlash_share),
        "frontier": frontier(points, names),
    }
    every = collected.shifts
    for name, (title, column) in CURVES.items():
        swept = every.where(every.is_("sweep", SWEPT_BY.get(name)))
        found[name] = gap_curve(swept if len(swept) else base, names, title, column)
    return found


def _subtitle(spec: CampaignSpec) -> str:
    return (
        f"Simulated in virtual time through encoded frames, preset {spec.preset.value}, "
        f"{spec.gearbox_words}; {spec.learn} learning and {spec.judged} judged shifts a run and "
        "strategy. Intervals are 95 %, with the run as what was drawn."
    )


def _size(runs: int) -> list[str]:
    """Says so where the runs are too few for a rate or a curve."""
    if runs >= FEW_RUNS:
        return []
    return [f"<p>Small sample: {runs} runs. Rates mean little beside their intervals.</p>"]


def _strategies(values: dict[str, Any]) -> str:
    """A column a strategy, a line a figure: there are more figures than a page is wide."""
    strategies = values["strategies"]
    head: list[Cell] = [("", ""), *((name, NUMBER_CLASS) for name in strategies)]
    rows = [
        _line(title, [cell(figures) for figures in strategies.values()])
        for title, cell in CELLS.items()
    ]
    return table(head, rows)


def _parts(values: dict[str, Any]) -> str:
    head: list[Cell] = [("strategy", ""), *((t, NUMBER_CLASS) for t in PART_TITLES.values())]
    rows = [
        _line(name, [_text(figure["phases_ms"][part], 1) for part in PART_TITLES])
        for name, figure in values["strategies"].items()
    ]
    return table(head, rows)


def _ratios(values: dict[str, Any]) -> str:
    keys = ("first_contact_gap_rate", "duration_ms_mean", "duration_ms_p99", "impact_j_mean")
    columns = ("gap rate", "mean duration", "p99 duration", "mean impact")
    head: list[Cell] = [("of / to", ""), *((name, NUMBER_CLASS) for name in columns)]
    rows = []
    for name, ratios in values["ratios"].items():
        found = [ratios.get(key, {"ratio": None, "ci95": [None, None]}) for key in keys]
        rows.append(_line(name, [_ratio(figure) for figure in found]))
    return table(head, rows)


def _line(name: str, cells: list[str]) -> str:
    return f"<tr>{table_row([(name, ''), *((cell, NUMBER_CLASS) for cell in cells)])}</tr>\n"


def _ratio(figure: dict[str, Any]) -> str:
    low, high = (_text(bound, 2) for bound in figure["ci95"])
    interval = "" if None in figure["ci95"] else f" ({low} to {high})"
    return _text(figure["ratio"], 2) + interval


def _text(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
