"""Which shafts turn together: within a hundredth, each by its own wheel, while all are seen."""

from __future__ import annotations

import pytest
from test_told import SHEET, edge_frame

from meshpoint.controller.sensing.shaft_speeds import ShaftSpeeds, _together
from meshpoint.controller.sensing.step_inputs import StepInputs
from meshpoint.dbc.messages import (
    EdgesInputRise,
    EdgesLayshaftRise,
    EdgesMainRise,
    EdgesPropellerRise,
)
from meshpoint.gearbox import MainGear, Range, Split
from meshpoint.gearbox.sheet import Wheel

NOW = 5_000_000
WHEELS: dict[type, Wheel] = {
    EdgesInputRise: SHEET.wheels.input_,
    EdgesLayshaftRise: SHEET.wheels.layshaft,
    EdgesMainRise: SHEET.wheels.main,
    EdgesPropellerRise: SHEET.wheels.propeller,
}


def seen(given: dict[type, float], later_us: int = 0) -> ShaftSpeeds:
    """Speeds of these shafts at a read; how they look so much later."""
    inputs = StepInputs()
    for kind, rad_s in given.items():
        inputs.edges[kind].append(edge_frame(kind, rad_s, WHEELS[kind].teeth, NOW))
    speeds = ShaftSpeeds(SHEET)
    speeds.take(inputs, NOW)
    if later_us:
        speeds.take(StepInputs(), NOW + later_us)
    return speeds


def test_nothing_turns_before_anything_was_seen() -> None:
    speeds = ShaftSpeeds(SHEET)
    assert (speeds.layshaft, speeds.main, speeds.propeller) == (None, None, None)
    assert speeds.slip_rad_s(MainGear.FIRST) is None
    assert not speeds.split_turns_together(Split.LOW)
    assert not speeds.range_turns_together(Range.LOW)


@pytest.mark.parametrize("gone", [EdgesLayshaftRise, EdgesMainRise])
def test_a_slip_needs_both_its_shafts(gone: type) -> None:
    given: dict[type, float] = {EdgesLayshaftRise: 141.0, EdgesMainRise: 88.0}
    del given[gone]
    assert seen(given).slip_rad_s(MainGear.FIRST) is None


@pytest.mark.parametrize(
    ("driving", "driven", "together"),
    [(100.0, 199.0, True), (100.0, 198.0, False), (100.0, 202.0, True), (100.0, 202.1, False),
     (None, 200.0, False), (100.0, None, False), (None, None, False), (0.0, 0.0, True)],
)  # fmt: skip
def test_shafts_turn_together_within_a_hundredth_of_the_driven_one_s_speed(
    driving: float | None, driven: float | None, together: bool
) -> None:
    """At a ratio of two."""
    assert _together(driving, driven, 2.0) is together


def test_a_hundredth_counts_itself() -> None:
    assert _together(50.5, 50.0, 1.0)
    assert _together(49.5, 50.0, 1.0)
    assert not _together(50.51, 50.0, 1.0)


@pytest.mark.parametrize("split", list(Split))
def test_a_splitter_step_is_in_mesh_where_the_layshaft_has_its_ratio(split: Split) -> None:
    ratio = SHEET.split_mesh(split).ratio
    speeds = seen({EdgesInputRise: 120.0, EdgesLayshaftRise: 120.0 * ratio})
    assert [speeds.split_turns_together(each) for each in Split] == [
        each is split for each in Split
    ]


@pytest.mark.parametrize("range_", list(Range))
def test_a_range_step_is_in_mesh_where_the_propeller_shaft_has_its_ratio(range_: Range) -> None:
    ratio = SHEET.range_mesh(range_).ratio
    speeds = seen({EdgesMainRise: 90.0, EdgesPropellerRise: 90.0 * ratio})
    assert [speeds.range_turns_together(each) for each in Range] == [
        each is range_ for each in Range
    ]


def test_speeds_are_kept_for_a_read_and_stale_soon() -> None:
    given: dict[type, float] = {EdgesLayshaftRise: 141.0, EdgesMainRise: 88.0}
    assert seen(given, 10_000).layshaft == pytest.approx(141.0, rel=1e-3)
    stale = seen(given, 100_000)
    assert (stale.layshaft, stale.main) == (None, None)


def test_a_slip_is_how_much_faster_the_gear_is_than_its_sleeve() -> None:
    speeds = seen({EdgesLayshaftRise: 141.0, EdgesMainRise: 88.0})
    layshaft, main = speeds.layshaft, speeds.main
    assert layshaft is not None and main is not None
    ratio = SHEET.main_mesh(MainGear.SECOND).ratio
    assert speeds.slip_rad_s(MainGear.SECOND) == pytest.approx(ratio * layshaft - main)
