"""Gap or tooth at first contact, as a sleeve's own position sensor shows it: no truth is needed.

A sleeve that meets a gap goes on at its speed, one that meets a tooth stops on its face. So the
time from a little before the contact to a little past it is compared with the time for the same
way before. A sleeve that was stopped short of the teeth and goes on from there starts from rest, so
its times say nothing: no contact of it is reported.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from meshpoint.controller.measure.gearbox_view import GearboxView
from meshpoint.dbc.messages import Message, SleevesAux, SleevesMain, ValveStatus
from meshpoint.dbc.sensor_time import wrap
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import SLEEVE_OF_MAIN, MainGear, Sleeve
from meshpoint.logs.seen_shift import SeenShift
from meshpoint.results.road_speed import span_us
from meshpoint.units import MM

SAMPLE_US: Final = 1000
NEUTRAL_M: Final = 1.0 * MM
WAY_M: Final = 0.8 * MM
"""The way whose times are compared: once before the contact, once across it."""
ACROSS_M: Final = 0.4 * MM
"""The second way ends so far past the contact."""
SLOWER: Final = 1.5
"""Times as long across the contact as before it: it has stopped there. With samples of 1 ms a free
sleeve gives 0.8 to 1.3, one that starts again from a face 2 or more (simulated, preset truck, sheet
truck12, `typical` and `harsh`, seeds 5, 8, 21 and 22, 96 contacts). A tooth that enters a gap and
is bounced off at once reads as a tooth, one that slides off the face within some 2 ms, as a gap."""
SHORT_M: Final = 0.3 * MM
"""A sleeve that comes no nearer to the teeth has met none."""
STANDS_M: Final = 0.25 * MM
STANDS_US: Final = 10_000
"""One that moves by no more than that in so long a time stands."""
REST_SHARE: Final = 0.02
VALVES: Final = {
    "main_first_energised": MainGear.FIRST,
    "main_second_energised": MainGear.SECOND,
    "main_crawl_energised": MainGear.CRAWL,
    "main_third_energised": MainGear.THIRD,
}


class SeenContact(NamedTuple):
    """A sleeve's first contact with a gear, by its position."""

    time_us: int
    """Sensor clock, 32 bits, when the sleeve was at the gear's faces."""
    gear: MainGear
    contact: str
    """`gap` or `tooth`."""


class _Side:
    """One sleeve on its way to one of its gears."""

    def __init__(self, gear: MainGear, contact_m: float) -> None:
        self.gear = gear
        self._met_m = contact_m - SHORT_M
        end_m = contact_m + ACROSS_M
        self._levels_m = (end_m - 2 * WAY_M, end_m - WAY_M, end_m)
        self._passed_us: list[int] = []
        """Sensor clock, 32 bits."""
        self._before: tuple[float, int] | None = None
        self._farthest_m = 0.0
        self._since: tuple[float, int] | None = None
        """Where it has been since when, give or take `STANDS_M`."""
        self._stopped = False

    def rest(self) -> SeenContact | None:
        """The sleeve is back in neutral; one that had come to the gear did not get in."""
        passed, farthest_m, stopped = self._passed_us, self._farthest_m, self._stopped
        self._passed_us, self._farthest_m, self._stopped = [], 0.0, False
        self._before = self._since = None
        if len(passed) == 2 and farthest_m >= self._met_m and not stopped:
            return SeenContact(passed[1], self.gear, "tooth")
        return None

    def take(self, way_m: float, time_us: int) -> SeenContact | None:
        """One sample, as the way from neutral towards this gear."""
        before, self._before = self._before, (way_m, time_us)
        self._farthest_m = max(self._farthest_m, way_m)
        self._stopped = self._stopped or self._stands_short(way_m, time_us)
        if before is None or self._stopped or len(self._passed_us) == len(self._levels_m):
            return None
        level_m = self._levels_m[len(self._passed_us)]
        while before[0] < level_m <= way_m:
            share = (level_m - before[0]) / (way_m - before[0])
            passed_us = before[1] + share * span_us(time_us, before[1])
            self._passed_us.append(wrap(round(passed_us)))
            if len(self._passed_us) == len(self._levels_m):
                a_us, b_us, c_us = self._passed_us
                is_tooth = span_us(c_us, b_us) > SLOWER * span_us(b_us, a_us)
                return SeenContact(b_us, self.gear, "tooth" if is_tooth else "gap")
            level_m = self._levels_m[len(self._passed_us)]
        return None

    def _stands_short(self, way_m: float, time_us: int) -> bool:
        """Whether it stands so near to the teeth that it is past the first level, and not at
        them."""
        if self._since is None or abs(way_m - self._since[0]) > STANDS_M:
            self._since = way_m, time_us
        stands = span_us(time_us, self._since[1]) >= STANDS_US
        return stands and bool(self._passed_us) and self._farthest_m < self._met_m


