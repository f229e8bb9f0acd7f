"""Air for the brake while the old gear's sleeve is on its way: when it is switched, by sleeves
whose way and speed are laid down, and when it is taken back."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from test_synchronise_exactly import BRAKE, EARLIEST_US, LIMITS, MS, NOW_US, SHEET, TARGET, Step

from meshpoint.controller.sensing.gearbox_view import SleeveTrack
from meshpoint.controller.shift import brake_ahead as module
from meshpoint.controller.shift.brake_ahead import _is_wanted, _leaves, _teeth_out_us, brake_ahead
from meshpoint.controller.shift.valve_board import OFF
from meshpoint.gearbox import Range, Sleeve, Split

SLEEVE = SHEET.sleeve
NEWEST_US = NOW_US - 2 * MS
WAY_M = SLEEVE.stroke_m - SLEEVE.to_contact_m + 1e-3
"""Until the teeth are a millimetre apart."""
TICK_US = 10 * MS
LEAST_US = round(1e6 * SHEET.brake.valve_delay_s * (1.0 - SHEET.brake.valve_delay_tolerance))


def going(come_m: float, speed_m_s: float, side: int = 1, third: bool = False) -> dict[Any, Any]:
    """A sleeve that has come so far from its end, and moves evenly; the other stands in neutral."""
    samples = [side * (SLEEVE.stroke_m - come_m + 1e-3 * k * speed_m_s) for k in range(10)]
    track, still = SleeveTrack(NEWEST_US, tuple(samples)), SleeveTrack(NOW_US, (1e-4,) * 10)
    names = (Sleeve.FIRST_SECOND, Sleeve.CRAWL_THIRD)
    return dict(zip(names, (still, track) if third else (track, still), strict=True))


class Leaving(Step):
    """A shift whose old gear is on its way out."""

    def __init__(self, tracks: dict[Any, Any] | None = None) -> None:
        super().__init__()
        view = self.snapshot.view
        view.tracks = tracks or going(2e-3, 0.4)
        view.split, view.range_ = TARGET.split, TARGET.range_
        self.slip: float | None = 90.0
        self.snapshot.speeds = SimpleNamespace(layshaft=150.0, slip_rad_s=lambda _: self.slip)
        self.snapshot.layshaft = SimpleNamespace(drag_nm=lambda omega: 0.02 * omega)

    def out_us(self) -> float | None:
        return _teeth_out_us(self.context, self.snapshot)

    def look(self) -> None:
        brake_ahead(self.context, self.snapshot)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("third", [False, True])
@pytest.mark.parametrize(("come_m", "speed"), [(2e-3, 0.4), (3e-3, 0.3), (0.9e-3, 0.2)])
def test_a_sleeve_under_a_constant_force_is_out_when_it_has_come_its_way(
    come_m: float, speed: float, third: bool, side: int
) -> None:
    """Its speed of 3 ms is that of their middle: with a = v^2 / 2 s there, and s = a t^2 / 2."""
    middle_m = come_m - 1.5e-3 * speed
    a = speed**2 / (2.0 * middle_m)
    since_s, out_s = speed / a, math.sqrt(2.0 * WAY_M / a)
    expected = NEWEST_US - 1_500 + 1e6 * (out_s - since_s)
    assert Leaving(going(come_m, speed, side, third)).out_us() == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(
    ("come_m", "speed", "told"),
    [(0.59e-3, 0.2, False), (0.61e-3, 0.2, True), (2e-3, 0.0, False), (2e-3, -0.1, False),
     (0.7e-3, 0.5, False), (WAY_M, 0.0, True), (WAY_M + 1e-4, -0.1, True)],
)  # fmt: skip
def test_nothing_is_told_of_a_sleeve_that_stands_or_has_hardly_moved(
    come_m: float, speed: float, told: bool
) -> None:
    """Six tenths of a millimetre are noise; one that has come all its way is out."""
    found = Leaving(going(come_m, speed)).out_us()
    assert (found is not None) is told
    if come_m >= WAY_M:
        assert found == NEWEST_US


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(
    ("come_m", "speed", "leaves"),
    [(0.59e-3, 0.2, False), (2e-3, 0.1, True), (2e-3, 0.0, False), (2e-3, -0.1, False),
     (WAY_M + 1e-5, -0.1, True), (WAY_M - 1e-5, -0.1, False)],
)  # fmt: skip
def test_a_sleeve_leaves_while_it_moves_or_once_it_is_out(
    come_m: float, speed: float, leaves: bool, side: int
) -> None:
    step = Leaving(going(come_m, speed, side))
    assert _leaves(step.context, step.snapshot) is leaves


@pytest.mark.parametrize(
    ("change", "wanted"),
    [("none", True), ("split", False), ("range", False), ("no slip", False),
     ("no speed", False), ("used up", False), ("one use left", True), ("slow", False),
     ("blocked by the guard", False)],
)  # fmt: skip
def test_air_is_wanted_for_a_gear_too_fast_for_drag_alone_and_where_no_other_step_changes(
    change: str, wanted: bool
) -> None:
    step = Leaving()
    view, speeds = step.snapshot.view, step.snapshot.speeds
    if change == "split":
        view.split = Split.LOW if TARGET.split is Split.HIGH else Split.HIGH
    if change == "range":
        view.range_ = Range.LOW if TARGET.range_ is Range.HIGH else Range.HIGH
    if change == "blocked by the guard":
        step.shift.blocks = 1
    if change == "no slip":
        step.slip = None
    if change == "no speed":
        speeds.layshaft = None
    step.shift.pulses = LIMITS.pulses - {"used up": 0, "one use left": 1}.get(change, LIMITS.pulses)
    if change == "slow":
        step.slip = 5.0
    assert _is_wanted(step.context, step.snapshot) is wanted


@pytest.mark.parametrize(("off", "wanted"), [(1e-3, True), (-1e-3, False)])
def test_drag_alone_takes_too_long_where_it_takes_less_than_is_to_fall(
    off: float, wanted: bool
) -> None:
    """In `limits.coast_ms`, by drag over inertia, as the gear's ratio has it."""
    step = Leaving()
    fall = SHEET.main_mesh(TARGET.main).ratio * 0.02 * 150.0 / SHEET.inertia_kgm2(TARGET.split)
    fire = step.context.settings.window.fire_slip_rad_s
    step.slip = fire + fall * 1e-3 * LIMITS.coast_ms + off
    assert _is_wanted(step.context, step.snapshot) is wanted


