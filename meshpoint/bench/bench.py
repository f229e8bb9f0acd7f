"""The bench operator as a core: brings the rig into the old gear, asks for the new one, N times.

It is a third node on the bus with the same call shape as controller and rig, so one driver runs it
in virtual time and live.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final

from meshpoint.bench.pauses import Pauses
from meshpoint.bus.core import Step
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Receiver, Transmitter
from meshpoint.dbc.messages import (
    TC1,
    BenchAction,
    BenchCommand,
    ControllerState,
    ControllerStatus,
    EngagementEvent,
    Message,
    ReferenceEngagement,
    ShiftOutcome,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import DriveGear, GearboxSheet, drive_gear

TICK_US: Final = 10_000
COMMAND_EVERY: Final = 2
"""BenchCommand goes out every 20 ms."""
REQUEST_EVERY_US: Final = 50_000
PATIENCE_US: Final = 8_000_000
"""A step of the plan that takes longer has failed; the bench goes on with the next shift."""
RETURN_AGAIN_US: Final = 2_000_000
"""A rig that has not returned to a gear in this time is asked again, and begins anew: a tooth may
stand on a tooth. The way back takes half a second."""
MOST_RETURNS: Final = PATIENCE_US // RETURN_AGAIN_US + 1
"""Of one shift at most, each with a sequence number of its own."""
BENCH_IDS: Final = frozenset(
    CODECS[kind.__name__].spec.can_id
    for kind in (ControllerStatus, ShiftOutcome, ReferenceEngagement)
)
MOVING: Final = frozenset(ControllerState) - {
    ControllerState.STARTING,
    ControllerState.IN_GEAR,
    ControllerState.NEUTRAL,
}


@dataclass(frozen=True)
class PlannedShift:
    """From a gear to a gear, with the main shaft at a speed."""

    from_: int
    to: int
    main_rad_s: float

    @property
    def main_rpm(self) -> float:
        """The same in rpm."""
        return self.main_rad_s * 30.0 / math.pi


def plan_shifts(
    sheet: GearboxSheet, pairs: list[tuple[int, int]], shifts: int, layshaft_rad_s: float
) -> list[PlannedShift]:
    """`shifts` shifts cycling through `pairs`; main speed such that the layshaft, in the old gear
    or in the new, turns at the given speed where it turns faster, or at less where the input shaft
    would turn too fast."""
    planned = []
    for i in range(shifts):
        from_, to = pairs[i % len(pairs)]
        before, after = drive_gear(from_), drive_gear(to)
        main = _most_main_rad_s(sheet, before, layshaft_rad_s)
        then = _most_main_rad_s(sheet, after, layshaft_rad_s)
        if after.range_ is not before.range_:
            ratio = sheet.range_mesh(after.range_).ratio
            then *= ratio / sheet.range_mesh(before.range_).ratio
        planned.append(PlannedShift(from_, to, min(main, then)))
    return planned


def _most_main_rad_s(sheet: GearboxSheet, gear: DriveGear, layshaft_rad_s: float) -> float:
    """The main shaft's speed at which a gear turns its layshaft or input shaft at the limit."""
    top = 0.9 * sheet.limits.input_max_rad_s * sheet.split_mesh(gear.split).ratio
    return min(layshaft_rad_s, top) * sheet.main_mesh(gear.main).ratio


class Stage(Enum):
    """What the bench is at."""

    RETURNING = auto()
    SETTLING = auto()
    REQUESTING = auto()
    SHIFTING = auto()
    LEARNING = auto()
    DONE = auto()


@dataclass
class _Seen:
    """What the bus said since the stage began."""

    ready_in: int | None = None
    ready_us: int | None = None
    """The tick at which the rig had said so."""
    outcome: bool = False
    status: ControllerStatus | None = None


