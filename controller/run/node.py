"""The controller on a bus, alone there: bytes and a time, no decisions.

A newcomer leaves the bus to the controller at work, and one that finds another beside it switches
its valves off and falls silent. Both would send the same identifiers with counters of their own, so
that the valve side could trust neither. Whose frames are whose is known by what was sent from here:
an interface may return them.

The core says when it knows more (a shift has ended, a phase reference has come or gone); the keeper
takes the calibration then and at the end, and has it written.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Final

from meshpoint.bus.clock import NodeClock
from meshpoint.bus.command_keys import CommandKeys
from meshpoint.bus.core import AroundCore, Core, Step
from meshpoint.bus.driver import OpenBus, run_node
from meshpoint.bus.optional import (
    classic_controller,
    classic_signs,
    diagnosed,
    proven,
    recorded_steps,
)
from meshpoint.bus.outage_record import OutageRecord
from meshpoint.bus.profile import WireProfile
from meshpoint.bus.records import Records
from meshpoint.bus.settle import settle
from meshpoint.bus.statistics import NodeStatistics
from meshpoint.controller.core.core import OWN_ADDRESS, ControllerCore
from meshpoint.controller.run.kept import Keep
from meshpoint.controller.run.warm_up import warm_up
from meshpoint.controller.settings.header import RunHeader
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import read_alone
from meshpoint.dbc.messages import Estimator

LISTEN_US: Final = 250_000
"""How long a newcomer listens: 25 cycles of a controller's status and of its valve command."""
LOOK_US: Final = 10_000
WITHIN_US: Final = 100_000
MOST_FRAMES: Final = 3
"""This many frames of another one within `WITHIN_US` are a controller: one alone is an accident."""
REMEMBERED: Final = 2_048
"""Own frames, of the last 10 s: longer than any interface keeps them."""
Signs = Mapping[int, Callable[[Frame], object]]
"""Frames that a controller sends all the time, and nobody else: by identifier, what makes a message
of one, or None where it is damaged."""
SIGNS: Final[Signs] = {
    CODECS[name].spec.can_id: partial(read_alone, CODECS[name])
    for name in ("ControllerStatus", "ValveCommand")
}
"""Those of CAN FD, one of each a step."""
NEWCOMER: Final = (
    "another controller is at work on this bus: this one leaves without having sent anything. "
    "End the other one first, or watch beside it with --shadow"
)
BESIDE: Final = (
    "another controller sends on this bus as well: this one has switched its valves off, is silent "
    "and ends. Start the one that is to stay again, alone"
)

ADDRESSES: Final = frozenset({OWN_ADDRESS})


class OtherControllerError(Exception):
    """There is another controller on the bus; the message is for the user."""


class OnlyController(AroundCore[Core]):
    """A controller that shares its bus with no other one."""

    def __init__(
        self,
        core: Core,
        leave: Callable[[], None],
        signs: Signs = SIGNS,
        *,
        is_proven: bool = False,
    ) -> None:
        """leave: called once, when this controller is to end. signs: those of this bus. is_proven:
        its commands are (`--keys`). The gearbox takes no others then, and whoever forges frames
        without the keys is not to silence it: at work it goes on."""
        super().__init__(core)
        self._leave, self._is_proven = leave, is_proven
        self._signs = signs
        self._sent: dict[tuple[int, bytes], None] = {}
        self._listens_until_us: int | None = None
        self._look_us = 0
        """When the next look is due while it listens."""
        self._is_at_work = False
        self._foreign = 0
        """Frames of another one since the last step."""
        self._seen_us: list[int] = []
        self.conflict = ""
        """Why this controller ends; empty as long as it is the only one."""

    def receive(self, frame: Frame) -> None:
        """As the core inside, once it is at work; what came before is not of its time."""
        if self._is_at_work:
            self._core.receive(frame)

    def receive_own(self, frame: Frame) -> None:
        """A frame under this controller's own address: one that it has sent, or another's."""
        message_of = self._signs.get(frame.can_id)
        if message_of is None or (frame.can_id, frame.data) in self._sent:
            return
        self._foreign += message_of(frame) is not None

    @property
    def next_step_us(self) -> int:
        """The next look while it listens, then as the core inside."""
        return self._core.next_step_us if self._is_at_work else self._look_us

    def step(self, now_us: int) -> Step:
        """As the core inside, unless there is another controller: then its last frames, once."""
        if self.conflict:
            return Step([], [])
        seen_us = [each for each in self._seen_us if now_us - each <= WITHIN_US]
        self._seen_us = seen_us + [now_us] * min(self._foreign, MOST_FRAMES)
        self._foreign = 0
        if self._listens_until_us is None:
            self._listens_until_us = now_us + LISTEN_US
        if not self._is_at_work:
            return self._listen(now_us)
        if self._has_company and not self._is_proven:
            return self._end(BESIDE, now_us)
        step = self._core.step(now_us)
        self._remember(step.frames)
        return step

    def _listen(self, now_us: int) -> Step:
        if self._has_company:
            return self._end(NEWCOMER, now_us)
        self._look_us = now_us + LOOK_US
        if now_us < (self._listens_until_us or 0):
            return Step([], [])
        self._is_at_work = True
        return self.step(now_us)

    @property
    def _has_company(self) -> bool:
        return len(self._seen_us) >= MOST_FRAMES

    def _end(self, why: str, now_us: int) -> Step:
        last = self._core.shutdown(now_us) if self._is_at_work else Step([], [])
        self.conflict = why
        self._leave()
        return last

    def _remember(self, frames: list[Frame]) -> None:
        for frame in frames:
            if frame.can_id in self._signs:
                self._sent.pop((frame.can_id, frame.data), None)
                self._sent[frame.can_id, frame.data] = None
        while len(self._sent) > REMEMBERED:
            del self._sent[next(iter(self._sent))]

    def shutdown(self, now_us: int) -> Step:
        """As the core inside; nothing where it has sent its last frames, or none at all."""
        if self.conflict or not self._is_at_work:
            return Step([], [])
        return self._core.shutdown(now_us)


