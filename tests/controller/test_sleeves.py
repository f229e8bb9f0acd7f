"""The main sleeves by the data sheet: contact, abort in flight, return to neutral."""

from __future__ import annotations

import itertools
import math

import pytest

from meshpoint.controller.measure.gearbox_view import GearboxView
from meshpoint.controller.settings.learned import SleeveLawRecords, SleeveRecords
from meshpoint.controller.settings.valve_name import OPPOSITE, SLEEVE_VALVE
from meshpoint.controller.sleeve.cylinder import FRICTION
from meshpoint.controller.sleeve.driven import DrivenSleeve
from meshpoint.controller.sleeve.law import Prior, SleeveLaw, law_record
from meshpoint.controller.sleeve.sleeves import SURE_SDS, Sleeves
from meshpoint.controller.sleeve.stroke import pulse_of, pulse_to_neutral_us, rests_at_m
from meshpoint.dbc.messages import SleevesMain
from meshpoint.gearbox import MainGear, Sleeve, load_sheet
from meshpoint.gearbox.gears import MAIN_GEARS, SLEEVE_OF_MAIN

SHEET = load_sheet("truck12")
NOW_US = 1_000_000
FIRE_US = 1_020_000


def at(sleeves: Sleeves, now_us: int) -> None:
    """A step without new samples."""
    sleeves.take(GearboxView(SHEET), now_us)


@pytest.mark.parametrize("sheet_name", ["truck12", "thesis"])
@pytest.mark.parametrize("gear", MAIN_GEARS)
def test_from_neutral_a_stroke_takes_the_sheets_delay(sheet_name: str, gear: MainGear) -> None:
    sheet = load_sheet(sheet_name)
    stroke = Sleeves(sheet).stroke(gear, FIRE_US)
    assert stroke.contact_us - FIRE_US == pytest.approx(1e6 * sheet.sleeve.delay_s, abs=20)
    assert 1e3 * sheet.sleeve.valve_delay_tolerance_s < 1e-3 * stroke.sd_us < 5.0


def test_more_air_makes_the_stroke_shorter_and_its_end_faster() -> None:
    sleeves = Sleeves(SHEET)
    usual = sleeves.stroke(MainGear.SECOND, FIRE_US)
    sleeves.supply_pa = 1.2 * SHEET.air.supply_gauge_pa
    more = sleeves.stroke(MainGear.SECOND, FIRE_US)
    assert more.contact_us < usual.contact_us
    assert more.contact_speed_m_s > usual.contact_speed_m_s


@pytest.mark.parametrize("gear", MAIN_GEARS)
def test_a_sleeve_aborted_in_time_stands_short_of_the_teeth_and_goes_on_from_there(
    gear: MainGear,
) -> None:
    """But for a tenth of a millimetre, by which its detent may move it on while the chambers
    vent."""
    sleeves, side = Sleeves(SHEET), SLEEVE_OF_MAIN[gear]
    at(sleeves, NOW_US)
    sleeves.expected(SLEEVE_VALVE[gear], [(FIRE_US, True)])
    at(sleeves, FIRE_US)
    abort_us = FIRE_US + sleeves.abort_after_us(gear)
    assert FIRE_US + 1e6 * SHEET.sleeve.valve_delay_s < abort_us
    halt = sleeves.abort(gear, abort_us)
    sleeves.expected(SLEEVE_VALVE[gear], [(abort_us, False)])
    sleeves.expected(OPPOSITE[gear], [(abort_us, True)])
    at(sleeves, abort_us)
    sleeves.expected(OPPOSITE[gear], [(halt.off_us, False)])
    stands = sleeves.place(side.sleeve, halt.off_us + 100_000)
    assert not stands.is_moving
    assert stands.m == pytest.approx(halt.m, abs=1e-4)
    assert abs(stands.m) < SHEET.sleeve.to_contact_m
    refire_us = halt.off_us + 100_000
    again = sleeves.stroke(gear, refire_us)
    assert again.contact_us - refire_us < 1e6 * SHEET.sleeve.delay_s
    home = sleeves.to_neutral(side.sleeve, refire_us)
    is_out = side.direction * stands.m > 1e-3  # the detent may have drawn it back
    assert (home is not None) is is_out
    assert home is None or (home.valve is OPPOSITE[gear] and abs(home.m) < 1e-3)


