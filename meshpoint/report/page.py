"""A report as one HTML page: everything inside it, nothing fetched, every text escaped."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any, Final

from meshpoint.report.cause import cause
from meshpoint.report.comparison import (
    ShiftGroup,
    cells,
    compare,
    explain,
    headline,
    strategies_explained,
    verdict,
)
from meshpoint.report.html import (
    NUMBER_CLASS,
    STACKED,
    Cell,
    Page,
    definitions,
    table,
    table_row,
)
from meshpoint.report.overview import shift_key
from meshpoint.report.replayed import decisions_table, replayed_account
from meshpoint.report.run import (
    Report,
    ReportRun,
    account,
    figure,
    number_cell,
    shift_title,
)
from meshpoint.results.output import shown
from meshpoint.results.rows import ShiftRow


def page(report: Report, data: dict[str, Any], plotly_js: str) -> str:
    """The whole page; `data` is what its script draws, each shift read when it is opened."""
    shifts = sum(len(run.shifts) for run in report.runs)
    rows = {run.name: [shift.row for shift in run.shifts] for run in report.runs}
    groups = compare(rows)
    body = [
        f"<h1>{escape(report.title)}</h1>",
        f'<p class="headline">{escape(headline(groups, report.sheet, verdict(rows)))}</p>',
        f"<p>{escape(report.subtitle)}</p>",
        "<h2>Summary</h2>" if report.asked is None else "<h2>Summary of the log</h2>",
        _summary(groups, report),
    ]
    if shifts:
        heading = "<h2>Shifts</h2>" if report.asked is None else "<h2>Shifts as recorded</h2>"
        body += [decisions_table(report), _causes(report), OVERVIEW, heading]
        body += [_shifts(report.runs), VIEWER]
    else:
        body.append("<p>No shift to draw.</p>")
    body += [_notes(report.runs), "<h2>Provenance</h2>", definitions(report.provenance)]
    figures: dict[str, Any] = data["shifts"]
    common = {key: value for key, value in data.items() if key != "shifts"}
    common["shifts"] = list(figures)
    return Page(report.title, body, common, plotly_js, SCRIPTS, parts=figures).text()


SCRIPTS: Final = ("report/teeth.js", "report/slow_motion.js", "report/report.js")
FEW: Final = 30
"""Shifts below which a share is little more than its interval."""
OVERVIEW: Final = """<div class="overview">
<div><h3>Where the teeth met: one point a shift</h3><div id="contacts"></div></div>
<div><h3>Prediction against outcome, reference known</h3><div id="predictions"></div></div>
</div>"""
PARTS_WORDS: Final = (
    "Degrees from the middle of the gap. What a prediction was off by is the sum of its parts: "
    "each is what the truth about one belief changes, the others left as they were believed; the "
    "reference is the phase when it was planned, angles included."
)
VIEWER: Final = """<div class="bar"><h2 id="title"></h2>
<button id="before">← previous</button><button id="after">next →</button></div>
<p id="cause"></p>
<table id="account"><thead><tr><th></th><th class="number">predicted when fired</th>
<th class="number">seen by the controller</th><th class="number">rig's truth</th></tr></thead>
<tbody></tbody></table>
<div id="motion"><div class="bar"><button id="motion-play">▶ play</button>
<input type="range" id="motion-time" step="any" aria-label="time, ms">
<span>1/50 of its speed</span></div>
<div id="motion-teeth"></div><p id="motion-words"></p></div>
<div id="figure"></div>
<p>Above: the sleeve's teeth (blue) and the gear's, unrolled; the gear turns past the sleeve, the
sleeve moves in, and the tooth has to meet the gap. The line through the traces is the time shown.
Drag to zoom into a panel or along the time axis, double-click to see all. The arrow keys change
the shift. Phase counts on over the pitches, so every gap that goes by is a band; truth is the rig's
reference, which the controller never reads.</p>"""


def _causes(report: Report) -> str:
    """Every shift that missed its gap, aborted a firing or failed, with why; shifts of which the
    same is to be said together."""
    items = []
    for r, run in enumerate(report.runs):
        said: dict[str, list[str]] = {}
        for s, shift in enumerate(run.shifts):
            if why := cause(shift, report.sheet):
                link = f'<a href="#{shift_key(r, s)}">{s + 1}</a>'
                said.setdefault(why, []).append(link)
        of = f"{escape(shown(run.name))}, " if len(report.runs) > 1 else ""
        items += [
            f"<li>{of}shift{'s' * (len(links) > 1)} {', '.join(links)}: {escape(why)}</li>\n"
            for why, links in said.items()
        ]
    if not items:
        return ""
    return f"<h2>Missed or aborted, and why</h2>\n<ul>\n{''.join(items)}</ul>\n<p>{PARTS_WORDS}</p>"


def _notes(runs: list[ReportRun]) -> str:
    items = "".join(f"<li>{escape(note)}</li>\n" for run in runs for note in run.notes)
    return f"<h2>Estimates and log</h2>\n<ul>\n{items}</ul>" if items else ""


SUMMARY_HEAD: Final[list[Cell]] = [("shifts", ""), ("strategy", "")] + [
    (name, NUMBER_CLASS)
    for name in (
        "engaged", "into the gap", "95 % interval", "phase error RMS, deg", "mean duration, ms",
        "with an abort", "mean impact, J",
    )
]  # fmt: skip


def _summary(groups: list[ShiftGroup], report: Report) -> str:
    cells = [_summary_cells(group) for group in groups]
    rows = [f"<tr>{table_row(row, SUMMARY_HEAD)}</tr>\n" for row in cells]
    words = [*explain(groups, report.sheet), *_size(groups)]
    strategies = "".join(f"<li>{escape(line)}</li>\n" for line in strategies_explained(groups))
    return (
        f"{table(SUMMARY_HEAD, rows, STACKED)}\n<p>{escape(' '.join(words))}</p>"
        f"\n<ul>\n{strategies}</ul>"
    )


def _summary_cells(group: ShiftGroup) -> list[Cell]:
    impact = group.mean_impact_j
    figures = [*cells(group), "-" if impact is None else f"{impact:.2f}"]
    return [
        (group.kind, ""),
        (group.strategy, ""),
        *((cell, NUMBER_CLASS) for cell in (str(group.engaged), *figures)),
    ]


def _size(groups: Sequence[ShiftGroup]) -> list[str]:
    """Says so where the shifts are too few for a rate."""
    fewest = min((group.shifts for group in groups), default=0)
    if not groups or fewest >= FEW:
        return []
    return [f"Small sample: a row of fewer than {FEW} shifts is to be judged by its interval."]


SHIFT_HEAD: Final = [
    ("shift", ""), ("gears", ""), ("strategy", ""), ("reference", ""),
    ("contact", ""), ("phase error, % of pitch", NUMBER_CLASS), ("predicted ± sd, %", NUMBER_CLASS),
    ("slip, rpm", NUMBER_CLASS), ("valve to contact, ms", NUMBER_CLASS),
    ("duration, ms", NUMBER_CLASS), ("speed lost, km/h", NUMBER_CLASS),
    ("attempts", NUMBER_CLASS), ("aborts", NUMBER_CLASS), ("result", ""),
]  # fmt: skip


def _shifts(runs: list[ReportRun]) -> str:
    rows = []
    for r, run in enumerate(runs):
        if len(runs) > 1:
            span = len(SHIFT_HEAD)
            rows.append(f'<tr class="run"><th colspan="{span}">{escape(run.name)}</th></tr>\n')
        for s, shift in enumerate(run.shifts):
            key = shift_key(r, s)
            link = f'<td data-name="shift"><a href="#{key}">{s + 1}</a></td>'
            row = table_row(_shift_cells(shift.row), SHIFT_HEAD[1:])
            rows.append(f'<tr id="{key}">{link}{row}</tr>\n')
    return f'<div class="scroll">{table(SHIFT_HEAD, rows, STACKED)}</div>'


def _shift_cells(row: ShiftRow) -> list[Cell]:
    to_pct = 100 / row.pitch_deg
    predicted = "–"
    if row.predicted_phase_deg is not None and row.attempts:
        sd = to_pct * (row.predicted_phase_sd_deg or 0.0)
        predicted = f"{figure(to_pct * row.predicted_phase_deg, 1, True)} ± {sd:.1f}"
    result = row.result if row.fault == "none" else f"{row.result}: {row.fault}"
    return [
        (f"{row.from_} → {row.to}", ""),
        (row.strategy, ""),
        (row.reference, ""),
        (row.contact or "–", row.contact or ""),
        number_cell(row.phase_error_pct_of_pitch, 1, signed=True),
        (predicted, NUMBER_CLASS),
        number_cell(row.slip_rpm, 1, signed=True),
        number_cell(row.delay_ms, 1),
        number_cell(row.duration_ms, 0),
        number_cell(row.speed_lost_kmh, 1),
        (str(row.attempts), NUMBER_CLASS),
        (str(row.aborts), NUMBER_CLASS),
        (result, ""),
    ]


def shift_words(report: Report) -> dict[str, dict[str, Any]]:
    """Title and account of every shift by its key."""
    return {
        shift_key(r, s): {
            "title": shift_title(run.name, s + 1, shift),
            "cause": cause(shift, report.sheet) or "",
            "account": account(shift)
            + (replayed_account(shift.replayed, shift.row.pitch_deg) if shift.replayed else []),
        }
        for r, run in enumerate(report.runs)
        for s, shift in enumerate(run.shifts)
    }
