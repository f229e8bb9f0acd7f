"""Valve, clutch and engine commands of a step, each of which goes out only past the guard.

What the sequence wants becomes a frame, and the guard reads the finished frame. In place of a frame
that it forbids goes the one that does nothing: all valves off, the clutch open, the engine left to
its driver. A controller that is not armed sends all valves off, and nothing to clutch and engine.
"""

from __future__ import annotations

from typing import Final

from meshpoint.controller.guard.driveline import DrivelineGuard
from meshpoint.controller.guard.limits import guard_limits
from meshpoint.controller.guard.rules import Guard
from meshpoint.controller.guard.view import GuardInputs, GuardView
from meshpoint.controller.settings.header import RunHeader
from meshpoint.controller.shift.sequence import ShiftSequence
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import checked_request, torque_parts
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import TSC1, ClutchCommand, TscOverrideMode, ValveCommand

SHAFTS: Final = ("input shaft", "layshaft", "main shaft", "propeller shaft")


class GuardedCommands:
    """What the sequence wants, as frames that the guard has let pass."""

    def __init__(
        self, header: RunHeader, transmitter: Transmitter, sequence: ShiftSequence
    ) -> None:
        limits = guard_limits(header.sheet, header.settings)
        self.guard = Guard(limits, header.armed)
        self.driveline = DrivelineGuard(limits)
        self._view = GuardView(header.sheet, limits)
        self._transmitter = transmitter
        self._sequence = sequence
        self.in_doubt: tuple[int, ...] = ()
        """Shafts whose speed wheels the guard has found contradicted."""
        self._engine_asked = False
        self._engine_requests = 0

    @property
    def blocks(self) -> int:
        """How many commands the guard has blocked."""
        return self.guard.blocks + self.driveline.blocks

    def frames(
        self,
        valves: ValveCommand,
        heard: list[Frame],
        now_us: int,
        snapshot: StepSnapshot,
        events: list[str],
    ) -> list[Frame]:
        """The commands' frames; heard: all frames of this step, which the guard reads by itself.
        What a guard has blocked the sequence learns, and the events say."""
        guard, sequence = self.guard, self._sequence
        frame = self._transmitter.encode(valves)
        seen = self._view.take(heard, now_us, snapshot.now_us)
        self._note_wheels(seen.in_doubt, events)
        denied = guard.gear_is_denied
        passes = guard.passes(frame.data, seen)
        if guard.gear_is_denied and not denied:
            events.append("a gear is measured in, but turns against its sleeve")
        if not passes:
            events.append(f"guard blocked a valve command: row {guard.blocked_row}")
            sequence.blocked(guard.blocked_row or 0, snapshot)
            frame = self._transmitter.instead(ValveCommand())
        sequence.notify_actuators(snapshot.now_us)
        if not guard.is_armed:
            return [frame]
        return [frame, self._clutch_command(seen, events), *self._engine_request(seen, events)]

    def _note_wheels(self, in_doubt: tuple[int, ...], events: list[str]) -> None:
        """What the guard's counts say of the speed wheels; the next step acts on it."""
        if in_doubt != self.in_doubt:
            names = " or ".join(SHAFTS[shaft] for shaft in in_doubt)
            events.append(
                f"speed wheel reads wrong: {names}" if names else "speed wheels agree again"
            )
        self.in_doubt = in_doubt

    def _clutch_command(self, seen: GuardInputs, events: list[str]) -> Frame:
        """What the sequence wants of the clutch; open where the guard forbids to close."""
        frame = self._transmitter.encode(ClutchCommand(action=self._sequence.clutch))
        driveline, before = self.driveline, self._sequence.closing_blocked
        passes = driveline.passes_clutch(frame.data, seen)
        self._sequence.closing_blocked = not passes
        if passes:
            return frame
        if not before:  # it may go on for seconds
            events.append(f"guard keeps the clutch open: row {driveline.blocked_row}")
        return self._transmitter.instead(ClutchCommand())

    def _engine_request(self, seen: GuardInputs, events: list[str]) -> list[Frame]:
        """TSC1 while the engine is asked for a speed or a torque, and once more to end it; its end
        where the guard forbids it."""
        wanted, share = self._sequence.engine_rad_s, self._sequence.engine_share
        asked, self._engine_asked = self._engine_asked, (wanted, share) != (None, None)
        if not self._engine_asked:
            return [self._checked(TSC1())] if asked else []
        speed, torque = TscOverrideMode.SPEED_CONTROL, TscOverrideMode.TORQUE_CONTROL
        whole = fine = None
        if wanted is None and share is not None:
            whole, fine = torque_parts(share)
        request = TSC1(
            override_control_mode=torque if wanted is None else speed,
            requested_speed_rad_s=wanted,
            requested_torque_fraction=whole,
            requested_torque_fine_fraction=fine,
        )
        frame, driveline = self._checked(request), self.driveline
        if not driveline.passes_engine(frame.data, seen):
            events.append(f"guard blocked an engine request: row {driveline.blocked_row}")
            self._engine_requests -= 1  # the blocked one was not sent
            frame = self._checked(TSC1())
        return [frame]

    def _checked(self, request: TSC1) -> Frame:
        """The next TSC1 frame, with its counter and checksum."""
        frame = checked_request(self._transmitter.encode(request), self._engine_requests)
        self._engine_requests += 1
        return frame
