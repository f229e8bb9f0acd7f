"""Edges of real sensors: no tooth lost that a sensor has shown, and the tenth edge ahead in time.

The captures are not part of the project; MESHPOINT_CAPTURES names their folder."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from meshpoint.logs.capture_files import Columns, read_columns
from meshpoint.logs.capture_ways import Asked, choose
from meshpoint.logs.captures import CaptureRow

pytestmark = pytest.mark.device
FOLDER = os.environ.get("MESHPOINT_CAPTURES")
WHEELS = {
    "4b11-running.csv": "36-2-1",
    "cas_nissan_24_plus_1.csv": "24",
    "noisy-trigger-2.csv": "36-2",
    "trigger_adc_real1.csv": "60-2",
}
"""What is known of each sensor, or counted by hand in its file."""


def capture(name: str) -> Columns:
    if FOLDER is None:
        pytest.skip("no captured edges: MESHPOINT_CAPTURES names their folder")
    return read_columns(Path(FOLDER) / name)


@pytest.fixture(scope="module", params=WHEELS)
def row(request: pytest.FixtureRequest) -> CaptureRow:
    return choose(capture(request.param), Asked()).row()


def test_the_wheel_is_found(row: CaptureRow) -> None:
    assert row.wheel == WHEELS[row.file]


def test_no_tooth_is_lost_while_the_wheel_turns(row: CaptureRow) -> None:
    """One of the engines is switched off and cranked again: that is a stop, and said to be one."""
    assert row.lost == row.stood == (1 if row.file == "noisy-trigger-2.csv" else 0)
    assert row.gaps >= 8
    assert row.gaps_wrong == 0
    assert row.wrong == 0
    assert row.checked > 0.8 * row.numbered
    assert row.numbered > 0.75 * row.edges


def test_no_edge_of_these_is_extra(row: CaptureRow) -> None:
    """Each turn has as many edges as the wheel has, the noisy one too."""
    assert row.extra_s == []


@pytest.mark.parametrize("row", ["4b11-running.csv"], indirect=True)
def test_the_pattern_tells_the_running_engine_s_tenth_edge(row: CaptureRow) -> None:
    """Speed and combustion repeat in the running engine alone."""
    assert row.constant_speed_rms_us == pytest.approx(159.0, rel=0.02)
    assert row.ratio is not None
    assert row.ratio <= 0.45


def test_the_prediction_in_use_is_about_the_best_of_the_simple_ones(row: CaptureRow) -> None:
    assert row.learned_rms_us is not None
    assert row.constant_speed_rms_us is not None
    assert row.turn_ago_rms_us is not None
    simple = min(row.constant_speed_rms_us, row.turn_ago_rms_us)
    assert row.learned_rms_us <= 1.05 * simple


@pytest.mark.parametrize("polarity", ["rising", "falling", "inverted"])
@pytest.mark.parametrize("name", WHEELS)
def test_each_capture_in_other_polarities(name: str, polarity: str) -> None:
    """Levels exchanged, or one polarity alone. Of the voltage, both edges make no wheel: the
    rising ones of its gap lie anywhere in it."""
    columns, asked = capture(name), polarity or None
    if name == "trigger_adc_real1.csv" and polarity == "inverted":
        columns = Columns(name, columns.time_s, columns.titles, -columns.values)
        asked = None
    row = choose(columns, Asked(polarity=asked)).row()
    assert row.wrong == row.gaps_wrong == 0
    assert row.lost <= 1
    assert row.checked > 0.8 * row.numbered
    assert row.numbered > (0.7 if name == "noisy-trigger-2.csv" else 0.89) * row.edges
    simple = min(row.constant_speed_rms_us or 0.0, row.turn_ago_rms_us or 0.0)
    assert 0.0 < (row.learned_rms_us or 0.0) <= 1.05 * simple
