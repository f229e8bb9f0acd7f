"""The guard over clutch and engine: reads the finished ClutchCommand and TSC1 frames with its own
decode and passes them or says which row forbids them.

What stands in their place is the safe one: a clutch commanded to open, an engine asked for nothing.
An open clutch is always allowed, and so is the end of an engine request.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from meshpoint.controller.guard.limits import (
    CLEAR_M,
    CLUTCH_CLOSED_SHARE,
    GUARD_NEUTRAL_M,
    LEAVING_M_S,
    GuardLimits,
    end_of,
)
from meshpoint.controller.guard.view import GuardInputs

CLUTCH_LENGTH: Final = 8
CLUTCH_ACTION: Final = 3
ENGINE_LENGTH: Final = 8
NO_OVERRIDE, SPEED_CONTROL, TORQUE_CONTROL = range(3)
"""TSC1's control modes that the guard knows; limits are not passed."""
TORQUE_BYTE: Final = 3
TORQUE_OFFSET: Final = 125
PER_CENT: Final = 0.01
TORQUE_NOISE: Final = 1.5 * PER_CENT
"""A step of the signal, and half a one for rounding."""
ACCELERATION_US: Final = 50_000
"""The engine's acceleration is that of its last speeds, over so long: some reads of the sensors,
with which its speed comes."""
ACCELERATION_NOISE_RAD_S2: Final = 3.0
"""Error of that acceleration (rad/s2): the combustion's ripple, and what changes within that
time."""
SPEED_BYTES: Final = slice(1, 3)
SPEED_STEP_RAD_S: Final = 0.125 * math.pi / 30.0
MODE_BITS: Final = 0x03
INPUT, LAYSHAFT, MAIN = range(3)
SPLITTER: Final = 2


def decode_clutch(payload: bytes) -> bool:
    """Whether the clutch is to close: everything but the one value that opens it."""
    if len(payload) != CLUTCH_LENGTH:
        raise ValueError(f"clutch command of {len(payload)} bytes, allowed is {CLUTCH_LENGTH}")
    return payload[CLUTCH_ACTION] != 0


class EngineWish(NamedTuple):
    """A decoded TSC1."""

    mode: int
    speed_rad_s: float
    torque_share: float = 0.0
    """Of the engine's reference torque."""


def decode_engine(payload: bytes) -> EngineWish:
    """Control mode, requested speed and requested torque."""
    if len(payload) != ENGINE_LENGTH:
        raise ValueError(f"TSC1 of {len(payload)} bytes, allowed is {ENGINE_LENGTH}")
    speed = int.from_bytes(payload[SPEED_BYTES], "little") * SPEED_STEP_RAD_S
    torque = (payload[TORQUE_BYTE] - TORQUE_OFFSET) * PER_CENT
    return EngineWish(payload[0] & MODE_BITS, speed, torque)


@dataclass
class DrivelineState:
    """What the guard remembers of the clutch."""

    closing: bool = False
    """The last command that passed was to close."""
    is_closed: bool = False
    """It has been seen closed since."""
    credits: float = 0.0
    """This many closings are allowed before a sleeve has to move."""
    sides: tuple[int, ...] = ()
    """The end each sleeve was last seen in."""
    judged_us: int | None = None
    engine: deque[tuple[int, float]] = field(default_factory=deque)
    """The engine's newest speeds and when they were read; none while one is missing."""
    own_share: tuple[float, float] | None = None
    """None, and the engine's own torque when it began to be taken away, the lesser first; since the
    plates were last apart."""
    takes_away: bool = False
    """The last request that was judged was one for torque."""
    torque_us: int = 0
    """For so long the engine's torque has been taken away since the plates were last apart."""


