"""Edges of real sensors: no tooth lost that a sensor has shown, and the tenth edge ahead in time.

The captures are not part of the project; MESHPOINT_CAPTURES names their folder."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from meshpoint.testbench.logs.capture_files import read_capture
from meshpoint.testbench.logs.captures import CaptureRow, capture_row

FOLDER = Path(
    os.environ.get("MESHPOINT_CAPTURES", Path(__file__).parents[3] / "shared/data/captured_edges")
)
WHEELS = {
    "4b11-running.csv": "36-2-1",
    "cas_nissan_24_plus_1.csv": "24",
    "noisy-trigger-2.csv": "36-2",
    "trigger_adc_real1.csv": "60-2",
}
"""What is known of each sensor, or counted by hand in its file."""


@pytest.fixture(scope="module", params=WHEELS)
def row(request: pytest.FixtureRequest) -> CaptureRow:
    path = FOLDER / request.param
    if not path.exists():
        pytest.skip(f"{path} is not there; MESHPOINT_CAPTURES names the folder of captures")
    return capture_row(read_capture(path))


def test_the_wheel_is_found(row: CaptureRow) -> None:
    assert row.wheel == WHEELS[row.file]


def test_no_tooth_is_lost_while_the_wheel_turns(row: CaptureRow) -> None:
    """One of the engines is switched off and cranked again: that is a stop, and said to be one."""
    assert row.lost == row.stood == (1 if row.file == "noisy-trigger-2.csv" else 0)
    assert row.gaps >= 8
    assert row.gaps_wrong == 0
    assert row.numbered > 0.75 * row.edges


def test_no_edge_of_these_is_extra(row: CaptureRow) -> None:
    """Each turn has as many edges as the wheel has, the noisy one too."""
    assert row.extra_s == []


def test_the_pattern_tells_the_running_engine_s_tenth_edge(row: CaptureRow) -> None:
    if row.file != "4b11-running.csv":
        pytest.skip("speed and combustion repeat in the running engine alone")
    assert row.constant_speed_rms_us == pytest.approx(159.0, rel=0.02)
    assert row.ratio is not None
    assert row.ratio <= 0.45
