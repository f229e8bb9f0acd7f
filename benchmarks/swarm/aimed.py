"""Worlds with which every swarm begins: each is aimed at a corner that chance seldom finds.

A fault strikes when the sequence enters a state: some states last for hundredths of a second, and
many ways out of them exist for faults alone. Then the sequence goes mad in each of its ways, one
for each row of the guard. The gearbox is as built by the world's own seed.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from benchmarks.swarm.deeds import DEEDS
from benchmarks.swarm.events import REQUEST, Event, Group, World
from meshpoint.dbc.messages import ControllerState

ASKED_MS: Final = 400
SAFETY_MS: Final = 5_000
MAD_MS, MAD_FOR_MS = 300, 3_000
UP_RPM, DOWN_RPM = 1400.0, 1100.0
SLOW, STATUS = int(Group.SLOW), int(Group.VALVE_STATUS)


class Strike(NamedTuple):
    """A fault that begins when the sequence enters `state`; without one, at `at_ms`."""

    state: str
    kind: str
    target: int = 0
    value: float = 0.0
    for_ms: int = 900
    at_ms: int = ASKED_MS


class Aim(NamedTuple):
    """A shift, what strikes it, and what has to be reached by it."""

    reaches: str
    """A transition as `state+trigger`, or a fault code."""
    strikes: tuple[Strike, ...]
    from_: int = 8
    to: int = 10
    settings: tuple[tuple[str, float], ...] = ()
    dog_splitter: bool = False

    def world(self, seed: int) -> World:
        """The world of it."""
        events = [Event(ASKED_MS, REQUEST, 0, float(self.to))]
        events += [Event(s.at_ms, s.kind, s.target, s.value, s.for_ms, s.state)
                   for s in self.strikes]  # fmt: skip
        layshaft_rpm = UP_RPM if self.to > self.from_ else DOWN_RPM
        events.sort()
        settings, has_dog = dict(self.settings), self.dog_splitter
        return World(seed, self.from_, layshaft_rpm, settings, tuple(events), SAFETY_MS, has_dog)


def _deaf(state: str) -> tuple[Strike, ...]:
    """Positions no longer arrive: the shift ends without knowing its gear."""
    return (Strike(state, "bus_drop", SLOW, 1.0),)


def _unlinked(state: str) -> tuple[Strike, ...]:
    """The valve side's status no longer arrives: the shift ends in the gear it is in."""
    return (Strike(state, "bus_drop", STATUS, 1.0),)


SECOND_STUCK: Final = Strike("synchronising", "valve_stuck", 4, 0.0, 3_000)
"""The valve of second gear, which 8 -> 10 engages: its sleeve stays in the middle."""
SECOND_JAMMED: Final = Strike("synchronising", "sleeve_jammed", 0, 0.0, 3_000)
"""Its sleeve stays in the middle though the valve is driven."""
UNSEEN: Final = Strike("engaging", "bus_drop", int(Group.EDGES), 1.0)
SHOWS_SECOND: Final = 12.0
"""The first sleeve, in neutral, seems to stand in second gear, which 8 -> 10 engages."""
SHOWS_FIRST: Final = -12.0


def _brought_in(state: str, position_mm: float) -> Strike:
    """A gear is seen in mesh that no valve has engaged."""
    return Strike(state, "position_offset", 0, position_mm, 600)


BETWEEN: Final = Strike("engaging", "position_offset", 1, 5.0, 1_600)
"""The other sleeve seems to stand between two gears."""
JAMMED: Final = Strike("clutch_opening", "sleeve_jammed", 0, 0.0, 3_000)
DOG_JAMMED: Final = (Strike("", "sleeve_jammed", 2, 0.0, 4_000, at_ms=ASKED_MS + 450),)
"""Between its steps, out of the old one: what a splitter with dog teeth does for the longest."""
AT_ONCE: Final = (("limits.blocks", 1.0),)
"""The first block of the guard ends the shift."""
PULLED: Final = Strike("", "mad_pull_under_torque", for_ms=1_000, at_ms=300)
"""The sequence goes mad as a shift begins: it closes the clutch and pulls the gear out."""
HELD: Final = Strike("clutch_parting", "clutch_stuck", for_ms=2_500)

