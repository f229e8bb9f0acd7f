"""Controller and gearbox as the swarm watches them: the product's own, with eyes inside."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

from benchmarks.swarm.deeds import Deed, Wish
from meshpoint.bus.core import Step
from meshpoint.controller.core.commands import GuardedCommands
from meshpoint.controller.core.core import POSITIONS, ControllerCore
from meshpoint.controller.measure.inputs import ShaftSpeeds
from meshpoint.controller.settings.header import RunHeader
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.controller.shift.sequence import ShiftSequence
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.table import Trigger
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import EEC1, TC1, ControllerState, ValveStatus
from meshpoint.dbc.node import Node
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.orders import FaultOrder
from meshpoint.rig_sim.shared.script import ScriptStage
from meshpoint.units import RPM

AGAIN_US: Final = 60_000
"""An activation that was refused is commanded anew after this time."""
ACTIONS: Final = slice(3, 6)
"""Of a valve command: the bytes that say what each valve is to do."""
DRIVING_BITS: Final = int("01" * 9, 2)


def drives(payload: bytes) -> bool:
    """Whether a valve command drives a valve now or later: actions OnNow (1) and OnAt (3)."""
    return bool(int.from_bytes(payload[ACTIONS], "little") & DRIVING_BITS)


class WatchedCommands(GuardedCommands):
    """Its commands; notes what the guard sees, and which row has blocked clutch or engine."""

    def __init__(
        self,
        header: RunHeader,
        transmitter: Transmitter,
        sequence: ShiftSequence,
        rows: list[int],
    ) -> None:
        super().__init__(header, transmitter, sequence)
        self._rows = rows
        self.seen: Any = None

    def _clutch_command(self, seen: Any, events: list[str]) -> Frame:
        self.seen = seen
        frame = super()._clutch_command(seen, events)
        self._note_driveline()
        return frame

    def _engine_request(self, seen: Any, events: list[str]) -> list[Frame]:
        frames = super()._engine_request(seen, events)
        if frames and self._sequence.engine_rad_s is not None:
            self._note_driveline()
        return frames

    def _note_driveline(self) -> None:
        if self.driveline.blocked_row is not None:
            self._rows.append(self.driveline.blocked_row)


class WatchedController(ControllerCore):
    """The controller; its sequence can be made to go mad."""

    _guarded: WatchedCommands

    def __init__(self, header: RunHeader, seed: int) -> None:
        super().__init__(header)
        self._seed = seed
        self._deed: Deed | None = None
        self._began_us: int | None = None
        self.transitions: list[tuple[ControllerState, Trigger]] = []
        self.rows: list[int] = []
        """Rows of the guard that have blocked something."""
        self.drives = False
        """Whether the last valve command that went out drives a valve."""
        self.sees_all = True
        """Whether all inputs that a valve needs were valid in the last step."""
        self._guarded = WatchedCommands(header, self._transmitter, self._sequence, self.rows)
        self._sequence.on_transition = lambda state, trigger: self.transitions.append(
            (state, trigger)
        )

    def go_mad(self, deed: Deed | None) -> None:
        """From when its state has come; None: ends it."""
        if deed is None and self._began_us is not None:
            self._board.all_off()
        self._deed, self._began_us = deed, None

    @property
    def seen(self) -> Any:
        """The guard's inputs of the last step."""
        return self._guarded.seen

    @property
    def is_mad(self) -> bool:
        """Whether its deed has begun."""
        return self._began_us is not None

    @property
    def is_proven(self) -> bool:
        """Whether the guard's self-test is passed: before, no valve can be driven."""
        return self._guarded.guard.is_proven

    @property
    def state(self) -> ControllerState:
        """The sequence's."""
        return self._sequence.state

    def step(self, now_us: int) -> Step:
        """A step of the product's, watched."""
        deed = self._deed
        if deed is not None and self._began_us is None and deed.begins in (None, self.state):
            self._began_us = now_us
            if deed.asked:
                wanted = 10 if deed.start_gear == 8 else deed.start_gear - 1
                self.receive(Transmitter(Node.BENCH).encode(TC1(requested_gear=wanted)))
        self._step_us = now_us
        return super().step(now_us)

    def _snapshot(self, now_us: int, speeds: ShaftSpeeds, engine: EEC1 | None) -> StepSnapshot:
        snapshot = super()._snapshot(now_us, speeds, engine)
        if self._deed is None or self._began_us is None or not self._deed.clock_error_us:
            return snapshot
        error_us = self._deed.clock_error_us
        return replace(
            snapshot, now_us=snapshot.now_us + error_us, earliest_us=snapshot.earliest_us + error_us
        )

    def _decide(self, requested: int | None, snapshot: StepSnapshot, events: list[str]) -> None:
        if self._deed is None or self._began_us is None:
            super()._decide(requested, snapshot, events)
            return
        sequence = self._sequence
        sequence.finished = sequence.decision = None
        sequence.sense_sleeves(snapshot)  # by whose reads what the guard blocks is counted
        wish: Wish = self._deed.wish(self._step_us - self._began_us, self._seed)
        sequence.clutch = wish.clutch
        sequence.engine_rad_s = None if wish.engine_rpm is None else wish.engine_rpm * RPM
        for valve in ValveName:
            command = self._board.command(valve)
            if valve not in wish.valves:
                self._board.off(valve)
            elif not command.on or snapshot.now_us - command.time_us > AGAIN_US:
                self._board.schedule(valve, True, snapshot.earliest_us, snapshot.now_us)

    def _commands(self, now_us: int, snapshot: StepSnapshot, events: list[str]) -> list[Frame]:
        frames = super()._commands(now_us, snapshot, events)
        self.drives = drives(frames[0].data)
        self.sees_all = self._receiver.all_valid((*POSITIONS, ValveStatus))
        if self._guarded.guard.blocked_row is not None:
            self.rows.append(self._guarded.guard.blocked_row)
        return frames


class WatchedRig(RigCore):
    """The gearbox; faults can be put into it."""

    def inject(self, order: FaultOrder, now_us: int) -> None:
        """A fault, at `now_us` of the driver's clock."""
        if self._start_us is not None:
            self._world.inject(order, max(0, now_us - self._start_us))

    @property
    def sensor_us(self) -> int:
        """What the sensors' clock shows, as of the node's last step."""
        return self._world.clock.at(self.truth.time_us)

    @property
    def energised(self) -> tuple[bool, ...]:
        """Which valves' drivers are on."""
        return self._world.valves.energised

    @property
    def is_moved_by_the_bench(self) -> bool:
        """Whether the bench's hand is on the sleeves."""
        world: Any = self._world
        return bool(world.script.stage is not ScriptStage.IDLE)

    @property
    def is_stalled(self) -> bool:
        """Whether its event loop hangs."""
        return self._node.stalled_until_us > 0
