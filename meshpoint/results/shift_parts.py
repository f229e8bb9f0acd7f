"""Where the time of a shift goes, by the rig's truth: its parts between the moments that it
reports.

A part ends at its moment and begins at the last moment before it that there was, so the parts of a
shift add up to its duration. A part that a shift does not have is None: the brake in a downshift,
the old gear's teeth in a shift of the splitter alone, the clutch in the preset thesis.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Final

from meshpoint.dbc.messages import EngagementEvent, ReferenceEngagement
from meshpoint.results.road_speed import span_us

_E: Final = EngagementEvent
CONTACTS: Final = (_E.GAP_CONTACT, _E.TOOTH_CONTACT)


@dataclass(frozen=True)
class ShiftParts:
    """How long each part of a shift took, ms; in their order."""

    ramp_ms: float | None = None
    """From the request until the clutch sets off: the wait for the torque's ramp, and the command's
    way over the bus."""
    parting_ms: float | None = None
    """Until the plates have parted."""
    pull_out_ms: float | None = None
    """Until the old gear's teeth are out of each other."""
    raising_ms: float | None = None
    """Downshifts: until the engine has raised the layshaft and the plates have parted again."""
    brake_on_ms: float | None = None
    """Until air comes into the brake."""
    braking_ms: float | None = None
    """Until it is let out of it for the last time."""
    release_ms: float | None = None
    """Until the first contact of sleeve and gear."""
    entry_ms: float | None = None
    """Until the gear is locked."""
    seen_ms: float | None = None
    """Until the shift's end as the controller has it: the gear measured in."""
    closing_ms: float | None = None
    """From the lock, or from the end of a shift without one, until the plates meet again: after the
    shift, not part of its duration."""


PARTS: Final = tuple(field.name for field in fields(ShiftParts))
DURING: Final = PARTS[:-1]
"""The parts that add up to the duration."""
TITLES: Final = {
    "ramp_ms": "torque ramp",
    "parting_ms": "clutch parting",
    "pull_out_ms": "pull-out",
    "raising_ms": "speed raised",
    "brake_on_ms": "brake on",
    "braking_ms": "braking",
    "release_ms": "release",
    "entry_ms": "contact to lock",
    "seen_ms": "until seen in",
    "closing_ms": "plates meet (after)",
}


def parts_of(events: list[ReferenceEngagement], request_us: int, end_us: int) -> ShiftParts:
    """The parts of a shift from its request to its end, 32-bit times of the sensor clock (us);
    events: what the rig has reported since the gear before."""
    reported = [(event.event, span_us(event.event_time_us, request_us)) for event in events]
    end = span_us(end_us, request_us)
    reported = [(event, at) for event, at in reported if 0 <= at <= end]
    contact = _first(reported, *CONTACTS)
    released = _first(reported, _E.RELEASED)
    before = [(event, at) for event, at in reported if contact is None or at <= contact]
    raised = _last(before, _E.PLATES_PARTED, after=released)
    fills = _first(before, _E.BRAKE_FILLS, after=raised if raised is not None else released)
    empties = _last(reported, _E.BRAKE_EMPTIES, after=fills) if fills is not None else None
    moments = (
        _first(reported, _E.CLUTCH_OPENS),
        _first(reported, _E.PLATES_PARTED),
        released,
        raised,
        fills,
        empties if contact is None or empties is None else min(empties, contact),
        contact,
        _last(reported, _E.LOCKED),
        end,
    )
    spent: list[float | None] = []
    since = 0
    for moment in moments:
        spent.append(None if moment is None else max(0, moment - since) / 1000.0)
        since = since if moment is None else max(since, moment)
    return ShiftParts(*spent)


def closing_since_us(events: Iterable[ReferenceEngagement], end_us: int) -> int:
    """The moment from which `closing_ms` counts: the last lock, else the shift's end."""
    locked = [event.event_time_us for event in events if event.event is _E.LOCKED]
    return locked[-1] if locked else end_us


Reported = list[tuple[EngagementEvent, int]]


def _first(reported: Reported, *kinds: EngagementEvent, after: int | None = -1) -> int | None:
    if after is None:
        return None
    return next((at for event, at in reported if event in kinds and at > after), None)


def _last(reported: Reported, *kinds: EngagementEvent, after: int | None = -1) -> int | None:
    if after is None:
        return None
    return next((at for event, at in reversed(reported) if event in kinds and at > after), None)
