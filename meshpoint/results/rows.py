"""Shift by shift: what the controller reported beside what the rig's truth says.

Fed with messages in bus order, so simulate, demo and replay make the same rows of the same frames.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

from meshpoint.controller.plan.strategist import AIMING
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.settings.strategy_file import is_file_name
from meshpoint.dbc.messages import (
    Engagement,
    EngagementEvent,
    MainGear,
    Message,
    PhaseReference,
    ReferenceEngagement,
    ReferencePhase,
    ShiftOutcome,
    ShiftResult,
)
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.results.aborts import halt_mm
from meshpoint.results.road_speed import RoadSpeed, span_us
from meshpoint.results.shift_figures import ShiftFigures
from meshpoint.results.shift_parts import ShiftParts, closing_since_us, parts_of
from meshpoint.units import DEG, RPM

CONTACT_KINDS: Final = {EngagementEvent.GAP_CONTACT: "gap", EngagementEvent.TOOTH_CONTACT: "tooth"}
ENDS: Final = (EngagementEvent.LOCKED, EngagementEvent.GIVEN_UP)
SOURCES: Final = ("measured", "restored", "narrowed")
OFF_FACE: Final = (EngagementEvent.TOOTH_PASSED, EngagementEvent.GIVEN_UP)
OVER: Final = (*ENDS, EngagementEvent.RELEASED)
OF_TEETH: Final = (*CONTACT_KINDS, *OVER, EngagementEvent.TOOTH_PASSED, EngagementEvent.BLOCKED)
"""With the gear neutral they are of a splitter with dog teeth."""
LOCK_WAIT_US: Final = 400_000
"""A row waits so long after its shift's end for its gear to lock, since a sleeve may be measured in
before the tooth has met its flank. The clutch's plates have met by then, or there are none."""


@dataclass(frozen=True, kw_only=True)
class ShiftRow(ShiftFigures):
    """One shift. Phase error and slip are the rig's truth at first contact; else None."""

    from_: int
    """The old gear."""
    to: int
    """The gear asked for."""
    engagement: str = "main_gear"
    """Whose dog teeth contact, slip and attempts are of: main_gear or splitter."""
    reference: str
    """Whether the gear's phase reference was known when the sleeve was fired."""
    duration_ms: float
    """From request to outcome."""
    request_us: int
    """When it was asked for, by the sensor clock, as the next two."""
    contact_us: int | None
    """First contact, by the rig's truth."""
    end_us: int
    """When it was engaged or given up."""
    speed_lost_kmh: float | None = None
    """Road speed at the request less that at the end, by the rig's truth (thesis 1.2); None in the
    preset thesis, which has no vehicle."""
    phases: ShiftParts = field(default_factory=ShiftParts)
    """Where the time went, by the rig's truth."""

    @property
    def phase_error_pct_of_pitch(self) -> float | None:
        """The phase error in per cent of a pitch."""
        return None if self.phase_error_deg is None else 100 * self.phase_error_deg / self.pitch_deg

    def to_json(self) -> dict[str, Any]:
        """The row as the commands print it; times are the sensor clock's 32-bit microseconds."""
        fields = {key.rstrip("_"): value for key, value in vars(self).items()}
        fields["phases"] = _rounded(vars(self.phases))
        fields["phase_error_pct_of_pitch"] = self.phase_error_pct_of_pitch
        return _rounded(fields)


def _rounded(fields: dict[str, Any]) -> dict[str, Any]:
    return {k: round(v, 6) if isinstance(v, float) else v for k, v in fields.items()}


