"""Coupling sleeves along their axis: states, and the law of a pure delay.

The thesis regards valve, actuator and sleeve as a pure delay from activation to contact. Around it
lies the smallest axial law that gives the position sensor something true to show:

* APPROACH: the sleeve rests for the valve's delay, then moves under constant force (x grows with
  the square of time) so that it touches the gear exactly at the drawn contact time.
* FACE: it rests on a tooth, at the contact position. ENTER and LOCKED: on into the gap at constant
  speed, to full stroke.
* Valve off in APPROACH, FACE, or ENTER short of full stroke: RETRACT, back to neutral at the same
  constant speed. Valve off in ENTER at full stroke or in LOCKED: it stays (detent, back taper).
* Opposite valve on in LOCKED, or in ENTER at full stroke: RETRACT. It rests for the valve's delay,
  then moves under constant force and reaches neutral at the drawn time; locked teeth leave each
  other on the way, at the contact position. Valve off before it moves: it stays; later it goes on
  to neutral. (Teeth not yet at a flank carry nothing; they count as apart from the activation on.)
* Both valves on: no net force. A sleeve under way falls back as with its valve off, any other
  stays.
* One activation moves a sleeve by one position, and only a sleeve that stands: in neutral (towards
  a gear) or engaged (to neutral). Any other activation is lost.

What happens between the teeth is decided in `engagement`; here it arrives as events of the table.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Final, NamedTuple, Protocol

from meshpoint.gearbox.sheet import SleeveActuator
from meshpoint.units import SECOND_US

STROKES_KEPT_US: Final = 10_000.0
NEVER_US: Final = math.inf


class SleeveState(IntEnum):
    """Where a sleeve is between neutral and a gear."""

    NEUTRAL = 0
    APPROACH = 1
    FACE = 2
    ENTER = 3
    LOCKED = 4
    RETRACT = 5


class SleeveEvent(IntEnum):
    """What moves a sleeve from state to state."""

    ENGAGE = 0  # valve on towards a gear
    LET_GO = 1  # that valve off
    RELEASE = 2  # opposite valve on
    ON_TOOTH = 3  # contact, tooth on tooth
    IN_GAP = 4  # contact in the gap, or carried to it
    AT_FLANK = 5  # the slip has brought the tooth to the flank
    HELD = 6  # a release given up before the sleeve has moved
    ARRIVED = 7  # back in neutral
    EJECTED = 8  # a flank met before the teeth overlap enough; preset truck only


S, E = SleeveState, SleeveEvent
SLEEVE_TRANSITIONS: Final[dict[tuple[SleeveState, SleeveEvent], SleeveState]] = {
    (S.NEUTRAL, E.ENGAGE): S.APPROACH,
    (S.APPROACH, E.ON_TOOTH): S.FACE,
    (S.APPROACH, E.IN_GAP): S.ENTER,
    (S.APPROACH, E.LET_GO): S.RETRACT,
    (S.FACE, E.IN_GAP): S.ENTER,
    (S.FACE, E.LET_GO): S.RETRACT,
    (S.ENTER, E.AT_FLANK): S.LOCKED,
    (S.ENTER, E.LET_GO): S.RETRACT,
    (S.ENTER, E.RELEASE): S.RETRACT,
    (S.ENTER, E.EJECTED): S.FACE,
    (S.LOCKED, E.RELEASE): S.RETRACT,
    (S.RETRACT, E.HELD): S.LOCKED,
    (S.RETRACT, E.ARRIVED): S.NEUTRAL,
}


class Stroke(NamedTuple):
    """One axial movement: from rest position to end position, position growing with time^power."""

    since_us: float
    start_us: float
    end_us: float
    from_m: float
    to_m: float
    power: int

    def at(self, time_us: float) -> float:
        """Distance from neutral, m."""
        if time_us >= self.end_us:
            return self.to_m
        if time_us <= self.start_us:
            return self.from_m
        share = (time_us - self.start_us) / (self.end_us - self.start_us)
        return self.from_m + (self.to_m - self.from_m) * share**self.power


class Movement(Protocol):
    """Any law of axial movement; it holds from `since_us` on and rests from `end_us` on."""

    @property
    def since_us(self) -> float:
        """When it begins to hold."""

    @property
    def end_us(self) -> float:
        """When it is over."""

    def at(self, time_us: float) -> float:
        """Distance from neutral, m."""


def resting(since_us: float, position_m: float) -> Stroke:
    """No movement."""
    return Stroke(since_us, since_us, since_us, position_m, position_m, 1)


class MainSleeve(Protocol):
    """What is asked of a main sleeve, however it moves. `side` is the direction of the gear it is
    at or moves to or from, -1 or +1, and 0 where it stands between its gears."""

    side: int
    state: SleeveState

    @property
    def meshed(self) -> bool:
        """Whether the teeth of gear and sleeve overlap."""

    @property
    def next_us(self) -> float:
        """When something of it is due."""

    @property
    def stroke_end_us(self) -> float:
        """When the present movement ends or has ended; never, where that is not known yet."""

    def position_m(self, time_us: float) -> float:
        """Signed distance from neutral, at most 10 ms before the newest change."""

    def moves_after(self, time_us: float) -> bool:
        """Whether the position at or after that instant may differ from the present one."""


class SleeveAxis:
    """One sleeve: axial state and position. `side` is the direction of the gear it is at or moves
    to or from, -1 or +1, and 0 in neutral."""

    def __init__(self, actuator: SleeveActuator, engaged_side: int) -> None:
        self._actuator = actuator
        self.side = engaged_side
        self.state = S.LOCKED if engaged_side else S.NEUTRAL
        self._strokes: list[Movement] = [resting(0.0, actuator.stroke_m if engaged_side else 0.0)]
        self._sides = [engaged_side]
        self.contact_us = NEVER_US
        self.unmesh_us = NEVER_US
        self.neutral_us = NEVER_US

    @property
    def meshed(self) -> bool:
        """Whether the teeth of gear and sleeve overlap."""
        return self.state in (S.ENTER, S.LOCKED) or self.unmesh_us < NEVER_US

    @property
    def stroke_end_us(self) -> float:
        """When the present movement ends or has ended."""
        return self._strokes[-1].end_us

    @property
    def next_us(self) -> float:
        """When contact, the end of the overlap or neutral is due."""
        return min(self.contact_us, self.unmesh_us, self.neutral_us)

    def position_m(self, time_us: float) -> float:
        """Signed distance from neutral, at most 10 ms before the newest change."""
        index = len(self._strokes) - 1
        while index > 0 and time_us < self._strokes[index].since_us:
            index -= 1
        return self._sides[index] * self._strokes[index].at(time_us)

    def moves_after(self, time_us: float) -> bool:
        """Whether the position at or after that instant may differ from the present one."""
        return self._strokes[-1].end_us > time_us

    def at_full_stroke(self, time_us: float) -> bool:
        """Whether the sleeve is fully in, where its detent holds it."""
        return self.state in (S.ENTER, S.LOCKED) and self._strokes[-1].end_us <= time_us

    def has_set_off(self, time_us: float) -> bool:
        """Whether the present movement has begun."""
        stroke = self._strokes[-1]
        return stroke.at(time_us) != stroke.at(stroke.since_us)

    def stands(self, time_us: float) -> bool:
        """Whether an activation moves it: in neutral, locked, or in the gap at full stroke."""
        return self.state in (S.NEUTRAL, S.LOCKED) or self.at_full_stroke(time_us)

    def engage(self, time_us: float, side: int, delay_s: float) -> None:
        """The valve towards a gear is energised: contact comes exactly delay_s later."""
        self._go(E.ENGAGE)
        self.side = side
        self.contact_us = time_us + delay_s * SECOND_US
        start_us = time_us + self._actuator.valve_delay_s * SECOND_US
        contact_m = self._actuator.to_contact_m
        self._move(Stroke(time_us, start_us, self.contact_us, 0.0, contact_m, 2))

    def release(self, time_us: float, delay_s: float) -> None:
        """The opposite valve is energised: neutral is reached exactly delay_s later."""
        from_m = abs(self.position_m(time_us))
        locked = self.state is S.LOCKED
        self._go(E.RELEASE)
        start_us = time_us + self._actuator.valve_delay_s * SECOND_US
        self.neutral_us = time_us + delay_s * SECOND_US
        if locked:
            share = math.sqrt(1.0 - min(self._actuator.to_contact_m / from_m, 1.0))
            self.unmesh_us = start_us + share * (self.neutral_us - start_us)
        self._move(Stroke(time_us, start_us, self.neutral_us, from_m, 0.0, 2))

    def let_go(self, time_us: float) -> None:
        """The valve towards the gear is off before anything holds the sleeve: back to neutral."""
        from_m = abs(self.position_m(time_us))
        self._go(E.LET_GO)
        self.contact_us = NEVER_US
        self.neutral_us = time_us + from_m / self._actuator.speed_m_s * SECOND_US
        self._move(Stroke(time_us, time_us, self.neutral_us, from_m, 0.0, 1))

    def hold(self, time_us: float) -> None:
        """The release is given up before the sleeve has moved: on to full stroke."""
        self._go(E.HELD)
        self.unmesh_us = self.neutral_us = NEVER_US
        self._move_in(time_us)

    def rest_on_tooth(self, time_us: float) -> None:
        """Contact, tooth on tooth."""
        self._go(E.ON_TOOTH)
        self.contact_us = NEVER_US
        self._move(resting(time_us, self._actuator.to_contact_m))

    def enter(self, time_us: float) -> None:
        """The gear's tooth stands in the gap: on to full stroke."""
        self._go(E.IN_GAP)
        self.contact_us = NEVER_US
        self._move_in(time_us)

    def lock(self) -> None:
        """The tooth is at the flank."""
        self._go(E.AT_FLANK)

    def unmesh(self) -> None:
        """The teeth have left each other."""
        self.unmesh_us = NEVER_US

    def arrive(self, time_us: float) -> None:
        """Back in neutral."""
        self._go(E.ARRIVED)
        self.neutral_us = NEVER_US
        self.side = 0
        self._move(resting(time_us, 0.0))

    def _go(self, event: SleeveEvent) -> None:
        self.state = SLEEVE_TRANSITIONS[self.state, event]

    def _move_in(self, time_us: float) -> None:
        from_m = abs(self.position_m(time_us))
        to_m = self._actuator.stroke_m
        end_us = time_us + (to_m - from_m) / self._actuator.speed_m_s * SECOND_US
        self._move(Stroke(time_us, time_us, end_us, from_m, to_m, 1))

    def _move(self, stroke: Movement) -> None:
        oldest_us = stroke.since_us - STROKES_KEPT_US
        while len(self._strokes) > 1 and self._strokes[1].since_us < oldest_us:
            del self._strokes[0], self._sides[0]
        self._strokes.append(stroke)
        self._sides.append(self.side)


