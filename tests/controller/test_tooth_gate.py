"""Which edge is which tooth's, at the limits of what is believed: a wheel of 45 teeth that turns
evenly, a tooth a millisecond, so that a microsecond is a thousandth of a pitch."""

from __future__ import annotations

import math
from collections.abc import Iterable

import pytest
from wheel import Wheel

from meshpoint.controller.measure.clock import SensorClockEstimate
from meshpoint.controller.measure.wheel_edges import WheelEdges

TEETH, TOOTH_US, DUTY = 45, 1000, 0.5
BEGIN_US = 1_000_000
ODD = 200
"""The tooth about which something is odd; its rising edge is due at time 0."""
DUE_US = BEGIN_US + TOOTH_US * ODD
MOST_RAD_S2 = 300.0


class Seen:
    """What is made of the wheel where some rising edges are left out and others come besides."""

    def __init__(
        self, without: Iterable[int] = (), besides_us: Iterable[int] = (),
        missing: tuple[int, ...] = (), tooth_us: int = TOOTH_US, both: bool = False,
    ) -> None:  # fmt: skip
        teeth = [k for k in range(400) if k % TEETH not in missing]
        gone = set(without)
        rise = sorted(
            [BEGIN_US + tooth_us * k for k in teeth if k not in gone]
            + [DUE_US + each for each in besides_us]
        )
        fall = [BEGIN_US + tooth_us * k + round(DUTY * tooth_us) for k in teeth
                if not (both and k in gone)]  # fmt: skip
        wheel, clock = Wheel(0, rise, fall), SensorClockEstimate()
        self.edges = WheelEdges(TEETH, DUTY, missing, MOST_RAD_S2)
        self.rising: dict[int, int] = {}
        """Teeth by the times of their rising edges, distinguished from the odd one's."""
        self.extra_us: list[int] = []
        for read_us in range(BEGIN_US + 50_000, BEGIN_US + 395 * tooth_us, 10_000):
            batch = self.edges.read([wheel.rise(read_us)], [wheel.fall(read_us)], clock, read_us)
            for time_us, tooth, falling in zip(*batch[:1], *batch[2:], strict=True):
                if not falling:
                    self.rising[int(time_us) - DUE_US] = int(tooth)
            self.extra_us += [int(each) - DUE_US for each in self.edges.extra_us]

    @property
    def counts(self) -> tuple[int, int, int]:
        """Edges too many, edges too few, doubts."""
        health = self.edges.health
        return health[0], health[1], health[2]


@pytest.mark.parametrize(("off_us", "is_believed"), [(390, True), (-390, True), (410, False),
                                                     (-410, False)])  # fmt: skip
def test_an_edge_is_its_tooth_s_up_to_four_tenths_of_a_pitch_from_where_it_is_due(
    off_us: int, is_believed: bool
) -> None:
    """One that is further off, where its tooth's is missing, is of a shaft that nobody knows."""
    seen = Seen([ODD], [off_us])
    assert (seen.rising.get(off_us) == ODD) is is_believed
    assert seen.counts == (0, 0, 0 if is_believed else 1)
    assert seen.edges.broken == int(not is_believed)
    assert seen.edges.health.counting, "it is counted again"


@pytest.mark.parametrize("extra_us", [100, 260, 500, 740, 900])
def test_an_edge_between_two_teeth_is_reported_as_extra_and_costs_none(extra_us: int) -> None:
    seen = Seen(besides_us=[extra_us])
    assert (seen.extra_us, seen.counts) == ([extra_us], (1, 0, 0))
    assert [seen.rising[TOOTH_US * k] for k in range(-2, 3)] == [ODD + k for k in range(-2, 3)]


@pytest.mark.parametrize(
    ("second_us", "taken"), [(39, 39), (41, -60), (-39, -39), (-41, -60)]
)  # fmt: skip
def test_of_two_edges_for_one_tooth_the_nearer_counts_if_it_is_nearer_by_a_fiftieth(
    second_us: int, taken: int
) -> None:
    """The first is 60 us early."""
    seen = Seen([ODD], [-60, second_us])
    assert seen.rising[taken] == ODD
    assert seen.extra_us == [second_us - 60 - taken]
    assert seen.counts == (1, 0, 0)


@pytest.mark.parametrize(("teeth", "counts"), [(1, (0, 2, 0)), (2, (0, 4, 0)), (3, (0, 0, 1))])
def test_behind_a_hole_of_two_teeth_the_count_goes_on_and_behind_one_of_three_it_is_lost(
    teeth: int, counts: tuple[int, int, int]
) -> None:
    seen = Seen(range(ODD, ODD + teeth), both=True)
    assert seen.counts == counts
    assert seen.edges.broken == counts[2]


GAP = (ODD % TEETH,)


@pytest.mark.parametrize("off_us", [0, 240, 260, -240, -260])
def test_an_edge_in_the_drawing_s_gap_where_a_tooth_would_be_puts_the_count_in_doubt(
    off_us: int,
) -> None:
    """Within a quarter of a pitch of it; the edge is extra all the same, and the next gap shows
    that the count was right."""
    seen = Seen(besides_us=[off_us], missing=GAP)
    assert (seen.extra_us, seen.edges.broken) == ([off_us], 0)
    is_doubt = abs(off_us) < 250
    assert seen.counts == (1, 0, int(is_doubt))
    assert (TOOTH_US in seen.rising) is not is_doubt, "withheld until the next gap"
    later = {time_us: tooth for time_us, tooth in seen.rising.items() if time_us > 100 * TOOTH_US}
    assert later
    offsets = {(tooth - ODD) * TOOTH_US - time_us for time_us, tooth in later.items()}
    assert len(offsets) == 1
    assert offsets.pop() % (TEETH * TOOTH_US) == 0, "by the drawing's numbers"


LEAST_PER_US = math.sqrt(6.0 * MOST_RAD_S2 / (2.0 * math.pi / TEETH)) * 1e-6
"""A wheel at this speed, in pitches, may be stopped within three."""


@pytest.mark.parametrize(
    ("tooth_us", "is_wheel"),
    [(221, False), (222, True), (round(0.99 / LEAST_PER_US), True),
     (round(1.01 / LEAST_PER_US), False)],
)  # fmt: skip
def test_a_wheel_turns_no_faster_than_6000_rpm_and_no_slower_than_it_could_be_stopped_from(
    tooth_us: int, is_wheel: bool
) -> None:
    assert bool(Seen(tooth_us=tooth_us).rising) is is_wheel


def test_what_a_faulty_sensor_shows_is_no_edge_but_its_time_is_seen() -> None:
    teeth = [BEGIN_US + TOOTH_US * k for k in range(200)]
    wheel, clock = Wheel(0, teeth, [each + 500 for each in teeth]), SensorClockEstimate()
    edges, read_us = WheelEdges(TEETH, DUTY), BEGIN_US + 50_000
    bad = wheel.rise(read_us)._replace(sensor_fault=True)
    assert edges.read([bad], [], clock, read_us).time_us.size == 0
    assert clock.latest_us == read_us
    read_us += 10_000
    assert edges.read([wheel.rise(read_us)], [wheel.fall(read_us)], clock, read_us).time_us.size
