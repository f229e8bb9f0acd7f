"""The status and report frames, which make every step visible on the bus."""

from __future__ import annotations

import math
from typing import Final

from meshpoint.controller.core.messages import estimates, etc1, etc2, outcome, prediction
from meshpoint.controller.estimate.observer import Observer
from meshpoint.controller.models.models import LayshaftState
from meshpoint.controller.models.swing import ShaftState
from meshpoint.controller.settings.header import RunHeader
from meshpoint.controller.shift.sequence import ShiftSequence
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver, Transmitter
from meshpoint.dbc.messages import (
    ETC1,
    ControllerEstimates,
    ControllerState,
    ControllerStatus,
    Message,
)
from meshpoint.gearbox import MainGear
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.gearbox.kinematics import slip_rad_s, wrap_to_pitch

ETC2_CYCLE_US: Final = 100_000
LATENESS_TOP_US: Final = 65_535
COUNTER_MASK: Final = 0xFFFF
WORD: Final = 0xFFFF_FFFF


class Reporter:
    """Keeps what the status frame needs of the step before."""

    def __init__(self, header: RunHeader, observer: Observer, sequence: ShiftSequence) -> None:
        self._header = header
        self._run_hash = header.run_hash
        self._observer = observer
        self._sequence = sequence
        self._steps = 0
        self._etc2_every = max(1, ETC2_CYCLE_US // header.settings.timing.tick_us)
        """Steps from one that says it to the next."""
        self._gear = -1
        self._previous = (0, 0, 0)

    def change_header(self, header: RunHeader) -> None:
        """Another run header from the next status frame on."""
        self._header = header
        self._run_hash = header.run_hash

    def frames(self, transmitter: Transmitter, snapshot: StepSnapshot) -> list[Frame]:
        """Estimates, J1939 messages, and this step's prediction and outcome where there are any."""
        sequence, sheet = self._sequence, self._header.sheet
        self._gear = current = self._gear_number()
        frames = transmitter.unread(ControllerEstimates, ETC1)
        messages = [] if frames is not None else self._shafts()
        if self._steps % self._etc2_every == 0:
            target = sequence.target
            messages.append(etc2(sheet, current, target.number if target else max(current, 0)))
        shift = sequence.shift or sequence.finished
        if sequence.decision is not None and shift is not None:
            messages.append(prediction(snapshot.now_us, sequence.decision, shift))
        if sequence.finished is not None:
            messages.append(outcome(sequence.finished, sheet.dog.pitch_rad))
        return [*(frames or ()), *(transmitter.encode(message) for message in messages)]

    def _shafts(self) -> list[Message]:
        # At the time of the newest read: extrapolated further, the estimates of two shafts in mesh
        # would drift apart.
        seen_us = self._observer.clock.latest_us
        layshaft, main = self._observer.layshaft_at(seen_us), self._observer.main_at(seen_us)
        return [self._estimates(seen_us, layshaft, main), self._etc1(main, layshaft)]

    def _gear_number(self) -> int:
        view = self._observer.view
        return view.gear_number if view.complete else -1

    def _gear_in_focus(self) -> MainGear | None:
        """The gear that slip and phase are reported for: the target, else the one in mesh."""
        target = self._sequence.target
        if target is not None:
            return target.main
        current = DRIVE_GEARS.get(self._gear)
        return current.main if current else None

    def _estimates(
        self, time_us: int, layshaft: LayshaftState | None, main: ShaftState | None
    ) -> ControllerEstimates:
        gear = self._gear_in_focus()
        slip, phase, phase_sd = 0.0, None, 0.0
        if layshaft is not None and main is not None and gear is not None:
            ratio = self._header.sheet.main_mesh(gear).ratio
            slip = slip_rad_s(ratio, layshaft.omega_rad_s, main.omega_rad_s)
            references = self._observer.references
            if references.known(gear):
                raw = references.phase_rad(gear, layshaft.theta_rad, main.theta_rad)
                phase = wrap_to_pitch(raw, self._header.sheet.dog.pitch_rad)
                phase_sd = math.hypot(
                    ratio * layshaft.theta_sd_rad, main.theta_sd_rad, references.sd_rad(gear)
                )
        return estimates(
            time_us,
            self._observer.layshaft,
            layshaft,
            main,
            self._header.sheet.air.atmosphere_pa,
            slip,
            phase,
            phase_sd,
        )

    def _etc1(self, main: ShaftState | None, layshaft: LayshaftState | None) -> ETC1:
        state = self._sequence.state
        shifting = state not in (
            ControllerState.STARTING,
            ControllerState.IN_GEAR,
            ControllerState.NEUTRAL,
        )
        view, sheet = self._observer.view, self._header.sheet
        gear = DRIVE_GEARS.get(self._gear)
        output = input_ = None
        if main is not None and gear is not None:
            output = main.omega_rad_s * sheet.range_mesh(gear.range_).ratio
        if layshaft is not None and view.complete and view.split is not None:
            input_ = layshaft.omega_rad_s / sheet.split_mesh(view.split).ratio
        return etc1(state is ControllerState.IN_GEAR, shifting, output, input_)

    def status(
        self,
        now_us: int,
        lateness_us: int,
        count: int,
        crc: int,
        receiver: Receiver,
        guard_blocks: int,
    ) -> ControllerStatus:
        """The frame that lets a log repeat this step; after `frames` of the same step."""
        sequence = self._sequence
        target = sequence.target
        previous = self._previous
        status = ControllerStatus(
            step_number=self._steps,
            step_time_us=now_us,
            previous_step_time_us=previous[0],
            consumed_count=count,
            previous_consumed_count=previous[1],
            consumed_crc=crc,
            previous_consumed_crc=previous[2],
            run_hash_low=self._run_hash & WORD,
            run_hash_high=self._run_hash >> 32,
            state=sequence.state,
            current_gear=self._gear,
            target_gear=target.number if target else max(self._gear, 0),
            strategy=self._header.settings.strategy,
            estimator=self._header.settings.estimator,
            reference_known=self._observer.references.mask,
            active_fault=sequence.fault,
            e2e_errors=receiver.e2e_errors & COUNTER_MASK,
            format_errors=receiver.format_errors & COUNTER_MASK,
            foreign_frames=receiver.foreign_frames & COUNTER_MASK,
            guard_blocks=guard_blocks & COUNTER_MASK,
            invalid_channels=receiver.invalid_channels,
            step_lateness_us=min(lateness_us, LATENESS_TOP_US),
            cold_start=self._header.calibration is None,
        )
        self._previous = (now_us, count, crc)
        self._steps += 1
        return status
