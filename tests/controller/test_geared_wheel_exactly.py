"""A wheel that is geared to an estimated shaft, by hand: what its edges count as, and when what is
known of the offset is let go."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from meshpoint.controller.estimation.crossing_filter import NO_PRESSURES
from meshpoint.controller.estimation.geared_wheel import GearedWheel
from meshpoint.controller.sensing.wheel_edges import NO_EDGES, EdgeBatch
from meshpoint.controller.settings import CrossingFilterTuning
from meshpoint.gearbox.sheet import Wheel

TUNING = CrossingFilterTuning()
OFF = np.empty((2, 0))
BATCH = EdgeBatch(np.array([1e3, 2e3]), np.array([0.5, 0.7]), np.array([3, 4]), np.array([0, 1]))


class Shaft:
    """An estimated shaft that is asked for its offset."""

    def __init__(self, offset: tuple[float, float] | None = None) -> None:
        self.lost, self.offset = 0, offset
        self.x, self.time_us = np.array([2.0, 60.0]), 7e3

    def lose_offset(self) -> None:
        self.lost += 1


def a_wheel(scale: float | None = 0.4) -> Any:
    wheel = GearedWheel("input shaft", Wheel(45, 0.5), TUNING)
    wheel.set_ratio(scale, False)
    wheel._batch = BATCH
    return wheel


def test_edges_count_as_the_shaft_s_by_the_ratio_and_so_does_how_sure_they_are() -> None:
    wheel, shaft = a_wheel(), Shaft()
    found = wheel.edges_for(shaft)
    assert found is not None
    assert found.edges.tolist() == [[1e3, 2e3], pytest.approx([0.2, 0.28])]
    assert found.sd_rad == pytest.approx(0.4 * TUNING.tooth_error_rad)
    wheel._batch = NO_EDGES
    assert wheel.edges_for(shaft) is None
    assert a_wheel(None).edges_for(shaft) is None


def test_the_offset_is_let_go_once_where_the_ratio_is_another() -> None:
    """And at the beginning. A ratio that is told again is none."""
    wheel, shaft = a_wheel(), Shaft()
    dragged: list[bool] = []
    wheel._edges.set_dragged = dragged.append
    for scale, lost in ((0.4, 1), (0.4, 1), (0.5, 2), (None, 3), (None, 3), (0.5, 4)):
        wheel.set_ratio(scale, lost == 3)
        wheel.edges_for(shaft)
        assert shaft.lost == lost
    assert dragged == [False, False, False, True, True, False]


@pytest.mark.parametrize("broken", [False, True])
def test_edges_that_were_lost_lose_the_teeth_s_numbers_and_the_offset(broken: bool) -> None:
    wheel, shaft, lost = a_wheel(), Shaft(), []
    wheel.edges_for(shaft)
    wheel.teeth.lose_numbers = lambda: lost.append(True)
    wheel._edges = SimpleNamespace(read=lambda *given: given, broken=int(broken))
    for _ in range(2):
        wheel.read("rise", "fall", "clock", 5)
        assert wheel._batch == ("rise", "fall", "clock", 5)
        assert len(lost) == int(broken)
    wheel._batch = BATCH
    wheel.edges_for(shaft)
    assert shaft.lost == 1 + int(broken)


def test_its_teeth_are_learned_from_where_the_offset_is_known() -> None:
    """The window begins with the shaft's angle and the offset."""
    wheel, begun, taken = a_wheel(), [], []
    learner, start_p, model = wheel.teeth.learner, np.eye(2), object()
    learner.begin = lambda *given: begun.append(given)
    learner.take = lambda *given: taken.append(given)
    given = start_p, NO_PRESSURES, OFF, model
    wheel.learn(Shaft(), *given)
    assert not begun
    shaft = Shaft((0.3, 0.01))
    wheel.learn(shaft, *given)
    ((time_us, x, p),) = begun
    assert (time_us, x.tolist(), p is start_p) == (7e3, [2.3, 60.0], True)
    assert shaft.x[0] == 2.0
    learner.running = True
    wheel.learn(shaft, *given)
    ((batch, place, pressures, switches, by, scale),) = taken
    assert place.tolist() == [6, 9]
    assert batch is BATCH and pressures is NO_PRESSURES and switches is OFF and by is model
    assert scale == 0.4
    wheel.set_ratio(None, False)
    wheel.learn(shaft, *given)
    assert (len(begun), len(taken)) == (1, 1)


@pytest.mark.parametrize("line", [None, "teeth learned"])
def test_what_a_window_shows_is_said_under_its_name(line: str | None) -> None:
    wheel, events = a_wheel(), ["before"]
    wheel.teeth.end_window = lambda: line
    wheel.end_window(events)
    assert events == ["before", *([] if line is None else ["input shaft teeth learned"])]
    restarted: list[bool] = []
    wheel._edges = SimpleNamespace(restart=lambda: restarted.append(True))
    wheel.restart()
    assert restarted == [True]
    assert wheel.teeth.count == 45