AIMS: Final = (
    Aim("clutch_opening+gear_unknown", _deaf("clutch_opening")),
    Aim("clutch_opening+gave_up", (Strike("clutch_opening", "clutch_stuck", for_ms=2_500),)),
    Aim("disengaging+gear_unknown", (JAMMED, *_deaf("disengaging"))),
    Aim("disengaging+gave_up", (JAMMED,)),
    Aim("splitter_changing+gear_unknown", _deaf("splitter_changing"), 8, 7),
    Aim("splitter_changing+gave_up", _unlinked("splitter_changing"), 8, 7),
    Aim("splitter_failed", (Strike("clutch_opening", "sleeve_jammed", 2, 0.0, 4_000),), 8, 7),
    Aim("splitter_failed", DOG_JAMMED, 8, 7, dog_splitter=True),
    Aim("splitter_changing+leg_done", (), 9, 8, dog_splitter=True),
    Aim("engaging+leg_done", (), 8, 9, dog_splitter=True),
    Aim("range_failed", (Strike("clutch_opening", "sleeve_jammed", 3, 0.0, 4_000),), 6, 8),
    Aim("steps_changing+gear_unknown", _deaf("steps_changing"), 6, 8),
    Aim("steps_changing+gave_up", _unlinked("steps_changing"), 6, 8),
    Aim("synchronising+gear_unknown", _deaf("synchronising")),
    Aim("synchronising+gave_up", (_brought_in("synchronising", SHOWS_FIRST),)),
    Aim("synchronising+engaged", (_brought_in("synchronising", SHOWS_SECOND),)),
    Aim("speed_raising+engaged", (_brought_in("speed_raising", SHOWS_FIRST),), 10, 8),
    Aim("speed_raising+gear_unknown", _deaf("speed_raising"), 10, 8),
    Aim("speed_raising+gave_up", _unlinked("speed_raising"), 10, 8),
    Aim("clutch_parting+engaged", (_brought_in("clutch_parting", SHOWS_FIRST),), 10, 8),
    Aim("clutch_parting+gear_unknown", (HELD, *_deaf("clutch_parting")), 10, 8),
    Aim("clutch_parting+gave_up", (HELD,), 10, 8),
    Aim("coasting+engaged", (_brought_in("coasting", SHOWS_SECOND),)),
    Aim("coasting+gear_unknown", _deaf("coasting")),
    Aim("coasting+gave_up", _unlinked("coasting")),
    Aim("engaging+gear_unknown", _deaf("engaging")),
    Aim("engaging+gave_up", (SECOND_JAMMED, UNSEEN)),
    Aim("retracting+gear_unknown", (BETWEEN,)),
    Aim("retracting+gave_up", (SECOND_STUCK,), settings=(("limits.attempts", 1.0),)),
    Aim("clutch_closing+gear_unknown",
        (Strike("clutch_closing", "position_offset", 0, -6.0, 1_600),)),
    Aim("faulted+found_in_neutral", _deaf("synchronising")),
    Aim("starting+found_in_neutral", (Strike("synchronising", "controller_restarted"),)),
    Aim("disengage_refused", (PULLED,), settings=AT_ONCE),
    Aim("brake_limit", (Strike("synchronising", "brake_fade", 0, 0.0, 2_500),),
        settings=(*AT_ONCE, ("guard.brake_on_ms", 150.0))),
    Aim("guard_blocked", (SECOND_STUCK, *_unlinked("engaging")), settings=AT_ONCE),
    Aim("speed_stale", (Strike("synchronising", "bus_drop", int(Group.EDGES), 1.0),)),
)  # fmt: skip


def mad_world(seed: int, name: str) -> World:
    """The world of a deed: the sequence goes mad in its state, the shift for that is asked for."""
    deed = DEEDS[name]
    events = [Event(0 if deed.begins is None else MAD_MS, name, 0, 0.0, MAD_FOR_MS)]
    if deed.begins not in (None, ControllerState.IN_GEAR):
        events.append(Event(ASKED_MS, REQUEST, 0, float(deed.asks)))
    return World(
        seed, deed.start_gear, deed.layshaft_rpm, {}, tuple(events), SAFETY_MS, deed.dog_splitter
    )


def aimed_world(seed: int, number: int) -> World | None:
    """The world of that number, 0 the first, of a swarm: each aim, then each deed; None where the
    drawn ones begin."""
    if number < len(AIMS):
        return AIMS[number].world(seed)
    names = list(DEEDS)
    number -= len(AIMS)
    return mad_world(seed, names[number]) if number < len(names) else None