def test_what_is_commanded_anew_replaces_what_was_still_to_come() -> None:
    sleeves, gear = Sleeves(SHEET), MainGear.FIRST
    at(sleeves, NOW_US)
    sleeves.expected(SLEEVE_VALVE[gear], [(FIRE_US, True)])
    sleeves.expected(SLEEVE_VALVE[gear], [(FIRE_US + 5_000, True)])
    sleeve = SLEEVE_OF_MAIN[gear].sleeve
    assert not sleeves.place(sleeve, FIRE_US + 15_000).is_moving
    assert sleeves.place(sleeve, FIRE_US + 40_000).is_moving


def test_a_sleeve_in_neutral_needs_no_pulse() -> None:
    sleeves = Sleeves(SHEET)
    assert sleeves.to_neutral(SLEEVE_OF_MAIN[MainGear.FIRST].sleeve, NOW_US) is None


def test_a_sleeve_that_flies_on_is_braked_and_not_sent_back() -> None:
    """A pulse against its motion is as short as the guard asks of one that brakes: a longer one
    would set the sleeve going the other way."""
    sleeves, gear = Sleeves(SHEET), MainGear.SECOND
    at(sleeves, NOW_US)
    sleeves.expected(SLEEVE_VALVE[gear], [(FIRE_US, True)])
    at(sleeves, FIRE_US)
    sleeves.expected(SLEEVE_VALVE[gear], [(FIRE_US + 25_000, False)])
    at(sleeves, FIRE_US + 28_000)
    braking = sleeves.to_neutral(SLEEVE_OF_MAIN[gear].sleeve, FIRE_US + 30_000)
    assert braking is not None
    assert braking.valve is OPPOSITE[gear]
    assert 5_000 < braking.off_us - braking.on_us <= 15_000


@pytest.mark.parametrize("direction", [-1, 1])
@pytest.mark.parametrize("from_mm", [12.0, 4.0])
def test_a_pulse_to_neutral_throws_no_sleeve_through_where_its_valve_shuts_late(
    direction: int, from_mm: float
) -> None:
    """What falls short is pushed once more; what is thrown through may meet turning teeth."""
    law = SleeveLaw(SHEET)
    sheet = law.prior(SHEET)
    known = Prior(sheet.mean, 0.04 * sheet.covariance)  # after some movements
    sleeve = DrivenSleeve(law, known).at_rest(-direction * 1e-3 * from_mm)
    sleeve.switch_sd_s = [1.6e-3, 1.6e-3]
    long_us = pulse_to_neutral_us(sleeve, direction, NOW_US, SURE_SDS)
    pulse = pulse_of(direction, NOW_US, long_us)
    late_us = int(1e6 * SURE_SDS * math.hypot(*map(sleeve.sd_of, pulse)))
    beyond_m = direction * rests_at_m(
        sleeve, NOW_US, pulse_of(direction, NOW_US, long_us + late_us)
    )
    assert beyond_m < 1.1e-3  # its detent has it


def standing_at(sleeves: Sleeves, view: GearboxView, x_mm: float, from_us: int, to_us: int) -> None:
    """The sleeve of first and second gear is seen to stand there."""
    samples = (1e-3 * x_mm,) * 10
    for now_us in range(from_us, to_us, 10_000):
        view.sleeves_main(SleevesMain(0, 0, samples, (0.0,) * 10), now_us)
        sleeves.take(view, now_us + 2_000)


