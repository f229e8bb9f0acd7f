"""Shifts and first contacts as the sleeves' positions show them, whoever commanded them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from meshpoint.dbc.messages import SleevesAux, SleevesMain
from meshpoint.gearbox import MainGear, load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS, SLEEVE_OF_MAIN, Sleeve
from meshpoint.logs.seen_shift import SeenShift
from meshpoint.logs.sleeve_contacts import ShiftWatch
from meshpoint.units import MM

SHEET = load_sheet("truck12")
IN_MM = SHEET.sleeve.stroke_m / MM
FACE_MM = SHEET.sleeve.to_contact_m / MM
CYCLE_US = 10_000


class Sleeves:
    """Two main sleeves that move at 0.25 m/s; frames of ten samples, 1 ms apart."""

    def __init__(self) -> None:
        self._at_mm = dict.fromkeys((Sleeve.FIRST_SECOND, Sleeve.CRAWL_THIRD), 0.0)
        self._samples: list[tuple[float, float]] = []

    def rest(self, for_ms: int = 50) -> None:
        """Everything stays where it is."""
        for _ in range(for_ms):
            self._samples.append((*self._at_mm.values(),))

    def move(self, gear: MainGear, way_mm: float) -> None:
        """The sleeve of a gear goes so far towards it; 0 is neutral."""
        sleeve, direction = SLEEVE_OF_MAIN[gear].sleeve, SLEEVE_OF_MAIN[gear].direction
        end_mm = direction * way_mm
        while abs(self._at_mm[sleeve] - end_mm) > 1e-9:
            left_mm = end_mm - self._at_mm[sleeve]
            self._at_mm[sleeve] += max(-0.25, min(0.25, left_mm))
            self.rest(1)

    def frames(self) -> Iterator[SleevesMain]:
        """All of it, as frames."""
        for k in range(len(self._samples) // 10):
            first, second = zip(*reversed(self._samples[10 * k : 10 * k + 10]), strict=True)
            yield SleevesMain(
                sample_time_us=(k + 1) * CYCLE_US,
                sleeve_first_second_m=tuple(mm * MM for mm in first),
                sleeve_crawl_third_m=tuple(mm * MM for mm in second),
            )


def seen(sleeves: Sleeves) -> list[SeenShift]:
    """Splitter and range stay: low range, low split."""
    watch = ShiftWatch(SHEET)
    end_m = -SHEET.sleeve.stroke_m
    for frame in sleeves.frames():
        aux = SleevesAux(
            sample_time_us=frame.sample_time_us,
            sleeve_splitter_m=(end_m,) * 10,
            sleeve_range_m=(end_m,) * 10,
        )
        watch.take(aux)
        watch.take(frame)
    return watch.shifts


def in_gear(gear: MainGear) -> Sleeves:
    sleeves = Sleeves()
    sleeves.rest()
    sleeves.move(gear, IN_MM)
    sleeves.rest()
    sleeves.move(gear, 0.0)
    sleeves.rest()
    return sleeves


def number(gear: MainGear) -> int:
    return next(n for n, each in DRIVE_GEARS.items() if each.main is gear and n in (1, 3, 5, 13))


@pytest.mark.parametrize("rest_ms", [0, 40])
def test_a_sleeve_that_stops_at_the_face_has_met_a_tooth_else_a_gap(rest_ms: int) -> None:
    sleeves = in_gear(MainGear.FIRST)
    sleeves.move(MainGear.SECOND, FACE_MM)
    sleeves.rest(rest_ms)
    sleeves.move(MainGear.SECOND, IN_MM)
    sleeves.rest()
    (shift,) = seen(sleeves)
    assert (shift.from_gear, shift.to_gear) == (number(MainGear.FIRST), number(MainGear.SECOND))
    assert (shift.contact, shift.attempts) == ("tooth" if rest_ms else "gap", 1)


@pytest.mark.parametrize("other", [MainGear.THIRD, MainGear.FIRST, MainGear.CRAWL])
def test_a_contact_with_another_gear_is_none_of_this_shift(other: MainGear) -> None:
    """A try at another gear met a tooth and went back; then this gear's gap was met."""
    sleeves = in_gear(MainGear.FIRST)
    sleeves.move(other, FACE_MM)
    sleeves.rest(40)
    sleeves.move(other, 0.0)
    sleeves.rest()
    sleeves.move(MainGear.SECOND, IN_MM)
    sleeves.rest()
    (shift,) = seen(sleeves)
    assert shift.to_gear == number(MainGear.SECOND)
    assert (shift.contact, shift.attempts) == ("gap", 1)


def test_tries_at_the_gear_itself_are_counted_and_the_first_says_what_was_met() -> None:
    sleeves = in_gear(MainGear.FIRST)
    for _ in range(2):
        sleeves.move(MainGear.SECOND, FACE_MM)
        sleeves.rest(40)
        sleeves.move(MainGear.SECOND, 0.0)
        sleeves.rest()
    sleeves.move(MainGear.SECOND, IN_MM)
    sleeves.rest()
    (shift,) = seen(sleeves)
    assert (shift.contact, shift.attempts) == ("tooth", 3)


@pytest.mark.parametrize("short_mm", [0.35, 0.5, 1.0])
@pytest.mark.parametrize("stands_ms", [0, 40])
def test_a_sleeve_that_turns_back_short_of_the_teeth_has_met_nothing(
    short_mm: float, stands_ms: int
) -> None:
    """Stopped on its way, and taken back to neutral before it is fired again."""
    sleeves = in_gear(MainGear.FIRST)
    sleeves.move(MainGear.SECOND, FACE_MM - short_mm)
    sleeves.rest(stands_ms)
    sleeves.move(MainGear.SECOND, 0.0)
    sleeves.rest()
    sleeves.move(MainGear.SECOND, IN_MM)
    sleeves.rest()
    (shift,) = seen(sleeves)
    assert (shift.contact, shift.attempts) == ("gap", 1)


@pytest.mark.parametrize("short_mm", [0.35, 0.5, 1.0])
def test_of_a_sleeve_fired_on_from_where_it_was_stopped_no_contact_is_reported(
    short_mm: float,
) -> None:
    """It starts from rest: that its last part took long does not say that it met a tooth."""
    sleeves = in_gear(MainGear.FIRST)
    sleeves.move(MainGear.SECOND, FACE_MM - short_mm)
    sleeves.rest(40)
    sleeves.move(MainGear.SECOND, IN_MM)
    sleeves.rest()
    (shift,) = seen(sleeves)
    assert (shift.contact, shift.attempts) == (None, 0)
