"""Pictures, tables and the page's charts of a study."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given as drawn
from hypothesis import strategies as st

from benchmarks.studies.draw import log_ticks, write_files
from benchmarks.studies.page import plotly_figure
from benchmarks.studies.record import Chart, Finding, Line, Panel, Table


def test_studies_whose_chart_and_table_would_share_a_file_are_refused(tmp_path: Path) -> None:
    finding = Finding((), {}, (Chart("same", "", "", ()),), (Table("same", "", (), ()),))
    with pytest.raises(ValueError, match="share a name"):
        write_files(finding, tmp_path)


def test_a_line_has_one_colour_in_all_panels_of_page_and_picture() -> None:
    one, two = (Panel("", tuple(Line(name, [1.0], [1.0]) for name in names)) for names in
                (("real", "model"), ("model",)))  # fmt: skip
    real, first, second = plotly_figure(Chart("", "", "", (one, two)))["data"]
    assert first["line"]["color"] == second["line"]["color"] != real["line"]["color"]
    assert [trace["legend"] for trace in (real, first, second)] == ["legend", "legend", "legend2"]


@drawn(low=st.floats(1e-6, 1e6), ratio=st.floats(3.0, 1e8))
def test_a_logarithmic_axis_has_round_ticks_within_its_range(low: float, ratio: float) -> None:
    ticks = log_ticks(low, low * ratio)
    assert 1 <= len(ticks) <= 15
    assert ticks == sorted(set(ticks))
    assert ticks[0] >= 0.8 * low
    assert ticks[-1] <= 1.25 * low * ratio
