"""A page to play with: fire the sleeve yourself, then let the controller do it."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Final

from meshpoint.base.errors import unwritten
from meshpoint.gearbox import GearboxSheet
from meshpoint.report.html import Page
from meshpoint.report.motion import geometry

TITLE: Final = "meshpoint: meet the gap"
SCRIPTS: Final = ("report/teeth.js", "run/play.js")
DIALS: Final = (
    # name, what it is, unit, least, most, step, value (None: of the data sheet)
    ("slip", "slip at the start", "rpm", 10.0, 120.0, 1.0, 60.0),
    ("slowing", "slip lost in a second", "rpm/s", 0.0, 200.0, 5.0, 40.0),
    ("gap", "gap, share of the pitch", "%", 5.0, 50.0, 1.0, None),
    ("delay", "from valve to contact", "ms", 5.0, 120.0, 1.0, None),
    ("scatter", "scatter of that delay (sd)", "ms", 0.0, 6.0, 0.1, None),
    ("slower", "slow motion", "x slower", 1.0, 100.0, 1.0, 20.0),
)


def write_play(path: Path, sheet: GearboxSheet) -> None:
    """Writes the page for a gearbox. CommandError or RunError where it cannot be written."""
    own = {
        "gap": 100.0 * sheet.dog.backlash_share,
        "delay": 1e3 * sheet.sleeve.delay_s,
        "scatter": 1e3 * sheet.sleeve.delay_sd_s,
    }
    body = [
        f"<h1>{escape(TITLE)}</h1>",
        "<p>The gear (below) turns past the sleeve (above), and the sleeve needs its delay to get "
        "there. Press <b>fire</b>, or the space bar, so that the tooth meets the gap.</p>",
        '<div id="teeth"></div><p id="words"></p>',
        '<div class="bar"><button id="fire">fire (space)</button>'
        '<button id="controller">let the controller fire</button>'
        '<button id="again">clear the score</button></div>',
        '<table id="score"><thead><tr><th></th><th class="number">fired</th>'
        '<th class="number">into the gap</th><th class="number">share</th></tr></thead>'
        "<tbody></tbody></table>",
        f'<div id="dials">{"".join(_dial(dial, own) for dial in DIALS)}</div>',
        f"<p>Gap, delay and scatter begin at those of the data sheet {escape(sheet.name)}.</p>",
        "<p>The controller here knows slip and phase exactly and aims at the middle of the next "
        "gap that its sleeve can reach; what is left is the scatter of the delay. The real one has "
        "to estimate both from tooth timestamps, and stops a sleeve on its way that would meet a "
        "tooth.</p>",
    ]
    text = Page(TITLE, body, {"geometry": geometry(sheet)}, "", SCRIPTS).text()
    try:
        path.write_text(text, encoding="utf-8", newline="\n")
    except OSError as error:
        raise unwritten(path, error) from error


def _dial(
    dial: tuple[str, str, str, float, float, float, float | None], own: dict[str, float]
) -> str:
    name, what, unit, least, most, step, value = dial
    at = own[name] if value is None else value
    return (
        f'<label>{escape(what)} <input type="range" id="{name}" min="{least:g}" max="{most:g}" '
        f'step="{step:g}" value="{at:g}"> <output id="{name}-value"></output> '
        f"{escape(unit)}</label>\n"
    )
