"""What the guard judges: a valve command decoded, the spans in which each valve would be driven,
and what positions, clutch and speeds come to by then.

A driven valve is described by a span of time, from its activation (or now) to its release (which
may still lie ahead).
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from meshpoint.controller.guard.held_gear import PulledGear
from meshpoint.controller.guard.limits import (
    CLEAR_M,
    GUARD_NEUTRAL_M,
    LEAVING_M_S,
    REACT_US,
    SPLITTER,
    GuardLimits,
    end_of,
)
from meshpoint.controller.guard.listening import OVER_SAMPLES, SAMPLE_S
from meshpoint.controller.guard.own_clock import signed_us
from meshpoint.controller.guard.sleeve_motion import (
    Drive,
    contact_between_us,
    longest_pulse_us,
)
from meshpoint.controller.guard.swing import Swing
from meshpoint.controller.guard.view import GuardInputs

ACTION_BYTES: Final = slice(3, 6)
TIME_BYTES: Final = 6
FRAME_LENGTH: Final = 48
VALVE_COUNT: Final = 9
_times_us: Final = struct.Struct(f"<{VALVE_COUNT}I").unpack_from
_SHIFTS: Final = range(0, 2 * VALVE_COUNT, 2)
MAIN_VALVES: Final = (3, 4, 5, 6)
SLEEVE_VALVES: Final = range(1, 9)
OTHER_OF_DOG: Final = {3: 4, 4: 3, 5: 6, 6: 5, 1: 2, 2: 1}
"""The valve that pushes a sleeve with dog teeth the other way."""
OFF_NOW, ON_NOW, OFF_AT, ON_AT = range(4)
FOREVER_US: Final = 1 << 62
CLUTCH_AHEAD_US: Final = 60_000
"""Where the clutch will be is said no further ahead."""
COUNTER_US: Final = 20_000
"""A valve that is on within so long after the other one of its sleeve brakes what that has set
going: its chamber still pushes."""
LONGER_US: Final = 4_000
"""By so much longer than before a gear may be pulled each time: less than lies between a pulse that
brings a sleeve to neutral and one that throws it through."""
LEAST_PUSH_US: Final = 7_000
"""A push towards neutral may last as long as this wherever the sleeve stands: a shorter one may
leave it there."""
RANGE: Final = 3


class ValveRequest(NamedTuple):
    """A decoded command: action and 32-bit time of each valve."""

    actions: tuple[int, ...]
    times_us: tuple[int, ...]

    @property
    def driven(self) -> tuple[bool, ...]:
        """The valves that are to be driven, now or at their time."""
        return tuple(action in (ON_NOW, ON_AT) for action in self.actions)


def decode(payload: bytes) -> ValveRequest:
    """Decodes a valve command frame. ValueError if it does not have the length of one."""
    if len(payload) != FRAME_LENGTH:
        raise ValueError(f"valve command of {len(payload)} bytes, allowed is {FRAME_LENGTH}")
    actions = int.from_bytes(payload[ACTION_BYTES], "little")
    return ValveRequest(
        tuple([actions >> shift & 3 for shift in _SHIFTS]), _times_us(payload, TIME_BYTES)
    )


class Span(NamedTuple):
    """A valve is driven from one sensor time to another."""

    start_us: int
    end_us: int


Spans = tuple[Span | None, ...]
NO_SPANS: Final[Spans] = (None,) * VALVE_COUNT
NO_PULLS: Final[frozenset[int]] = frozenset()


def spans(wish: ValveRequest, before: Spans, now_us: int) -> Spans:
    """When each valve would be driven if this command passed.

    An OFF_AT releases both valves of a sleeve. before: the spans of the command passed last;
    now_us: sensor time."""
    if not any(wish.actions):
        return NO_SPANS
    found = [
        _span(action, time_us, was, now_us)
        for action, time_us, was in zip(wish.actions, wish.times_us, before, strict=True)
    ]
    for valve, other in OTHER_OF_DOG.items():
        span = found[other]
        if wish.actions[valve] == OFF_AT and span is not None:
            off_us = now_us + signed_us(wish.times_us[valve] - now_us)
            if off_us > max(span.start_us, now_us):
                found[other] = Span(span.start_us, min(off_us, span.end_us))
    return tuple(found)


def _span(action: int, time_32: int, was: Span | None, now_us: int) -> Span | None:
    if action == OFF_NOW:
        return None
    is_driven = was is not None and was.start_us <= now_us < was.end_us
    since_us = was.start_us if was is not None and is_driven else now_us
    if action == ON_NOW:
        return Span(since_us, FOREVER_US)
    time_us = now_us + signed_us(time_32 - now_us)
    if action == ON_AT:
        return Span(since_us if is_driven else max(time_us, now_us), FOREVER_US)
    if action == OFF_AT and is_driven and time_us > now_us:
        return Span(since_us, time_us)
    return None


@dataclass
class GuardState:
    """What the guard keeps from step to step."""

    armed: bool = True
    """Whether anything may be driven at all in this run."""
    spans: Spans = NO_SPANS
    """Spans of the command that was passed last."""
    latched_by: int = 0
    pulls: frozenset[int] = NO_PULLS
    """Main valves driven to pull a gear out, until they are off."""
    engages: frozenset[int] = NO_PULLS
    """Main valves that the command passed last drove toward a gear's teeth."""
    drives: dict[int, Drive] = field(default_factory=dict)
    """How each main valve was driven since its sleeve was last seen to stand."""
    stood_m: dict[int, float] = field(default_factory=dict)
    """Where a main sleeve stood as its driven valve set it going, positive toward its gear."""
    withstood_us: dict[int, int] = field(default_factory=dict)
    """The longest pull by each main valve that did not take its sleeve beyond neutral."""
    pulled: tuple[PulledGear, PulledGear] = field(default_factory=PulledGear.two)
    """By main sleeve: whether the gear that it is measured in has turned free since a pull."""
    pushes: dict[int, Drive] = field(default_factory=dict)
    """The last push towards neutral by each main valve, of a sleeve before the other gear's teeth,
    that did not take it beyond neutral."""
    before_teeth_us: dict[int, int] = field(default_factory=dict)
    """Since when a main sleeve stands between neutral and a gear's teeth."""
    proofs: int = 0
    """Steps in a row in which everything was valid; the self-test is passed at PROOF_STEPS."""
    brake_off_us: int = -FOREVER_US
    """When the brake was last driven."""
    brake_j: float = 0.0
    """Energy (J) that the brake has taken in its present use."""
    judged_us: int | None = None
    wanted: tuple[int, int] | None = None
    """The gear asked for and when; until it is in and the clutch closed."""
    group_us: dict[int, int] = field(default_factory=dict)
    """When each valve of splitter and range was last driven."""


