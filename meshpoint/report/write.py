"""`report.html`: a run as one file that opens anywhere, without a network and without meshpoint."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Final

from meshpoint.base.errors import unwritten
from meshpoint.base.version import product_version
from meshpoint.controller.settings.header import RunHeader
from meshpoint.dbc import DBC_SHA256
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox import GearboxSheet
from meshpoint.report.beliefs import Beliefs
from meshpoint.report.collect import ReportCollector
from meshpoint.report.figures import shift_figure
from meshpoint.report.layout import common_layout
from meshpoint.report.motion import geometry
from meshpoint.report.overview import contacts_figure, predictions_figure, shift_key
from meshpoint.report.page import page, shift_words
from meshpoint.report.run import Report, ReportRun
from meshpoint.results.output import check_writable, folder_for, shown
from meshpoint.results.rows import is_aimed
from meshpoint.rig_sim.settings import Preset

REPLAYED_MARGIN: Final = 160
"""Left of the figures of a replay, px."""


def check_report(path: Path | None) -> None:
    """Finds out before a long run whether its report can be made. CommandError where it cannot."""
    if path is not None:
        check_writable(str(path))


def report_provenance(
    sheet: GearboxSheet,
    *,
    seed: int | None = None,
    preset: str | None = None,
    profile: str | None = None,
    **more: str,
) -> dict[str, str]:
    """What is needed to make the report's figures again. profile: of the preset truck."""
    of_truck = None if preset == Preset.THESIS else profile
    values = {"seed": seed, "preset": preset, "profile": of_truck}
    known = {key: str(value) for key, value in values.items() if value is not None}
    return {
        **known,
        "gearbox": sheet.name,
        "gearbox sha256": sheet.sha256,
        "DBC sha256": DBC_SHA256,
        "version": product_version(),
        **more,
    }


def gather(
    name: str,
    frames: Iterable[Frame],
    header: RunHeader,
    notes: list[str],
    beliefs: Beliefs | None = None,
) -> ReportRun:
    """A run from the frames of its bus; `beliefs`: of its controller."""
    collector = ReportCollector(header.sheet, aim_rad(header), header.settings, beliefs)
    for frame in frames:
        collector.receive(frame)
    return ReportRun(name, collector.finish(), notes)


def aim_rad(header: RunHeader) -> float:
    """The phase that the controller of this header aims at."""
    return header.settings.aim.target_rad(header.sheet.dog.backlash_rad)


def estimator_notes(name: str, figures: dict[str, Any]) -> list[str]:
    """What `EstimationScore.figures` says, in words."""
    return [
        f"{shown(name)}, estimator {estimator}: angle RMS {values['angle_rms_deg']:.3f} deg, "
        f"speed RMS {values['speed_rms_rpm']:.2f} rpm at the layshaft, from neutral to contact"
        for estimator, values in figures.items()
        if values["samples"]
    ]


def write_report(path: Path, report: Report) -> None:
    """Writes the page. CommandError or RunError where it cannot be written."""
    write_page(path, lambda plotly_js: page(report, report_data(report), plotly_js))


def write_page(path: Path, made: Callable[[str], str]) -> None:
    """Writes what is made with Plotly's script. CommandError or RunError where it cannot be
    written."""
    from plotly.offline import get_plotlyjs  # loading it takes longer than most commands

    text = made(get_plotlyjs())
    folder_for(path.parent)
    try:
        path.write_text(text, encoding="utf-8", newline="\n")
    except OSError as error:
        raise unwritten(path, error) from error


def report_data(report: Report) -> dict[str, Any]:
    """All figures, as the page's script draws them."""
    words = shift_words(report)
    figures = {
        shift_key(r, s): shift_figure(shift, report.sheet)
        for r, run in enumerate(report.runs)
        for s, shift in enumerate(run.shifts)
    }
    aimed = (
        shift_key(r, s)
        for r, run in enumerate(report.runs)
        for s, shift in enumerate(run.shifts)
        if is_aimed(shift.row)
    )
    overview = {}
    if figures:
        overview = {
            "contacts": contacts_figure(list(report.runs), report.sheet),
            "predictions": predictions_figure(list(report.runs), report.sheet),
        }
    common = common_layout(report.sheet)
    if report.asked is not None:
        common["margin"]["l"] = REPLAYED_MARGIN  # names of valves are longer
    return {
        "common": common,
        "overview": overview,
        "geometry": geometry(report.sheet),
        "shifts": {key: figure | words[key] for key, figure in figures.items()},
        "first": next(aimed, next(iter(figures), "")),
    }
