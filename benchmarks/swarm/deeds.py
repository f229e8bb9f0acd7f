"""Sequences gone mad: what a controller commands that must not, and from which moment on.

Each deed aims at one row of the guard, under whose eyes it must do no harm; `mad_random` aims at
none in particular.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.messages import ClutchAction, ControllerState, RigFault
from meshpoint.rig_sim.orders import FaultOrder

OPEN, CLOSE = ClutchAction.OPEN, ClutchAction.CLOSE
V, State = ValveName, ControllerState
RANDOM_EVERY_US: Final = 60_000
TO_AND_FRO_US: Final = 20_000


class Wish(NamedTuple):
    """What is commanded."""

    valves: frozenset[ValveName] = frozenset()
    clutch: ClutchAction = OPEN
    engine_rpm: float | None = None


@dataclass(frozen=True)
class Deed:
    """A way to go mad. row: of the guard, 0 none in particular."""

    row: int
    wish: Callable[[int, int], Wish]
    """By the microseconds since it began, and the world's seed."""
    begins: ControllerState | None = State.IN_GEAR
    """The state it waits for; None: at once."""
    asked: bool = True
    """A gear is asked for as it begins: row 17 has then nothing to say."""
    fault: FaultOrder | None = None
    """What goes wrong with the gearbox as it begins."""
    clock_error_us: int = 0
    """How wrong the clock is that its commands are timed by."""
    layshaft_rpm: float = 1400.0
    start_gear: int = 8
    asks: int = 10
    """For this gear, where it waits for a shift's state."""
    dog_splitter: bool = False
    """Whether the splitter that it drives has dog teeth."""


def _drive(
    *valves: ValveName, clutch: ClutchAction = OPEN, after_us: int = 300_000
) -> Callable[[int, int], Wish]:
    """These valves once the clutch has had its time."""

    def wish(since_us: int, _: int) -> Wish:
        return Wish(frozenset(valves if since_us >= after_us else ()), clutch)

    return wish


def _flap(since_us: int, _: int) -> Wish:
    return Wish(clutch=OPEN if since_us // 300_000 % 2 == 0 else CLOSE)


def _race(*_: int) -> Wish:
    return Wish(clutch=CLOSE, engine_rpm=3305.0)


def _race_and_close(since_us: int, _: int) -> Wish:
    return Wish(clutch=OPEN if since_us < 1_500_000 else CLOSE, engine_rpm=2300.0)


def _swing(since_us: int, _: int) -> Wish:
    return Wish(frozenset((V.SPLIT_LOW if since_us // 120_000 % 2 == 0 else V.SPLIT_HIGH,)))


def _to_and_fro(since_us: int, _: int) -> Wish:
    """A sleeve is thrown to and fro, each time as long as braking it takes."""
    return Wish(frozenset((V.MAIN_SECOND if since_us // TO_AND_FRO_US % 2 == 0 else V.MAIN_FIRST,)))


def _random(since_us: int, seed: int) -> Wish:
    """Something else every 60 ms."""
    rng = np.random.Generator(np.random.PCG64([seed, since_us // RANDOM_EVERY_US]))
    count = int(rng.integers(0, 4))
    valves = frozenset(ValveName(int(v)) for v in rng.choice(9, size=count, replace=False))
    engine_rpm = float(rng.uniform(300.0, 4000.0)) if rng.random() < 0.4 else None
    return Wish(valves, ClutchAction(int(rng.integers(0, 2))), engine_rpm)


def _fault(kind: RigFault, target: int, value: float, for_ms: int) -> FaultOrder:
    return FaultOrder(int(kind), target, value, for_ms * 1000)


NEUTRAL = State.SYNCHRONISING
DEEDS: Final[dict[str, Deed]] = {
    "mad_both_valves": Deed(1, _drive(V.MAIN_FIRST, V.MAIN_SECOND)),
    "mad_two_sleeves": Deed(2, _drive(V.MAIN_CRAWL)),
    "mad_slip": Deed(3, _drive(V.MAIN_THIRD, after_us=0), begins=NEUTRAL),
    "mad_unknown_speed": Deed(
        4, _drive(V.MAIN_SECOND, after_us=40_000), begins=NEUTRAL,
        fault=_fault(RigFault.HALL_DROPOUT, 2, 0.0, 1000),
    ),
    "mad_brake_in_gear": Deed(5, _drive(V.BRAKE)),
    "mad_brake": Deed(6, _drive(V.BRAKE, after_us=0), begins=NEUTRAL),
    "mad_blind": Deed(
        7, _drive(V.SPLIT_HIGH, after_us=0), fault=_fault(RigFault.FROZEN_PAYLOAD, 1, 0.0, 1000)
    ),
    "mad_range": Deed(8, _drive(V.RANGE_LOW)),
    "mad_low_split": Deed(9, _drive(V.SPLIT_LOW), layshaft_rpm=2300.0, start_gear=12),
    "mad_pull_under_torque": Deed(
        10, _drive(V.MAIN_SECOND, clutch=CLOSE), begins=State.CLUTCH_OPENING
    ),
    "mad_without_air": Deed(
        11, _drive(V.MAIN_SECOND, after_us=20_000), begins=State.COASTING,
        fault=_fault(RigFault.SUPPLY_DROP, 0, 4.0, 1000),
    ),
    "mad_from_the_start": Deed(12, _drive(V.SPLIT_HIGH, after_us=0), begins=None),
    "mad_against_a_lying_sensor": Deed(
        13, _drive(V.BRAKE, after_us=600_000),
        fault=_fault(RigFault.POSITION_OFFSET, 0, 12.0, 1500),
    ),
    "mad_engine": Deed(14, _race),
    "mad_closing": Deed(15, _race_and_close, start_gear=5, layshaft_rpm=1123.0),
    "mad_flapping": Deed(16, _flap),
    "mad_unasked": Deed(17, _drive(V.MAIN_CRAWL, after_us=200_000), asked=False, start_gear=5),
    "mad_swinging": Deed(18, _swing),
    "mad_clock": Deed(19, _drive(V.SPLIT_HIGH), clock_error_us=-30_000),
    "mad_waiting_before_teeth": Deed(
        20, _drive(V.SPLIT_LOW, after_us=900_000), begins=NEUTRAL,
        fault=_fault(RigFault.POSITION_OFFSET, 0, 3.0, 2500),
    ),
    "mad_split_and_main": Deed(
        2, _drive(V.SPLIT_LOW, V.MAIN_CRAWL, after_us=0), begins=State.SPLITTER_CHANGING,
        start_gear=8, dog_splitter=True, asks=7,
    ),
    "mad_split_slip": Deed(3, _drive(V.SPLIT_LOW), dog_splitter=True),
    "mad_split_unknown_speed": Deed(
        4, _drive(V.SPLIT_LOW, after_us=120_000), begins=State.SPLITTER_CHANGING,
        fault=_fault(RigFault.HALL_DROPOUT, 0, 0.0, 1000), dog_splitter=True, asks=7,
    ),
    "mad_split_too_fast": Deed(
        9, _drive(V.SPLIT_LOW), layshaft_rpm=2300.0, start_gear=12, dog_splitter=True
    ),
    "mad_split_under_torque": Deed(
        10, _drive(V.SPLIT_LOW, clutch=CLOSE), begins=State.CLUTCH_OPENING, dog_splitter=True
    ),
    "mad_split_swinging": Deed(0, _swing, dog_splitter=True),
    "mad_to_and_fro": Deed(3, _to_and_fro, begins=NEUTRAL),
    "mad_random": Deed(0, _random, begins=None),
}  # fmt: skip