class JudgedCommand(NamedTuple):
    """What a rule judges: the spans asked for, what the sensors show, the guard's state, the
    limits."""

    spans: Spans
    seen: GuardInputs
    state: GuardState
    limits: GuardLimits

    def engaging(self) -> list[tuple[int, Span]]:
        """Valves whose sleeve may come to the teeth of a gear that it has not entered yet.

        One that pulls a gear out counts only once its sleeve is past neutral, or where it pulls for
        so long that the sleeve may run through; a pulse that brakes a sleeve or brings it back to
        neutral only where it is not proven to stop short."""
        found = []
        for valve in self.limits.dogs:
            span, way_m = self.spans[valve], self.way_m(valve)
            if span is None or way_m > self.limits.contact_m:
                continue
            if self._pulls(valve):
                if way_m >= GUARD_NEUTRAL_M or self._runs_through(valve, span):
                    found.append((valve, span))
            elif not self._stops_short(valve, span):
                found.append((valve, span))
        return found

    def _pulls(self, valve: int) -> bool:
        """Whether the valve pulls a gear out, or has done so since it is on, or goes on with it
        after a break before which the sleeve has not come to neutral or to stand."""
        before, way_m = self.state.drives.get(valve), self.way_m(valve)
        goes_on = before is not None and before.pulls and way_m < -GUARD_NEUTRAL_M
        return valve in self.state.pulls or goes_on or way_m < -self.limits.apart_m

    def _stops_short(self, valve: int, span: Span) -> bool:
        """Whether this valve is on no longer than its sleeve takes to brake, or to come back to
        neutral from before the other gear's teeth: it is off before the sleeve can come to its own
        gear's, even if the next command is the first to end it."""
        way_m, brakes_us = self.set_off_m(valve, span), self._brakes_us(valve, span)
        if way_m >= -GUARD_NEUTRAL_M and brakes_us == 0.0:
            return False
        end_us = min(span.end_us, self.seen.now_us + self.limits.switch_again_us)
        lasts_us = end_us - self._since_us(valve, span)
        comes_back = lasts_us <= self._short_us(way_m) and not self._is_long_push(valve, span)
        return comes_back or end_us - span.start_us <= brakes_us

    def _runs_through(self, valve: int, span: Span) -> bool:
        """Whether this valve pulls a gear out for longer than the sheet's fastest sleeve takes to
        come before the other gear's teeth, and than this one has withstood."""
        end_us = min(span.end_us, self.seen.now_us + self.limits.switch_again_us)
        by_sheet_us = self._short_us(self.set_off_m(valve, span))
        withstood_us = self.state.withstood_us.get(valve, 0) + LONGER_US
        return end_us - self._since_us(valve, span) > max(by_sheet_us, withstood_us)

    def _short_us(self, way_m: float) -> float:
        """A pulse that stops short, or, on the way to neutral, the shortest one that a command can
        still end: what no command could avoid is not forbidden."""
        short_us = longest_pulse_us(self.limits, way_m)
        if way_m < -GUARD_NEUTRAL_M:
            return max(short_us, float(self.limits.switch_again_us))
        return short_us

    def _is_long_push(self, valve: int, span: Span) -> bool:
        """Whether a sleeve that stands before the other gear's teeth is pushed towards neutral for
        longer than stops short also where its valve opens early and shuts late, and than it has
        withstood from there or from nearer neutral. Judged once the push's end is commanded."""
        way_m, other = self.set_off_m(valve, span), OTHER_OF_DOG[valve]
        stands = self.last_drive(other) is None and self.spans[other] is None
        is_ended = span.end_us <= self.seen.now_us + self.limits.switch_again_us
        if not (stands and is_ended):
            return False
        stops_us = longest_pulse_us(self.limits, way_m) - self.limits.sleeve_scatter_us
        most_us, before = max(stops_us, LEAST_PUSH_US), self.state.pushes.get(valve)
        if before is not None and way_m <= before.stood_m:
            most_us = max(most_us, before.driven_us + LONGER_US)
        return span.end_us - self._since_us(valve, span) > most_us

    def _since_us(self, valve: int, span: Span) -> int:
        """Since when the valve is on, with all its times since the sleeve was last seen to
        stand: pulses in a row work like a longer one."""
        drive = self.drive_before(valve)
        return span.start_us if drive is None else drive.start_us

    def _brakes_us(self, valve: int, span: Span) -> float:
        """Longest time this valve may brake the sleeve after the opposite valve went off: as much
        as that one was on longer; where the sleeve is seen to move as pushed, as much more as it
        stops short. 0 where none went off just now, or it is seen to move toward this valve's
        gear."""
        before, own = self.last_drive(OTHER_OF_DOG[valve]), self.drive_before(valve)
        gear = self.limits.dogs[valve]
        if (
            before is None
            or span.start_us - before.end_us > COUNTER_US
            or self.seen.means_m_s[gear.sleeve] * gear.direction >= LEAVING_M_S
        ):
            return 0.0
        left_us = before.driven_us - (0 if own is None else own.driven_us)
        if left_us > 0 and self.seen.means_m_s[gear.sleeve] * gear.direction <= -LEAVING_M_S:
            left_us += int(longest_pulse_us(self.limits, self.set_off_m(valve, span)))
        return float(max(0, min(REACT_US, left_us)))

    def last_drive(self, valve: int) -> Drive | None:
        """How a main valve that is not driven any more was, since its sleeve was last seen to
        stand."""
        was, now_us = self.state.spans[valve], self.seen.now_us
        before = self.state.drives.get(valve)
        if was is None or was.start_us > now_us:
            return before
        end_us = min(was.end_us, now_us)
        drive = Drive(
            was.start_us,
            end_us,
            valve in self.state.engages,
            valve in self.state.pulls,
            end_us - was.start_us,
            self.state.stood_m.get(valve, self.way_m(valve)),
        )
        if before is None:
            return drive
        return Drive(
            before.start_us,
            drive.end_us,
            before.engages or drive.engages,
            before.pulls or drive.pulls,
            before.driven_us + drive.driven_us,
            max(before.stood_m, drive.stood_m),
        )

    def drives_before(self, sleeve: int) -> list[Drive]:
        """What has set a main sleeve going since it stood last, and does not drive it any more."""
        found = [self.drive_before(valve) for valve in self.limits.valves_of[sleeve]]
        return [drive for drive in found if drive is not None]

    def drive_before(self, valve: int) -> Drive | None:
        """How a main valve was driven, since its sleeve was last seen to stand, before the span
        that is asked for; one that goes on does not count."""
        was = self.state.spans[valve]
        goes_on = was is not None and was.end_us > self.seen.now_us
        if goes_on and self.spans[valve] is not None:
            return self.state.drives.get(valve)
        return self.last_drive(valve)

    def moves_on(self, sleeve: int) -> bool:
        """Whether a main sleeve may be on its way to a gear's teeth though its valve is off: it was
        on for too long to stop short of them, and has not been seen to stand since."""
        return any(
            drive.engages and drive.lasted_us > longest_pulse_us(self.limits, drive.stood_m)
            for drive in self.drives_before(sleeve)
        )

    def brings_back(self, valve: int) -> bool:
        """Whether a main valve does nothing but brake its sleeve, or bring it to neutral from where
        it stands before the other gear's teeth."""
        span = self.spans[valve]
        if span is None or valve not in self.limits.dogs or self.seen.agreeing:
            return False
        stands = not self.moves_on(self.limits.dogs[valve].sleeve)
        is_before_teeth = -self.limits.contact_m <= self.way_m(valve) < -GUARD_NEUTRAL_M
        return self._stops_short(valve, span) and (
            self.brakes(valve) or (stands and is_before_teeth)
        )

    def brakes(self, valve: int) -> bool:
        """Whether a main valve works against what the other one of its sleeve has set going."""
        span = self.spans[valve]
        return span is not None and valve in self.limits.dogs and self._brakes_us(valve, span) > 0.0

    def pulling(self) -> frozenset[int]:
        """Main valves that pull a gear out: driven without a break since that gear was in mesh."""
        if self.spans is NO_SPANS:
            return NO_PULLS
        driven = [valve for valve in self.limits.dogs if self.spans[valve] is not None]
        return frozenset(filter(self._pulls, driven))

    def _still_pulls(self, valve: int) -> bool:
        """Whether the air of a main valve that has pulled a gear out still acts: its coil has been
        off for less than its delay."""
        before = self.last_drive(valve)
        if before is None or not before.pulls:
            return False
        return self.seen.now_us < before.end_us + self.limits.valve_between_us[0]

    def way_m(self, valve: int) -> float:
        """Position of the valve's sleeve (m); positive toward the gear of this valve."""
        gear = self.limits.dogs[valve]
        return self.seen.positions_m[gear.sleeve] * gear.direction

    def contact_us(self, valve: int, span: Span) -> tuple[float, float]:
        """Earliest and latest sensor time (us) at which a sleeve driven in this span meets its
        gear, from where it stands as it sets off. One that is not seen to stand since it was fired
        before may be anywhere up to where that can have brought it."""
        limits, sleeve = self.limits, self.limits.dogs[valve].sleeve
        stands_m = farthest_m = self.set_off_m(valve, span)
        if any(drive.engages for drive in self.drives_before(sleeve)):
            farthest_m = limits.contact_m - (0.0 if self.moves_on(sleeve) else CLEAR_M)
        return contact_between_us(limits, span.start_us, stands_m, farthest_m)

    def set_off_m(self, valve: int, span: Span) -> float:
        """Where the valve's sleeve stands, or stood as this span set it going; positive toward the
        gear."""
        way_m = self.way_m(valve)
        return way_m if self.has_not_set_off(span) else self.state.stood_m.get(valve, way_m)

    def has_not_set_off(self, span: Span) -> bool:
        """Whether the positions were sampled before this span can have moved anything."""
        return self.seen.positions_us <= span.start_us + self.limits.valve_between_us[0]

    def is_neutral(self, sleeve: int) -> bool:
        """Whether a main sleeve is proven neutral: it is measured there, and has been seen to stand
        since a valve drove it; after a pull and nothing else, to move no more."""
        drives = self.drives_before(sleeve)
        return (
            abs(self.seen.positions_m[sleeve]) <= GUARD_NEUTRAL_M
            and all(drive.pulls and not drive.engages for drive in drives)
            and not (drives and abs(self.seen.means_m_s[sleeve]) >= LEAVING_M_S)
        )

    def stands_apart(self, sleeve: int) -> bool:
        """Whether a main sleeve stands, and its teeth touch no gear's."""
        return (
            abs(self.seen.positions_m[sleeve]) <= self.limits.apart_m
            and abs(self.seen.means_m_s[sleeve]) < LEAVING_M_S
            and not self.moves_on(sleeve)
        )

    def main_is_neutral(self) -> bool:
        """Whether both main sleeves are proven neutral."""
        return self.is_neutral(0) and self.is_neutral(1)

    def speed(self, shaft: int) -> float | None:
        """A shaft's speed (rad/s); None if it is stale or invalid."""
        speed = self.seen.speeds[shaft]
        return None if speed is None else speed.omega_rad_s

    def swing(self, shaft: int) -> Swing | None:
        """How a shaft's speed changes; None where that is not known."""
        return self.seen.swings[(2, 0, 1)[shaft]]

    def starting(self) -> list[int]:
        """Sleeve valves that are newly driven."""
        was = self.state.spans
        return [v for v in SLEEVE_VALVES if self.spans[v] is not None and was[v] is None]

    def gear_number(self) -> int:
        """The gear that all sleeves stand in; 0 none."""
        side = [end_of(position, self.limits.engaged_m) for position in self.seen.positions_m]
        for valve, gear in self.limits.main.items():
            if side[gear.sleeve] == gear.direction:
                return self.limits.gear_at.get((valve, side[SPLITTER], side[RANGE]), 0)
        return 0

    def clutch_at(self, time_us: float) -> float:
        """Where the clutch will be, at the rate at which it moves now; nowhere further than it gets
        in CLUTCH_AHEAD_US."""
        ahead_us = min(max(0.0, time_us - self.seen.clutch_us), CLUTCH_AHEAD_US)
        return self.seen.clutch_closed + self.seen.clutch_per_s * ahead_us * 1e-6

    def is_parted(self, from_us: float) -> bool:
        """Whether the clutch's plates are surely apart at a time, and will be as long as nothing
        can be withdrawn."""
        until_us = max(from_us, self.seen.now_us + REACT_US)
        farthest = max(self.clutch_at(from_us), self.clutch_at(until_us))
        return farthest <= self.limits.clutch_open_share

    def teeth_are_out(self, sleeve: int, at_us: float) -> bool:
        """Whether a main sleeve is clear of its gears' teeth at a time: it stands in neutral or
        before them, or is clear of them and is not seen to move towards them, or a driven valve
        pulls it and it is seen to move out fast enough, s = a t^2 / 2 from its end."""
        limits = self.limits
        position = self.seen.positions_m[sleeve]
        if self.moves_on(sleeve):
            return False
        if abs(position) <= GUARD_NEUTRAL_M or self.stands_apart(sleeve):
            return True
        pulled = any(limits.dogs[valve].sleeve == sleeve for valve in self.pulling()) or any(
            map(self._still_pulls, limits.valves_of[sleeve])
        )
        speed = -math.copysign(1.0, position) * self.seen.speeds_m_s[sleeve]
        come_m = limits.stroke_m - abs(position)
        is_pushed = any(
            self.spans[valve] is not None and self.way_m(valve) > 0.0
            for valve in limits.valves_of[sleeve]
        )
        stays_out = speed > -LEAVING_M_S and not is_pushed
        if come_m >= limits.stroke_m - limits.contact_m + CLEAR_M and (pulled or stays_out):
            return True
        if not pulled:
            return False
        # The speed is the one half its samples ago.
        ago_s = 0.5 * OVER_SAMPLES * SAMPLE_S
        come_m -= speed * ago_s
        if speed < LEAVING_M_S or come_m <= 0.0:
            return False
        since_s = 2.0 * come_m / speed
        then_s = since_s + ago_s + max(0.0, at_us - self.seen.positions_us) * 1e-6
        come_m *= (then_s / since_s) ** 2
        return come_m >= limits.stroke_m - limits.contact_m + CLEAR_M