def pushed_ms(sleeves: Sleeves, at_us: int) -> float:
    """How long the push to neutral would be."""
    pulse = sleeves.to_neutral(Sleeve.FIRST_SECOND, at_us)
    assert pulse is not None
    return 1e-3 * (pulse.off_us - pulse.on_us)


def slow_sleeves() -> Sleeves:
    """Taught friction of three times the sheet's."""
    sheet = SleeveLaw(SHEET).prior(SHEET)
    slow = sheet.mean.copy()
    slow[FRICTION] = math.log(3.0)
    laws = SleeveLawRecords(first_second=law_record(Prior(slow, 0.01 * sheet.covariance), 20))
    sleeves = Sleeves(SHEET)
    sleeves.restore(SleeveRecords(), laws)
    return sleeves


def test_a_push_to_neutral_is_bounded_by_what_was_withstood_from_there_or_nearer_neutral() -> None:
    """Whatever the law asks for, which friction of three times the sheet's has taught: first by
    half of the least stroke for the way that ends 1 mm before the opposite teeth, less 7 ms for a
    valve that is late to shut, then by 2 ms more than the last push."""
    sleeves, view = slow_sleeves(), GearboxView(SHEET)
    first_ms = {x_mm: 14.0 * ((4.0 + x_mm) / 5.0) ** (1 / 3) - 7.0 for x_mm in (2.6, 4.0)}
    standing_at(sleeves, view, 2.6, 0, 300_000)
    assert pushed_ms(sleeves, 320_000) == pytest.approx(first_ms[2.6], abs=0.01)
    standing_at(sleeves, view, 4.0, 300_000, 500_000)
    assert pushed_ms(sleeves, 520_000) == pytest.approx(first_ms[4.0], abs=0.01)
    sleeves.expected(SLEEVE_VALVE[MainGear.FIRST], [(520_000, True)])
    standing_at(sleeves, view, 4.0, 500_000, 530_000)
    sleeves.expected(SLEEVE_VALVE[MainGear.FIRST], [(531_000, False)])
    standing_at(sleeves, view, 4.0, 530_000, 900_000)
    assert pushed_ms(sleeves, 920_000) == pytest.approx(13.0, abs=0.01)
    standing_at(sleeves, view, 2.6, 900_000, 1_200_000)
    assert pushed_ms(sleeves, 1_220_000) == pytest.approx(first_ms[2.6], abs=0.01)


def test_pushes_in_vain_between_teeth_grow_three_times_and_then_wait_for_empty_chambers() -> None:
    """A position sensor that is stuck shows none of them. Red before: ever longer, and as soon as
    the last one was over."""
    sleeves, view = slow_sleeves(), GearboxView(SHEET)
    now_us, lengths_ms = 300_000, list[float]()
    standing_at(sleeves, view, 8.0, 0, now_us)
    for _ in range(7):
        waited_us = now_us
        while sleeves.to_neutral(Sleeve.FIRST_SECOND, now_us) is None:
            standing_at(sleeves, view, 8.0, now_us, now_us + 10_000)
            now_us += 10_000
        assert (now_us - waited_us > 100_000) is (len(lengths_ms) > 3)
        lengths_ms.append(pushed_ms(sleeves, now_us))
        off_us = now_us + round(1e3 * lengths_ms[-1])
        sleeves.expected(SLEEVE_VALVE[MainGear.FIRST], [(now_us, True)])
        standing_at(sleeves, view, 8.0, now_us, now_us + 10_000)
        sleeves.expected(SLEEVE_VALVE[MainGear.FIRST], [(off_us, False)])
        standing_at(sleeves, view, 8.0, now_us + 10_000, now_us + 150_000)
        now_us += 150_000
    grows = [b - a for a, b in itertools.pairwise(lengths_ms)]
    assert grows == pytest.approx([2.0, 2.0, 2.0, -6.0, 0.0, 0.0], abs=0.3)