def laid(
    step: Leaving, monkeypatch: pytest.MonkeyPatch, out_us: float | None, leaves: bool = True,
    wanted: bool = True,
) -> Leaving:  # fmt: skip
    monkeypatch.setattr(module, "_teeth_out_us", lambda *_: out_us)
    monkeypatch.setattr(module, "_leaves", lambda *_: leaves)
    monkeypatch.setattr(module, "_is_wanted", lambda *_: wanted)
    return step


@pytest.mark.parametrize(
    ("out_in_us", "on_in_us"),
    [(LEAST_US, 0), (LEAST_US - 5_000, 0), (LEAST_US + 3_000, 3_000),
     (LEAST_US + TICK_US - 1, TICK_US - 1), (LEAST_US + TICK_US, None)],
)  # fmt: skip
def test_the_valve_is_switched_its_least_delay_before_the_teeth_are_out(
    out_in_us: int, on_in_us: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not sooner than can be commanded, and left to the next step where that is soon enough."""
    step = laid(Leaving(), monkeypatch, EARLIEST_US + out_in_us + 0.3)
    step.context.brake.set_delays(12 * MS, LEAST_US + 2_000)
    step.look()
    expected = OFF if on_in_us is None else (EARLIEST_US + on_in_us, True, False)
    assert step.command(BRAKE) == expected
    switches = [] if on_in_us is None else [(EARLIEST_US + on_in_us, True)]
    assert step.context.brake.switches == switches
    assert step.shift.pulses == (on_in_us is not None)


def test_a_valve_that_was_learned_to_be_faster_still_is_switched_later(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    step = laid(Leaving(), monkeypatch, EARLIEST_US + 9_000.0)
    step.context.brake.set_delays(12 * MS, 2_000)
    step.look()
    assert step.command(BRAKE) == (EARLIEST_US + 7_000, True, False)


def commanded(at_us: int) -> Leaving:
    step = Leaving()
    step.context.switch_brake(True, at_us, step.snapshot)
    step.shift.pulses = 1
    return step


def test_a_switch_still_to_come_is_moved_with_the_sleeve(monkeypatch: pytest.MonkeyPatch) -> None:
    """That is no further use of the brake."""
    step = laid(commanded(EARLIEST_US + 1), monkeypatch, EARLIEST_US + LEAST_US + 4_000.0, False)
    step.context.brake.set_delays(12 * MS, LEAST_US)
    step.look()
    assert step.command(BRAKE) == (EARLIEST_US + 4_000, True, False)
    assert step.shift.pulses == 1


@pytest.mark.parametrize("reason", ["not told", "not wanted"])
@pytest.mark.parametrize("pending", [True, False])
def test_a_switch_still_to_come_is_taken_back_where_nothing_is_wanted_any_more(
    reason: str, pending: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    step = commanded(EARLIEST_US + 1) if pending else Leaving()
    out_us = None if reason == "not told" else EARLIEST_US + 1.0
    laid(step, monkeypatch, out_us, wanted=reason == "not told").look()
    assert step.command(BRAKE) == OFF
    assert step.shift.pulses == 0
    assert step.context.brake.switches in ([], [(NOW_US, False)])


@pytest.mark.parametrize("leaves", [True, False])
def test_a_switch_that_can_no_longer_be_moved_is_taken_back_from_a_sleeve_that_stays(
    leaves: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    step = laid(commanded(EARLIEST_US), monkeypatch, None, leaves, wanted=False)
    step.context.brake.schedule(NOW_US - 5 * MS, True, NOW_US - 9 * MS)
    step.look()
    assert (step.command(BRAKE) == OFF) is not leaves
    assert step.shift.pulses == leaves
    if not leaves:
        assert step.context.brake.switches[-1] == (NOW_US, False)
