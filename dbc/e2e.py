"""End-to-end protection of our own frames: AUTOSAR E2E profile 5, counter check and state machine.

The CRC is the library's (`autosar-e2e`): bytes 0..1 of a frame, low byte first, over everything
from byte 2 on and the message's data ID; the counter is byte 2. Counter check and state machine
follow AUTOSAR's profile check and E2E_SM with three differences:

- a repeated or wrong counter is an error of the window, as a wrong CRC is, so that a sender with a
  broken counter is out after `max_errors` + 1 frames (AUTOSAR counts only the wrong CRC);
- frames drive the machine, not periods, because the steps of a core have none; absence is measured
  in time (`Silence`) and handed over as NO_NEW_DATA, which empties the window;
- the first frame of all is OK and counts, where AUTOSAR only takes its counter.

E2E finds accidents. It is no defence against someone who forges frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final, Self

from e2e.p05 import e2e_p05_check as check_crc
from e2e.p05 import e2e_p05_protect as write_crc

__all__ = [
    "COUNTER_MODULUS",
    "DEFAULT_LIMITS",
    "ChannelState",
    "E2ELimits",
    "Silence",
    "StateMachine",
    "Status",
    "WindowFinding",
    "check_counter",
    "check_crc",
    "write_crc",
]

COUNTER_MODULUS: Final = 256


class Status(IntEnum):
    """What the check says about a frame or the lack of one (AUTOSAR E2E_PCheckStatusType)."""

    OK = 0
    REPEATED = 1
    WRONG_SEQUENCE = 2
    ERROR = 3
    NOT_AVAILABLE = 4
    NO_NEW_DATA = 5


class ChannelState(IntEnum):
    """What is known about a channel (AUTOSAR E2E_SMStateType); its data are usable in VALID."""

    NO_DATA = 0
    INIT = 1
    VALID = 2
    INVALID = 3


class WindowFinding(IntEnum):
    """What the window of the last statuses amounts to."""

    SILENT = 0
    """Empty, or nothing readable was ever received."""
    FEW = 1
    """Errors within the limit, but too few good frames for the state."""
    ENOUGH = 2
    """Errors within the limit and enough good frames for the state."""
    BAD = 3
    """Too many errors."""


_TRANSITIONS: Final[dict[ChannelState, dict[WindowFinding, ChannelState]]] = {
    ChannelState.NO_DATA: {
        WindowFinding.SILENT: ChannelState.NO_DATA,
        WindowFinding.FEW: ChannelState.INIT,
        WindowFinding.ENOUGH: ChannelState.VALID,
        WindowFinding.BAD: ChannelState.INVALID,
    },
    ChannelState.INIT: {
        WindowFinding.SILENT: ChannelState.INIT,
        WindowFinding.FEW: ChannelState.INIT,
        WindowFinding.ENOUGH: ChannelState.VALID,
        WindowFinding.BAD: ChannelState.INVALID,
    },
    ChannelState.VALID: {
        WindowFinding.SILENT: ChannelState.INVALID,
        WindowFinding.FEW: ChannelState.INVALID,
        WindowFinding.ENOUGH: ChannelState.VALID,
        WindowFinding.BAD: ChannelState.INVALID,
    },
    ChannelState.INVALID: {
        WindowFinding.SILENT: ChannelState.INVALID,
        WindowFinding.FEW: ChannelState.INVALID,
        WindowFinding.ENOUGH: ChannelState.VALID,
        WindowFinding.BAD: ChannelState.INVALID,
    },
}


@dataclass(frozen=True)
class E2ELimits:
    """Settings of counter check and state machine (AUTOSAR names in brackets)."""

    window: int = 10
    """Statuses remembered (WindowSize)."""
    min_ok_to_enter: int = 3
    """Good frames in the window to become VALID (MinOkStateInit, MinOkStateInvalid)."""
    min_ok_to_stay: int = 1
    """Good frames in the window to stay VALID (MinOkStateValid)."""
    max_errors: int = 2
    """Errors in the window that are tolerated (MaxErrorStateInit, -Valid, -Invalid)."""
    max_delta_counter: int = 2
    """Largest step of the counter that is no loss (MaxDeltaCounter)."""
    max_silent_cycles: int = 5
    """Cycle times without a good frame after which a channel is not VALID."""


DEFAULT_LIMITS: Final = E2ELimits()


def check_counter(previous: int | None, counter: int, max_delta: int) -> Status:
    """Judge a counter against the one before it; the first of all, `previous` None, is OK.

    Whatever is said, `counter` is the `previous` of the next frame: after a restart of the sender
    one frame is WRONG_SEQUENCE and the next is OK.
    """
    if previous is None:
        return Status.OK
    delta = (counter - previous) % COUNTER_MODULUS
    if delta == 0:
        return Status.REPEATED
    return Status.OK if delta <= max_delta else Status.WRONG_SEQUENCE


class _Flat:
    """Holds nothing that changes in itself. A rig or a controller has some sixty of them, and
    copying one with the generic `copy.deepcopy` takes ten times as long."""

    __slots__ = ()

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        other = object.__new__(type(self))
        names: tuple[str, ...] = type(self).__slots__
        for name in names:
            setattr(other, name, getattr(self, name))
        return other


class StateMachine(_Flat):
    """The state of one cyclic channel from the statuses of its frames (AUTOSAR E2E_SM)."""

    __slots__ = ("_errors", "_limits", "_mask", "_oks", "is_steady", "state", "status")

    def __init__(self, limits: E2ELimits = DEFAULT_LIMITS) -> None:
        self._limits = limits
        self._mask = (1 << limits.window) - 1
        self._oks = 0
        self._errors = 0
        self.state = ChannelState.NO_DATA
        self.status = Status.NOT_AVAILABLE
        self.is_steady = False
        """VALID with a window full of OK, the most frequent case: one more changes nothing."""

    def update(self, status: Status) -> None:
        """Take the status of one frame, or NO_NEW_DATA, and move to the next state."""
        self.status = status
        if status is Status.OK and self.is_steady:
            return
        finding = self._find(status)
        state = _TRANSITIONS[self.state][finding]
        if finding is WindowFinding.SILENT or (
            state is ChannelState.INVALID and self.state is not ChannelState.INVALID
        ):
            self._oks = self._errors = 0
        self.state = state
        self.is_steady = state is ChannelState.VALID and self._oks == self._mask

    def _find(self, status: Status) -> WindowFinding:
        """Shift the status into the window, and say what the window amounts to."""
        is_readable = status is not Status.ERROR or self.state is not ChannelState.NO_DATA
        if status in (Status.NO_NEW_DATA, Status.NOT_AVAILABLE) or not is_readable:
            return WindowFinding.SILENT
        is_ok = status is Status.OK
        self._oks = (self._oks << 1 | is_ok) & self._mask
        self._errors = (self._errors << 1 | (not is_ok)) & self._mask
        if self._errors.bit_count() > self._limits.max_errors:
            return WindowFinding.BAD
        is_valid = self.state is ChannelState.VALID
        needed = self._limits.min_ok_to_stay if is_valid else self._limits.min_ok_to_enter
        return WindowFinding.ENOUGH if self._oks.bit_count() >= needed else WindowFinding.FEW


class Silence(_Flat):
    """Measures how long a cyclic channel has had no good frame, in the clock of the caller's steps.

    A good frame that a step consumes is dated at the step before, but not more than one cycle time
    back: a frame carries no arrival time, and the earlier date errs to the safe side. So when steps
    come at least once a cycle time, a channel is silent at every step that is `max_silent_cycles`
    cycle times or more after its last good frame arrived, and at none that is one cycle time less.
    """

    __slots__ = ("_cycle_time_us", "_heard_us", "_limit_us", "is_heard")

    def __init__(self, cycle_time_us: int, limits: E2ELimits = DEFAULT_LIMITS) -> None:
        self._cycle_time_us = cycle_time_us
        self._limit_us = limits.max_silent_cycles * cycle_time_us
        self._heard_us: int | None = None
        self.is_heard = False
        """Set by whoever receives a good frame, cleared by `tick`."""

    @property
    def was_heard(self) -> bool:
        """Whether there was ever a good frame, as of the last `tick`."""
        return self._heard_us is not None

    def tick(self, now_us: int, previous_us: int) -> bool:
        """Whether the channel is silent at this step; `previous_us` is the step before."""
        if self.is_heard:
            self.is_heard = False
            earliest_us = now_us - self._cycle_time_us
            self._heard_us = previous_us if previous_us > earliest_us else earliest_us
            return False
        return self._heard_us is not None and now_us - self._heard_us >= self._limit_us