class DrivelineCase(NamedTuple):
    """What a row is asked about: the closing of the clutch, or the engine request."""

    seen: GuardInputs
    state: DrivelineState
    limits: GuardLimits
    engine: EngineWish = EngineWish(NO_OVERRIDE, 0.0)

    @property
    def gear_in_mesh(self) -> int:
        """The main valve of the gear that a sleeve stands in; 0 none."""
        for valve, gear in self.limits.main.items():
            if self.seen.positions_m[gear.sleeve] * gear.direction > self.limits.engaged_m:
                return valve
        return self.seen.agreeing

    @property
    def teeth_are_out(self) -> bool:
        """Whether both main sleeves are clear of all teeth, in neutral or on their way there. The
        plates meet later than a sleeve that turned back would be seen to."""
        clear_m = self.limits.contact_m - CLEAR_M
        return (
            self.seen.valid
            and not self.seen.agreeing
            and all(
                abs(at_m) <= GUARD_NEUTRAL_M
                or (abs(at_m) <= clear_m and math.copysign(1.0, at_m) * goes_m_s < LEAVING_M_S)
                for at_m, goes_m_s in zip(
                    self.seen.positions_m[:2], self.seen.speeds_m_s, strict=False
                )
            )
        )

    def input_speeds(self) -> list[float]:
        """The input shaft's speed by its own sensor, and by each shaft that it is in mesh with;
        by both splitter steps where the splitter stands in none."""
        _, layshaft, main = speeds = [
            None if speed is None else speed.omega_rad_s for speed in self.seen.speeds[:3]
        ]
        found = [] if speeds[INPUT] is None else [speeds[INPUT]]
        side = self.seen.positions_m[SPLITTER]
        if abs(side) <= self.limits.engaged_m:
            return [speed for speed in found if speed is not None]
        split = self.limits.split_ratio[1 if side > 0.0 else -1]
        found += [] if layshaft is None else [layshaft / split]
        gear = self.gear_in_mesh
        if gear and main is not None:
            found.append(main / (self.limits.main[gear].ratio * split))
        return [speed for speed in found if speed is not None]


Rule = Callable[[DrivelineCase], bool]


def engine_beyond_the_gear(case: DrivelineCase) -> bool:
    """Row 14: a speed over the sheet's limit, or with a gear in mesh one that the slip window of
    row 3 does not hold around the speed this gear gives; a torque other than one between the
    engine's own as the request began and none, or on to the one that changes the engine's speed as
    it changes, with which the clutch carries nothing, before the clutch opens; any other
    control."""
    mode, wanted, _ = case.engine
    if mode == NO_OVERRIDE:
        return False
    if mode == TORQUE_CONTROL:
        return not _takes_torque_away(case)
    limits, gear, main = case.limits, case.gear_in_mesh, case.seen.speeds[MAIN]
    if mode != SPEED_CONTROL or not case.seen.valid or wanted > limits.input_max_rad_s:
        return True
    if not gear:
        return False
    if main is None:
        return True
    ratios = [limits.main[gear].ratio * split for split in limits.split_ratio.values()]
    if abs(case.seen.positions_m[SPLITTER]) > limits.engaged_m:
        ratios = [ratios[0] if case.seen.positions_m[SPLITTER] < 0.0 else ratios[1]]
    low, high = limits.slip_rad_s
    return not (
        (main.omega_rad_s + low) / max(ratios) <= wanted <= (main.omega_rad_s + high) / min(ratios)
    )


def _takes_torque_away(case: DrivelineCase) -> bool:
    """Whether the torque asked for lies between the engine's own as the request began and none: on
    the way shafts may need some of it once more to come to rest. Or beyond none no further than
    what the clutch carries then: with none asked for it has to turn the engine as the vehicle slows
    down or speeds up. And this for no longer than ramp and clutch may take."""
    own, is_known = case.state.own_share, case.seen.engine_torque_share is not None
    if own is None or not is_known or not case.seen.valid:
        return False
    if case.state.torque_us > case.limits.torque_away_us:
        return False
    turning = _turning_share(case)
    low, high = min(own[0], turning[0]), max(own[1], turning[1])
    return low - TORQUE_NOISE <= case.engine.torque_share <= high + TORQUE_NOISE


def _engine_measurements(limits: GuardLimits) -> int:
    """How many speeds, one a step, give the engine's acceleration."""
    return 1 + ACCELERATION_US // limits.tick_us


def _turning_share(case: DrivelineCase) -> tuple[float, float]:
    """The least and the most torque that changes the engine's speed as it has changed of late, as a
    share of its reference torque; none where its speed is not known for long enough."""
    measurements, limits = case.state.engine, case.limits
    if (
        len(measurements) < _engine_measurements(limits)
        or case.seen.clutch_closed <= limits.clutch_open_share
    ):
        return 0.0, 0.0
    (first_us, first), (last_us, last) = measurements[0], measurements[-1]
    rate = (last - first) / max(1, last_us - first_us) * 1e6
    inertia, noise = limits.engine_share_s2, ACCELERATION_NOISE_RAD_S2
    if abs(rate) <= noise:
        return 0.0, 0.0
    return inertia * (rate - noise), inertia * (rate + noise)