class ShiftingSleeve:
    """Splitter or range sleeve: it changes over from one of its two sides to the other in the same
    delay; the ratio changes as it arrives. Between the sides it moves under constant force, as long
    as its cylinder has air."""

    def __init__(self, actuator: SleeveActuator, side: int) -> None:
        self._actuator = actuator
        self.side = side
        self.jammed = False
        self.arrival_us = NEVER_US
        self.baulked = False
        """Held at the cones until both sides have one speed."""
        self.loose = False
        """Without air on its way: it stands where it was, and nothing presses on its cones."""
        self._stroke = resting(0.0, side * actuator.stroke_m)

    def change_over(self, time_us: float, side: int, delay_s: float, baulked: bool = False) -> None:
        """Move to this side; arrives exactly delay_s later: there, or `baulked` at the cones on the
        way, where it stays until `go_in`."""
        self.side, self.baulked, self.loose = side, baulked, False
        self.arrival_us = time_us + delay_s * SECOND_US
        start_us = time_us + self._actuator.valve_delay_s * SECOND_US
        way_m = self._actuator.to_contact_m if baulked else self._actuator.stroke_m
        from_m = self._stroke.at(time_us)
        self._stroke = Stroke(time_us, start_us, self.arrival_us, from_m, side * way_m, 2)

    def let_go(self, time_us: float) -> None:
        """The air is out before the cones hold. A sleeve that has not left the teeth of its old
        side yet is drawn back by its detent and has to meet them anew; any other stays."""
        position_m = self._stroke.at(time_us)
        if position_m * self.side < -self._actuator.to_contact_m:
            self.side = -self.side
            back_m = self.side * self._actuator.stroke_m - position_m
            self.arrival_us = time_us + abs(back_m) / self._actuator.speed_m_s * SECOND_US
            end_m = self.side * self._actuator.stroke_m
            self._stroke = Stroke(time_us, time_us, self.arrival_us, position_m, end_m, 1)
            self.baulked = False
            return
        self.loose, self.arrival_us = True, NEVER_US
        self._stroke = resting(time_us, position_m)

    def go_in(self, time_us: float) -> None:
        """The cones hold: nothing keeps a baulked sleeve from its teeth any more."""
        if not self.baulked or self.loose or self.arrival_us != NEVER_US:
            return
        self.baulked = False
        from_m, to_m = self._stroke.at(time_us), self.side * self._actuator.stroke_m
        end_us = time_us + abs(to_m - from_m) / self._actuator.speed_m_s * SECOND_US
        self._stroke = Stroke(time_us, time_us, end_us, from_m, to_m, 1)

    @property
    def under_way(self) -> bool:
        """Whether it is between its sides and nothing of it rubs."""
        return self.loose or self.arrival_us != NEVER_US

    def arrive(self) -> None:
        """The other side has been reached."""
        self.arrival_us = NEVER_US

    def position_m(self, time_us: float) -> float:
        """Signed distance from the middle, m."""
        return self._stroke.at(time_us)

    def moves_after(self, time_us: float) -> bool:
        """Whether the position at or after that instant may differ from the present one."""
        return self._stroke.end_us > time_us