class SleeveContacts:
    """Takes sleeve frames in order; what a contact was is reported as soon as it shows."""

    def __init__(self, sheet: GearboxSheet) -> None:
        contact_m = sheet.sleeve.to_contact_m
        self._sides = {gear: _Side(gear, contact_m) for gear in SLEEVE_OF_MAIN}
        self._rest_m = dict.fromkeys((Sleeve.FIRST_SECOND, Sleeve.CRAWL_THIRD), 0.0)

    def take(self, message: SleevesMain) -> list[SeenContact]:
        """The contacts that this frame's ten samples show."""
        found = []
        for sleeve, samples_m in (
            (Sleeve.FIRST_SECOND, message.sleeve_first_second_m),
            (Sleeve.CRAWL_THIRD, message.sleeve_crawl_third_m),
        ):
            for age, position_m in reversed(list(enumerate(samples_m))):
                found += self._sample(sleeve, position_m, message.sample_time_us - age * SAMPLE_US)
        return found

    def _sample(self, sleeve: Sleeve, position_m: float, time_us: int) -> list[SeenContact]:
        is_neutral = abs(position_m) < NEUTRAL_M
        if is_neutral:
            # The sensor's offset shifts the place of contact by as much.
            self._rest_m[sleeve] += REST_SHARE * (position_m - self._rest_m[sleeve])
        found = []
        for gear, where in SLEEVE_OF_MAIN.items():
            if where.sleeve is not sleeve:
                continue
            side = self._sides[gear]
            way_m = (position_m - self._rest_m[sleeve]) * where.direction
            seen = side.rest() if is_neutral else side.take(way_m, time_us)
            if seen is not None:
                found.append(seen)
        return found


class ShiftWatch:
    """Sees shifts by the sleeves alone."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._view = GearboxView(sheet)
        self._contacts = SleeveContacts(sheet)
        self._gear = 0
        self._left_us = 0
        self._is_away = True
        self._seen: list[SeenContact] = []
        self._driven: dict[MainGear, int] = {}
        self.shifts: list[SeenShift] = []

    def take(self, message: Message) -> SeenShift | None:
        """Any message in bus order; a shift that is complete with it."""
        if isinstance(message, ValveStatus):
            self._take_valves(message)
        elif isinstance(message, SleevesMain):
            self._view.sleeves_main(message, message.sample_time_us)
            self._seen += self._contacts.take(message)
            return self._look(message.sample_time_us)
        elif isinstance(message, SleevesAux):
            self._view.sleeves_aux(message, message.sample_time_us)
        return None

    def _take_valves(self, message: ValveStatus) -> None:
        for name, gear in VALVES.items():
            if getattr(message, name) and self._is_away:
                self._driven.setdefault(gear, message.sample_time_us)

    def _look(self, now_us: int) -> SeenShift | None:
        self._view.work_out()
        gear = self._view.gear_number
        if gear <= 0:
            if not self._is_away:
                self._is_away, self._left_us = True, now_us
                self._driven.clear()
            return None
        if not self._is_away:
            return None
        self._is_away = False
        before, self._gear = self._gear, gear
        seen, self._seen = self._seen, []
        if before in (0, gear):
            return None
        main = self._view.main_gear
        mine = [contact for contact in seen if contact.gear is main]
        shift = SeenShift(
            before, gear, self._left_us, now_us, None if main is None else self._driven.get(main),
            mine[0].contact if mine else None, len(mine),
        )  # fmt: skip
        self.shifts.append(shift)
        return shift
