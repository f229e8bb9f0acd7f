"""Which shafts turn together: within a hundredth, each by its own wheel, while all are seen."""

from __future__ import annotations

import pytest
from test_reported import SHEET, edge_frame

from meshpoint.controller.measure import inputs
from meshpoint.controller.measure.inputs import ShaftSpeedMeter, ShaftSpeeds, StepInputs
from meshpoint.dbc.messages import (
    EdgesInputRise,
    EdgesLayshaftRise,
    EdgesMainRise,
    EdgesPropellerRise,
)
from meshpoint.gearbox import MainGear, Range, Split

NOW_US = 5_000_000
INPUT, LAYSHAFT, MAIN, PROPELLER = (
    EdgesInputRise, EdgesLayshaftRise, EdgesMainRise, EdgesPropellerRise,
)  # fmt: skip
WHEELS = SHEET.wheels
TEETH: dict[type, int] = {
    INPUT: WHEELS.input_.teeth, LAYSHAFT: WHEELS.layshaft.teeth,
    MAIN: WHEELS.main.teeth, PROPELLER: WHEELS.propeller.teeth,
}  # fmt: skip


def seen(rad_s: dict[type, float], later_us: int = 0) -> ShaftSpeeds:
    """Speeds of these shafts at a read; how they look so much later."""
    heard, meter = StepInputs(), ShaftSpeedMeter(SHEET)
    for kind, speed in rad_s.items():
        heard.edges[kind].append(edge_frame(kind, speed, TEETH[kind], NOW_US))
    speeds = meter.take(heard, NOW_US)
    return meter.take(StepInputs(), NOW_US + later_us) if later_us else speeds


@pytest.mark.parametrize(("share", "is_together"), [(0.992, True), (1.008, True), (0.988, False),
                                                    (1.012, False)])  # fmt: skip
def test_a_step_is_in_mesh_where_its_shafts_have_its_ratio_within_a_hundredth(
    share: float, is_together: bool
) -> None:
    for split in Split:
        ratio = SHEET.split_mesh(split).ratio
        speeds = seen({INPUT: 120.0, LAYSHAFT: 120.0 * ratio * share})
        assert speeds.split_turns_together(split) is is_together
    for range_ in Range:
        ratio = SHEET.range_mesh(range_).ratio
        speeds = seen({MAIN: 90.0, PROPELLER: 90.0 * ratio * share})
        assert speeds.range_turns_together(range_) is is_together


@pytest.mark.parametrize("gone", [INPUT, LAYSHAFT, MAIN, PROPELLER])
def test_nothing_is_said_of_shafts_of_which_one_is_not_seen(gone: type) -> None:
    speeds = seen({kind: 100.0 for kind in TEETH if kind is not gone})
    for step in Split:
        assert not speeds.split_turns_together(step) or gone in (MAIN, PROPELLER)
    for step in Range:
        assert not speeds.range_turns_together(step) or gone in (INPUT, LAYSHAFT)
    assert (speeds.slip_rad_s(MainGear.FIRST) is None) is (gone in (LAYSHAFT, MAIN))


def test_a_second_wheel_of_a_shaft_speaks_where_the_first_does_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(inputs, "SHAFT_OF_WHEEL", (0, 1, 1, *inputs.SHAFT_OF_WHEEL[3:]))
    assert seen({MAIN: 88.0}).layshaft == pytest.approx(88.0, rel=1e-3)
    assert seen({MAIN: 88.0, LAYSHAFT: 141.0}).layshaft == pytest.approx(141.0, rel=1e-3)


def test_speeds_are_kept_for_a_read_and_stale_soon() -> None:
    given: dict[type, float] = {LAYSHAFT: 141.0, MAIN: 88.0}
    assert seen(given, 10_000).layshaft == pytest.approx(141.0, rel=1e-3)
    assert seen(given, 100_000).layshaft is seen(given, 100_000).main is None