class BenchCore:
    """Runs a plan of shifts, which may grow, with these pauses between them."""

    def __init__(self, plan: Sequence[PlannedShift], pauses: Pauses) -> None:
        self._plan = list(plan)
        self._pauses = pauses
        self._receiver = Receiver(Node.BENCH)
        self._transmitter = Transmitter(Node.BENCH)
        self._seen = _Seen()
        self._stage = Stage.RETURNING if plan else Stage.DONE
        self._outbox: list[Frame] = []
        self._since_us: int | None = None
        self._next_us = 0
        self._ticks = 0
        self._asked_us = -REQUEST_EVERY_US
        self._returns = 0
        """How often the rig has been asked again to return to the gear of this shift."""
        self.index = 0
        """Number of the shift being made."""
        self.gave_up: list[int] = []
        """Shifts of which a stage took longer than the bench's patience."""

    @property
    def done(self) -> bool:
        """Whether the plan has run to its end."""
        return self._stage is Stage.DONE

    @property
    def is_asking(self) -> bool:
        """Whether the new gear is being asked for, or is on its way."""
        return self._stage in (Stage.REQUESTING, Stage.SHIFTING)

    def add(self, shift: PlannedShift) -> None:
        """One more shift at the end of the plan; a bench that is done goes on with it."""
        self._plan.append(shift)
        if self._stage is Stage.DONE:
            self._stage = Stage.RETURNING
            self._seen = _Seen(status=self._seen.status)
            self._since_us = None

    def send(self, message: Message) -> None:
        """A message of the bench's own, with its next step. EncodeError where it sends no such."""
        self._outbox.append(self._transmitter.encode(message))

    @property
    def next_step_us(self) -> int:
        """The next tick."""
        return self._next_us

    def receive(self, frame: Frame) -> None:
        """Notes what the plan waits for."""
        if frame.can_id not in BENCH_IDS:
            return
        message = self._receiver.receive(frame).message
        if isinstance(message, ControllerStatus):
            self._seen.status = message
        elif isinstance(message, ShiftOutcome):
            self._seen.outcome = True
        elif isinstance(message, ReferenceEngagement) and message.event is EngagementEvent.READY:
            self._seen.ready_in = message.drive_gear

    def step(self, now_us: int) -> Step:
        """Goes on with the plan; sends what it asks for."""
        if self._since_us is None:
            self._since_us = now_us
        self._receiver.tick(now_us)
        if self._seen.ready_us is None and self._seen.ready_in is not None:
            self._seen.ready_us = now_us
        events = self._go_on(now_us)
        frames = self._frames(now_us)
        self._ticks += 1
        while self._next_us <= now_us:
            self._next_us += TICK_US
        return Step(frames, events)

    def shutdown(self, now_us: int) -> Step:  # noqa: ARG002
        """Nothing to make safe: bench commands are requests."""
        return Step([], [])

    def _go_on(self, now_us: int) -> list[str]:
        if self._stage is Stage.DONE:
            return []
        waited_us = now_us - (self._since_us or 0)
        if self._is_over(now_us, waited_us):
            return self._advance(now_us)
        if self._stage is Stage.RETURNING and self._seen.ready_in is None:
            self._returns = waited_us // RETURN_AGAIN_US
        if waited_us > PATIENCE_US:
            self.gave_up.append(self.index)
            events = [f"bench: shift {self.index + 1} stuck in {self._stage.name.lower()}"]
            self._stage = Stage.LEARNING
            return events + self._advance(now_us)
        return []

    def _is_over(self, now_us: int, waited_us: int) -> bool:
        seen, shift = self._seen, self._plan[self.index]
        status = seen.status
        in_old_gear = (
            status is not None
            and status.state is ControllerState.IN_GEAR
            and status.current_gear == shift.from_
        )
        match self._stage:
            case Stage.RETURNING:
                return seen.ready_in == shift.from_ and in_old_gear
            case Stage.SETTLING:
                locked_us = now_us - (seen.ready_us or 0)
                pauses = self._pauses
                least_us = pauses.locked_least_us(shift.from_)
                return waited_us >= pauses.settle_us and locked_us >= least_us
            case Stage.REQUESTING:
                return seen.outcome or (status is not None and status.state in MOVING)
            case Stage.SHIFTING:
                return seen.outcome
            case _:
                return waited_us >= self._learning_us

    @property
    def _learning_us(self) -> int:
        """How long to stay in the gear the shift went to."""
        gear = drive_gear(self._plan[self.index].to).main
        status = self._seen.status
        is_known = status is not None and status.reference_known >> (gear - 1) & 1
        return self._pauses.learned_us if is_known else self._pauses.learn_us

    def _advance(self, now_us: int) -> list[str]:
        following = {
            Stage.RETURNING: Stage.SETTLING,
            Stage.SETTLING: Stage.REQUESTING,
            Stage.REQUESTING: Stage.SHIFTING,
            Stage.SHIFTING: Stage.LEARNING,
            Stage.LEARNING: Stage.RETURNING,
        }
        self._stage = following[self._stage]
        self._since_us = now_us
        if self._stage is Stage.SETTLING:
            self._seen.outcome = False
        elif self._stage is Stage.RETURNING:
            self._seen = _Seen(status=self._seen.status)
            self._returns = 0
            self.index += 1
            if self.index == len(self._plan):
                self._stage = Stage.DONE
        return []

    def _frames(self, now_us: int) -> list[Frame]:
        frames, self._outbox = self._outbox, []
        if self._plan and self._ticks % COMMAND_EVERY == 0:
            frames.append(self._transmitter.encode(self._command()))
        if self._stage is Stage.REQUESTING and now_us - self._asked_us >= REQUEST_EVERY_US:
            self._asked_us = now_us
            wanted = self._plan[self.index].to
            frames.append(self._transmitter.encode(TC1(requested_gear=wanted)))
        return frames

    def _command(self) -> BenchCommand:
        """The rig acts once on a new sequence number, and only while it is being returned."""
        shift = self._plan[min(self.index, len(self._plan) - 1)]
        action = BenchAction.RETURN_TO_GEAR if self._stage is Stage.RETURNING else BenchAction.HOLD
        return BenchCommand(
            action=action,
            gear=shift.from_,
            sequence=(MOST_RETURNS * self.index + self._returns + 1) & 0xFFFF,
            main_speed_rad_s=shift.main_rad_s,
        )
