"""What is known of one shift wherever shifts are listed: the one list of these figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

NO_OUTCOME: Final = "no_outcome"
REFUSED: Final = "refused"
"""Of a request that the controller has not begun."""


@dataclass(frozen=True, kw_only=True)
class ShiftFigures:
    """Figures that a shift's row (`--json`, `bench.shift`, `Log.shifts`) and a campaign's table
    have alike; the unit ends the name. Defaults are those of a shift without an outcome."""

    strategy: str
    """In a row the strategy that acted, in a campaign's table the one that was asked for."""
    result: str = NO_OUTCOME
    """How it ended."""
    fault: str = "none"
    """Why it failed."""
    reference_source: str = "none"
    """Where a known reference came from: measured, restored or narrowed."""
    contact: str | None = None
    """What the tooth met first, by the rig's truth: gap or tooth; None without a contact."""
    slip_rpm: float | None = None
    """At first contact, by the rig's truth; positive: the gear turns faster than its sleeve."""
    phase_error_deg: float | None = None
    """At first contact, by the rig's truth, from where was aimed at."""
    pitch_deg: float
    """From one dog tooth to the next."""
    predicted_phase_deg: float | None = None
    """At contact, as predicted when the sleeve was fired; None without a known reference, and where
    `delay_ms` is."""
    predicted_phase_sd_deg: float | None = None
    """Its standard deviation."""
    delay_ms: float | None = None
    """From activation to contact, by the rig's truth; None after more than one attempt, and where
    an earlier firing, aborted too late, made the contact."""
    attempts: int = 0
    """Times a sleeve was fired; a firing that was recalled or aborted does not count."""
    aborts: int = 0
    """Times a sleeve on its way was stopped short of the teeth."""
    halt_mm: float | None = None
    """Where the sleeve stood after the last abort, from neutral, negative towards first and crawl;
    None without one."""
    impact_j: float = 0.0
    """Lost in flank impacts until the gear was locked, all attempts, by the rig's truth; 0 in the
    preset thesis."""
    impact_complete: bool = True
    """False: sleeve and gear had met and not locked 0.4 s after the shift's end, or when the log
    ended; what a later impact took is not in `impact_j`."""
    face_ms: float = 0.0
    """Tooth on tooth, all attempts."""
    ratchets: int = 0
    """Times a flank threw the sleeve back."""
    blocked: int = 0
    """Attempts in which sleeve and gear stuck tooth on tooth."""
    outside_window: int = 0
    """Contacts of any main gear, the old and the opposite one too, at a slip further than 10 rpm
    outside the guard's window, by the rig's truth."""
    bound_ms: float | None = None
    """The kinematic minimum of the duration; None where there is none, or what was drawn for the
    rig is not known."""