def closing_onto_slip(case: DrivelineCase) -> bool:
    """Row 15: the clutch closes with a gear in, or teeth not proven out, on more slip than the
    sheet's closest step leaves, or on a slip that is not known. Shafts that give no edges stand."""
    if case.state.is_closed or case.teeth_are_out:
        return False
    engine = case.seen.engine_rad_s
    if engine is None or not case.seen.valid:
        return True
    turning = case.input_speeds() or [0.0]
    return max(abs(engine - speed) for speed in turning) > case.limits.plate_slip_rad_s


def closing_too_often(case: DrivelineCase) -> bool:
    """Row 16: one closing more than a shift takes while no sleeve has moved."""
    return not case.state.closing and case.state.credits < 1.0


class DrivelineRow(NamedTuple):
    """One rule: its number in docs/guard.md, and the test."""

    number: int
    forbids: Rule


CLUTCH_ROWS: Final = (DrivelineRow(15, closing_onto_slip), DrivelineRow(16, closing_too_often))
ENGINE_ROWS: Final = (DrivelineRow(14, engine_beyond_the_gear),)


class DrivelineGuard:
    """Judges finished clutch and engine frames; the clutch's first, once a step."""

    def __init__(self, limits: GuardLimits) -> None:
        self._limits = limits
        self._state = DrivelineState(credits=float(limits.closings))
        self.blocks = 0
        self.blocked_row: int | None = None

    def passes_clutch(self, payload: bytes, seen: GuardInputs) -> bool:
        """Whether the clutch command may go out; where not, the clutch has to be opened."""
        state = self._state
        self._note(seen)
        closes = decode_clutch(payload)
        row = self._judge(CLUTCH_ROWS, DrivelineCase(seen, state, self._limits)) if closes else None
        self.blocked_row = row
        if row is not None or not closes:
            state.closing = state.is_closed = False
            return row is None
        if not state.closing:
            state.closing = True
            state.credits -= 1.0
        return True

    def passes_engine(self, payload: bytes, seen: GuardInputs) -> bool:
        """Whether the engine request may go out; where not, the request has to be ended."""
        self._note_engine(seen)
        wish = decode_engine(payload)
        self._note_request(wish.mode == TORQUE_CONTROL, seen.engine_torque_share)
        case = DrivelineCase(seen, self._state, self._limits, wish)
        self.blocked_row = self._judge(ENGINE_ROWS, case)
        if seen.valid and seen.clutch_closed <= self._limits.clutch_open_share:
            self._state.torque_us, self._state.takes_away, self._state.own_share = 0, False, None
        elif wish.mode == TORQUE_CONTROL:
            self._state.torque_us += self._limits.tick_us
        return self.blocked_row is None

    def _note_request(self, takes_away: bool, share: float | None) -> None:
        """The engine's torque as a request for torque begins. One that begins anew before the
        plates have parted gives no more back than what was left then: bit by bit, with what the
        signal's steps allow, it could come to any torque."""
        state = self._state
        if takes_away and not state.takes_away and share is not None:
            low, high = state.own_share or (-math.inf, math.inf)
            state.own_share = max(low, min(share, 0.0)), min(high, max(share, 0.0))
        state.takes_away = takes_away and (state.takes_away or share is not None)

    def _note_engine(self, seen: GuardInputs) -> None:
        """The speed at each step of a request; anew after a pause."""
        measurements = self._state.engine
        pause_us = seen.now_us - measurements[-1][0] if measurements else 0
        if seen.engine_rad_s is None or not 0 <= pause_us <= 2 * self._limits.tick_us:
            measurements.clear()
        if seen.engine_rad_s is not None and not (measurements and pause_us == 0):
            measurements.append((seen.now_us, seen.engine_rad_s))
        if len(measurements) > _engine_measurements(self._limits):
            measurements.popleft()

    def _judge(self, rows: tuple[DrivelineRow, ...], case: DrivelineCase) -> int | None:
        for row in rows:
            if row.forbids(case):
                self.blocks += 1
                return row.number
        return None

    def _note(self, seen: GuardInputs) -> None:
        """Whether the clutch is closed, and what may close again."""
        state, limits = self._state, self._limits
        if seen.valid:
            state.is_closed = state.closing and seen.clutch_closed >= CLUTCH_CLOSED_SHARE
            sides = tuple(end_of(position, limits.engaged_m) for position in seen.positions_m)
            moved = bool(state.sides) and sides != state.sides
            state.credits += moved
            state.sides = sides
        since_us = 0 if state.judged_us is None else max(0, seen.now_us - state.judged_us)
        earned = since_us / limits.closing_again_us
        state.credits = min(state.credits + earned, float(limits.closings))
        state.judged_us = seen.now_us