class RowCollector:
    """Pairs each outcome with the first contact of the gear it went for. The last row is added to
    until its gear has locked and its clutch has closed, which may come after the outcome."""

    def __init__(
        self,
        sheet: GearboxSheet,
        target_phase_rad: float = 0.0,
        settings: ControllerSettings | None = None,
    ) -> None:
        """`settings`: of the controller, which name a user's own strategy."""
        self._settings = settings or ControllerSettings()
        self._pitch_deg = sheet.dog.pitch_rad / DEG
        self._target_rad = target_phase_rad
        self._events: list[ReferenceEngagement] = []
        self._meeting: _Meeting | None = None
        """Of the last row, while its gear has not locked."""
        self._road = RoadSpeed()
        self._closing_since_us: int | None = None
        """From here on the last row waits for the plates to meet."""
        self.rows: list[ShiftRow] = []
        self.refusals: list[str] = []
        """Of each request that was refused, the fault that it was refused for."""

    def take(self, message: Message) -> None:
        """One message in bus order."""
        if isinstance(message, ReferencePhase):
            self._road.take(message)
        elif isinstance(message, ReferenceEngagement):
            self._event(message)
        elif isinstance(message, ShiftOutcome):
            if message.result is ShiftResult.REFUSED:
                self.refusals.append(message.fault.name.lower())
            else:
                self._ended(message)

    def _event(self, event: ReferenceEngagement) -> None:
        self._events.append(event)
        if event.event is EngagementEvent.READY:
            self._events.clear()
            self._meeting = self._closing_since_us = None
        elif event.event is EngagementEvent.PLATES_MET:
            self._plates_met(event.event_time_us)
        elif self._meeting is not None:
            self._after_the_end(event, self._meeting)

    def _after_the_end(self, event: ReferenceEngagement, meeting: _Meeting) -> None:
        """What gear and sleeve of the last row do after their shift's end, until they have
        locked."""
        is_late = span_us(event.event_time_us, self.rows[-1].end_us) > LOCK_WAIT_US
        if is_late or (event.gear, event.event) == (meeting.gear, EngagementEvent.RELEASED):
            self._meeting = None
        elif event.gear == meeting.gear and event.event in OF_TEETH:
            meeting.events.append(event)
            self.rows[-1] = replace(self.rows[-1], **meeting.cost()._asdict())
            self._meeting = None if meeting.is_over else meeting

    def _ended(self, outcome: ShiftOutcome) -> None:
        meeting = _meeting(outcome, self._events)
        self._closing_since_us = closing_since_us(self._events, outcome.end_time_us)
        self.rows.append(self._row(outcome, meeting))
        self._meeting = None if meeting.is_over else meeting
        self._events.clear()

    def _is_outside(self, event: ReferenceEngagement) -> bool:
        """Whether a sleeve has met a gear that turns too fast against it, whatever sent it
        there. Of a splitter's the sleeve is the one that turns faster."""
        slip = -event.slip_rad_s if event.gear is MainGear.NEUTRAL else event.slip_rad_s
        return event.event in CONTACT_KINDS and self._settings.guard.is_outside(slip)

    def _plates_met(self, time_us: int) -> None:
        """The clutch of the last shift is closing: its row has all its parts."""
        since_us, self._closing_since_us = self._closing_since_us, None
        if since_us is None:
            return
        row = self.rows[-1]
        closing_ms = span_us(time_us, since_us) / 1000
        self.rows[-1] = replace(row, phases=replace(row.phases, closing_ms=closing_ms))

    def _row(self, outcome: ShiftOutcome, meeting: _Meeting) -> ShiftRow:
        contact = meeting.first_contact
        parts = parts_of(self._events, outcome.request_time_us, outcome.end_time_us)
        known = outcome.reference is PhaseReference.KNOWN
        phase = slip = delay = None
        lost_m_s = self._road.lost_m_s(outcome.request_time_us, outcome.end_time_us)
        if contact is not None:
            slip = contact.slip_rad_s / RPM
            if outcome.fire_time_us:
                delay = span_us(contact.event_time_us, outcome.fire_time_us) / 1000
        if contact is not None and meeting.gear is not MainGear.NEUTRAL:  # no splitter is aimed
            pitch = self._pitch_deg
            phase = (contact.phase_rad - self._target_rad) / DEG
            phase -= pitch * math.floor(phase / pitch + 0.5)
        # The outcome speaks of the last firing; the first contact may be an earlier one's.
        fired_once = outcome.attempts == 1 and (delay is None or delay >= 0.0)
        predicted = known and fired_once and outcome.predicted_contact_time_us != 0
        return ShiftRow(
            from_=outcome.from_gear,
            to=outcome.to_gear,
            engagement=outcome.engagement.name.lower(),
            strategy=self._settings.name_of(outcome.strategy),
            reference=outcome.reference.name.lower(),
            result=outcome.result.name.lower(),
            duration_ms=span_us(outcome.end_time_us, outcome.request_time_us) / 1000,
            slip_rpm=slip,
            phase_error_deg=phase,
            pitch_deg=self._pitch_deg,
            contact=CONTACT_KINDS[contact.event] if contact else None,
            attempts=outcome.attempts,
            predicted_phase_deg=outcome.predicted_phase_rad / DEG if predicted else None,
            predicted_phase_sd_deg=outcome.predicted_phase_sd_rad / DEG if predicted else None,
            delay_ms=delay if fired_once else None,
            request_us=outcome.request_time_us,
            contact_us=contact.event_time_us if contact else None,
            end_us=outcome.end_time_us,
            fault=outcome.fault.name.lower(),
            **meeting.cost()._asdict(),
            reference_source=outcome.reference_source.name.lower(),
            phases=parts,
            speed_lost_kmh=None if lost_m_s is None else 3.6 * lost_m_s,
            aborts=outcome.aborts,
            halt_mm=halt_mm(outcome),
            outside_window=sum(self._is_outside(event) for event in self._events),
        )


class _Cost(NamedTuple):
    """Figures of a row."""

    impact_j: float
    impact_complete: bool
    face_ms: float
    ratchets: int
    blocked: int


