"""The controller's fault codes as a garage knows them: SPN and FMI, active or stored, counted.

Suspect parameter numbers are of J1939's range for makers' own use (520192 and up), one a fault
code; the failure mode is J1939-73's. The memory is that of the running node: it starts empty.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from meshpoint.dbc.messages import FaultCode

FIRST_SPN: Final = 520_192
MOST_OCCURRENCES: Final = 126
"""127 means that it is not counted (J1939-73)."""
BELOW_NORMAL, NOT_RESPONDING, UPDATE_RATE, ABOVE_NORMAL, EXISTS, INCORRECT = 1, 7, 9, 0, 31, 2
FAILURE_MODE: Final[dict[FaultCode, int]] = {
    FaultCode.SPEED_STALE: UPDATE_RATE,
    FaultCode.POSITION_STALE: UPDATE_RATE,
    FaultCode.VALVE_LINK_LOST: UPDATE_RATE,
    FaultCode.CLUTCH_STUCK: NOT_RESPONDING,
    FaultCode.DISENGAGE_FAILED: NOT_RESPONDING,
    FaultCode.SYNCHRONISE_FAILED: NOT_RESPONDING,
    FaultCode.ENGAGE_FAILED: NOT_RESPONDING,
    FaultCode.GUARD_BLOCKED: EXISTS,
    FaultCode.SLIP_AT_CONTACT: EXISTS,
    FaultCode.LOW_SUPPLY: BELOW_NORMAL,
    FaultCode.BRAKE_LIMIT: ABOVE_NORMAL,
    FaultCode.SPLITTER_FAILED: NOT_RESPONDING,
    FaultCode.RANGE_FAILED: NOT_RESPONDING,
    FaultCode.ENGINE_FAILED: NOT_RESPONDING,
    FaultCode.INPUT_WHEEL_WRONG: INCORRECT,
    FaultCode.LAYSHAFT_WHEEL_WRONG: INCORRECT,
    FaultCode.MAIN_WHEEL_WRONG: INCORRECT,
    FaultCode.PROPELLER_WHEEL_WRONG: INCORRECT,
    FaultCode.WHEELS_DISAGREE: INCORRECT,
}
"""Faults of the gearbox and what belongs to it. The others refuse a request that the driver should
not have made; nothing is broken then."""


@dataclass(frozen=True)
class TroubleCode:
    """One diagnostic trouble code."""

    fault: FaultCode
    occurrences: int
    is_active: bool

    @property
    def spn(self) -> int:
        """Suspect parameter number."""
        return FIRST_SPN + int(self.fault)

    @property
    def fmi(self) -> int:
        """Failure mode identifier."""
        return FAILURE_MODE[self.fault]

    @property
    def packed(self) -> bytes:
        """SPN and FMI in three bytes, low byte of the SPN first (J1939-73, conversion method 0)."""
        spn = self.spn
        return bytes([spn & 0xFF, spn >> 8 & 0xFF, spn >> 16 << 5 | self.fmi])

    @property
    def counted(self) -> bytes:
        """With its occurrence count: the four bytes of a DM1."""
        return self.packed + bytes([self.occurrences])


class TroubleMemory:
    """Which faults there are and have been."""

    def __init__(self) -> None:
        self._counts: dict[FaultCode, int] = {}
        self._active: FaultCode = FaultCode.NONE

    def take(self, fault: FaultCode) -> bool:
        """The fault of now, from a status frame; whether that is news."""
        fault = fault if fault in FAILURE_MODE else FaultCode.NONE
        if fault is self._active:
            return False
        self._active = fault
        if fault is not FaultCode.NONE:
            self._counts[fault] = min(self._counts.get(fault, 0) + 1, MOST_OCCURRENCES)
        return True

    @property
    def codes(self) -> list[TroubleCode]:
        """All of them, active ones first, then by number."""
        found = [TroubleCode(f, n, f is self._active) for f, n in self._counts.items()]
        return sorted(found, key=lambda code: (not code.is_active, code.spn))

    @property
    def active(self) -> list[TroubleCode]:
        """Those that are there now."""
        return [code for code in self.codes if code.is_active]

    @property
    def stored(self) -> list[TroubleCode]:
        """Those that were there and are not now."""
        return [code for code in self.codes if not code.is_active]

    def clear(self, active_too: bool = False) -> None:
        """Forgets the stored ones. An active fault that is still there is reported again: with
        active_too its count begins anew."""
        kept = self._active
        count = self._counts.get(kept, 0)
        self._counts = {}
        if kept is not FaultCode.NONE:
            self._counts[kept] = 1 if active_too else count