class CalibrationKeeper(AroundCore[ControllerCore]):
    """A controller core that hands its calibration out whenever it calibration_revision more."""

    def __init__(self, core: ControllerCore, keep: Keep, written: Callable[[int], str]) -> None:
        """`written` says in words when it is, of the driver's clock in microseconds."""
        super().__init__(core)
        self._keep = keep
        self._written = written
        self._knows = core.calibration_revision

    def step(self, now_us: int) -> Step:
        """The core's step; after it the calibration where more is known."""
        step = self._core.step(now_us)
        if self._core.calibration_revision != self._knows:
            self._knows = self._core.calibration_revision
            step.events.extend(self.keep(now_us))
        return step

    def shutdown(self, now_us: int) -> Step:
        """The core's last frames, and its last calibration."""
        step = self._core.shutdown(now_us)
        return Step(step.frames, [*step.events, *self.keep(now_us)])

    def keep(self, now_us: int) -> list[str]:
        """Hands the calibration out now; lines for the log."""
        line = self._keep(self._core.calibration(self._written(now_us)))
        return [] if line is None else [line]


async def run_controller(
    header: RunHeader,
    open_bus: OpenBus,
    clock: NodeClock,
    *,
    on_event: Callable[[str], None],
    stop: asyncio.Event,
    keep: Keep | None = None,
    around: Callable[[Core, ControllerCore], Core] | None = None,
    keys: CommandKeys | None = None,
    diagnosis: bool = False,
    record: Path | None = None,
    wire: WireProfile = WireProfile.FD,
    address: int = OWN_ADDRESS,
) -> NodeStatistics:
    """Runs a controller until `stop` is set; its last frames switch all valves off.
    OtherControllerError where there is another one on the bus.

    `keep` gets the calibration whenever more is known, and at the end. `around` puts something
    around the node of this core, as the XCP slave. With `keys` commands are proven to be ours. With
    `diagnosis` it claims its address, reports its trouble codes and answers testers
    (docs/diagnosis.md). `record`: a folder, that of the run header, for what a replay needs to know
    of link outages, and of every step where `wire` is classic; what of it cannot be written is said
    and counted. `wire`: the frames on the bus. `address`: the controller's on this bus, which
    `open_bus` has put in the DBC's place."""
    warm_up(baselines=header.settings.estimator is not Estimator.CROSSING)
    core = ControllerCore(header)
    kept: Core = core if keep is None else CalibrationKeeper(core, keep, _utc)
    statistics = NodeStatistics()
    records = None if record is None else Records(record)
    if records is not None and wire is WireProfile.FD:
        kept = OutageRecord(kept, records, header.run_hash, lambda: statistics.frames_discarded)
    node = kept if around is None else around(kept, core)
    if keys is not None:
        node = proven(node, keys)
    if diagnosis:
        node = diagnosed(node, header.version, address)
    if wire is WireProfile.CLASSIC:
        node = classic_controller(node, header.sheet)
        if records is not None:
            node = recorded_steps(node, records, header.run_hash, diagnosed=diagnosis)
    signs = classic_signs() if wire is WireProfile.CLASSIC else SIGNS
    only = OnlyController(node, stop.set, signs, is_proven=keys is not None)
    settle()
    await run_node(
        only,
        open_bus,
        clock,
        on_event=on_event,
        stop=stop,
        name="controller",
        own_addresses=ADDRESSES,
        statistics=statistics,
        on_own=only.receive_own,
        records=records,
    )
    if only.conflict:
        raise OtherControllerError(only.conflict)
    return statistics


def _utc(_now_us: int) -> str:
    """The wall clock, for people: the controller's own clock begins anywhere."""
    return datetime.now(UTC).isoformat(timespec="seconds")