class _Meeting(NamedTuple):
    """What the rig has reported of sleeve and gear in one shift."""

    gear: MainGear
    """Neutral where it is a splitter with dog teeth alone."""
    events: list[ReferenceEngagement]
    beside: tuple[ReferenceEngagement, ...] = ()
    """Of a splitter with dog teeth that the shift has changed, too: what it strikes counts."""

    @property
    def first_contact(self) -> ReferenceEngagement | None:
        """None: they have not met."""
        return next((event for event in self.events if event.event in CONTACT_KINDS), None)

    @property
    def is_over(self) -> bool:
        """Whether they are apart, or locked: what has met strikes no more."""
        return not self.events or self.events[-1].event in OVER

    def cost(self) -> _Cost:
        """What all attempts have cost, by the rig's tallies; time on the face also from the events,
        since the preset thesis keeps no tally."""
        ends = [event for event in self.events if event.event in ENDS]
        on_face_us, since_us = 0, None
        for event in self.events:
            if event.event is EngagementEvent.TOOTH_CONTACT:
                since_us = event.event_time_us
            elif since_us is not None and event.event in OFF_FACE:
                on_face_us += span_us(event.event_time_us, since_us)
                since_us = None
        return _Cost(
            # A gear that has not locked has struck nothing; in logs of an older rig it has the old
            # gear's impact, where the sleeve was pulled through.
            impact_j=sum(
                end.impact_energy_j
                for end in (*ends, *self.beside)
                if end.event is EngagementEvent.LOCKED
            ),
            impact_complete=self.is_over,
            face_ms=max(on_face_us, sum(end.face_time_us for end in ends)) / 1000,
            ratchets=sum(end.ratchets for end in ends),
            blocked=sum(end.blocked for end in ends),
        )


def _meeting(outcome: ShiftOutcome, events: list[ReferenceEngagement]) -> _Meeting:
    """What gear and sleeve of a shift have done: those that its outcome reports."""
    gear, neutral = MainGear(DRIVE_GEARS[outcome.to_gear].main), MainGear.NEUTRAL
    found = [event for event in events if event.gear == gear]
    splits = [each for each in events if each.gear == neutral and each.event in OF_TEETH]
    if outcome.engagement is Engagement.SPLITTER:
        return _Meeting(neutral, splits)
    return _Meeting(gear, found, tuple(splits))


@dataclass(frozen=True)
class Summary:
    """What a list of rows comes to, for one strategy as it was asked for."""

    strategy: str
    shifts: int
    known: int
    """Shifts with the phase reference known when the sleeve was fired."""
    reference_sources: dict[str, int]
    """Of them by where it came from: measured in mesh, restored with the tooth numbers, narrowed by
    other gears in mesh."""
    gap: int
    gap_known: int
    engaged: int
    aborted: int
    """Shifts whose sleeve was stopped short of the teeth, once or more."""
    aborts: int
    """How often, in all of them."""
    mean_duration_ms: float | None
    phase_error_rms_deg: float | None
    """Over the shifts with a known reference; None without any."""
    aims: bool
    """It aims at a phase; then only shifts with a known reference say how well."""

    @property
    def gap_rate(self) -> float | None:
        """Share of first contacts in a gap, over the shifts that could aim where it aims at all."""
        if self.aims:
            return self.gap_known / self.known if self.known else None
        return self.gap / self.shifts if self.shifts else None

    @property
    def reference_known(self) -> float | None:
        """Share of the shifts whose phase reference was known when the sleeve was fired."""
        return self.known / self.shifts if self.shifts else None

    def to_json(self) -> dict[str, Any]:
        """Counts and figures by name."""
        figures = {key: value for key, value in vars(self).items() if key != "aims"}
        return figures | {"gap_rate": self.gap_rate, "reference_known": self.reference_known}


def is_aimed(row: ShiftRow) -> bool:
    """Whether its contact was aimed at, so that its phase error says how well."""
    chosen = row.strategy in AIMING or is_file_name(row.strategy)
    return chosen and row.reference == "known"


def summarise(strategy: str, rows: list[ShiftRow]) -> Summary:
    """The summary of the rows of one run with that strategy."""
    known = [row for row in rows if row.reference == "known"]
    errors = [row.phase_error_deg for row in known if row.phase_error_deg is not None]
    durations = [row.duration_ms for row in rows if row.result == "engaged"]
    return Summary(
        strategy=strategy,
        shifts=len(rows),
        known=len(known),
        reference_sources={
            source: sum(row.reference_source == source for row in known) for source in SOURCES
        },
        gap=sum(row.contact == "gap" for row in rows),
        gap_known=sum(row.contact == "gap" for row in known),
        engaged=sum(row.result == "engaged" for row in rows),
        aborted=sum(row.aborts > 0 for row in rows),
        aborts=sum(row.aborts for row in rows),
        mean_duration_ms=sum(durations) / len(durations) if durations else None,
        phase_error_rms_deg=(
            math.sqrt(sum(e * e for e in errors) / len(errors)) if errors else None
        ),
        # Of a user's own, only for one that aims does another one ever stand in.
        aims=strategy in AIMING
        or (is_file_name(strategy) and any(row.strategy != strategy for row in rows)),
    )
