"""The steps of one shift as one controller takes them: what it commands, and what it decides.

Times are in ms since the request.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, NamedTuple

from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import read_alone
from meshpoint.dbc.messages import (
    TSC1,
    ClutchCommand,
    ControllerState,
    ControllerStatus,
    ShiftDecision,
    ShiftOutcome,
    ShiftPrediction,
    ShiftResult,
    ValveAction,
    ValveCommand,
)
from meshpoint.results.road_speed import span_us
from meshpoint.units import DEG, RPM

NAMES: Final = {valve: valve.name.lower() for valve in ValveName}
FIRING: Final = (ShiftDecision.FIRE, ShiftDecision.COMMITTED)
LAST_STEP_MS: Final = 10.0
"""A trajectory's last command is drawn for as long as a tick."""
SAID: Final = {
    CODECS[kind.__name__].spec.can_id: CODECS[kind.__name__]
    for kind in (
        ValveCommand,
        ClutchCommand,
        TSC1,
        ShiftPrediction,
        ShiftOutcome,
        ControllerStatus,
    )
}


class Said(NamedTuple):
    """What one step commanded, and said of the shift."""

    time_us: int
    """The controller's clock."""
    command: ValveCommand | None
    clutch: ClutchCommand | None
    engine: TSC1 | None
    prediction: ShiftPrediction | None
    outcome: ShiftOutcome | None
    events: tuple[str, ...] = ()
    state: ControllerState | None = None

    @property
    def ended(self) -> ShiftOutcome | None:
        """The outcome of a shift that was begun; None of one that was refused, too."""
        if self.outcome is None or self.outcome.result is ShiftResult.REFUSED:
            return None
        return self.outcome


def said(time_us: int, frames: list[Frame], events: tuple[str, ...] = ()) -> Said:
    """What the frames of one step command, and say of the shift."""
    found = {type(message): message for message in map(_decoded, frames)}
    return Said(
        time_us,
        found.get(ValveCommand),
        found.get(ClutchCommand),
        found.get(TSC1),
        found.get(ShiftPrediction),
        found.get(ShiftOutcome),
        events,
        getattr(found.get(ControllerStatus), "state", None),
    )


def _decoded(frame: Frame) -> Any:
    """The message of an undamaged frame, whatever its counter; else None."""
    codec = SAID.get(frame.can_id)
    return None if codec is None else read_alone(codec, frame)


@dataclass(frozen=True)
class Decision:
    """A step's decision as its prediction frame has it; None: not decided, or not known."""

    at_ms: float
    decision: str
    release_ms: float | None
    """Activation of brake off."""
    fired_ms: float | None
    """Activation of the sleeve's valve."""
    expected_contact_ms: float | None
    predicted_phase_deg: float | None
    predicted_phase_sd_deg: float | None
    predicted_slip_rpm: float


def decision_of(said: ShiftPrediction, at_ms: float, request_us: int) -> Decision:
    """A step's decision; at_ms: of the step."""
    firing = said.decision in FIRING
    known = firing and said.phase_sd_rad > 0.0
    return Decision(
        at_ms=at_ms,
        decision=said.decision.name.lower(),
        release_ms=_ms(said.release_time_us, request_us) if said.release_time_us else None,
        fired_ms=_ms(said.fire_time_us, request_us) if firing else None,
        expected_contact_ms=_ms(said.contact_time_us, request_us) if firing else None,
        predicted_phase_deg=said.phase_rad / DEG if known else None,
        predicted_phase_sd_deg=said.phase_sd_rad / DEG if known else None,
        predicted_slip_rpm=said.slip_rad_s / RPM,
    )


def firing_of(decisions: list[Decision], aborted_ms: list[float]) -> Decision | None:
    """The first firing that was not aborted; None: there is none."""
    firings = [decision for decision in decisions if decision.decision == "committed"]
    for firing, after in pairwise([*firings, None]):
        end_ms = math.inf if after is None else after.at_ms
        if firing and not any(firing.at_ms < at_ms < end_ms for at_ms in aborted_ms):
            return firing
    return None


def _ms(stamp_us: int, request_us: int) -> float:
    return span_us(stamp_us, request_us) / 1000


class Trajectory:
    """The steps of one shift as one controller takes them."""

    def __init__(self) -> None:
        self.steps: list[Said] = []

    def take(self, said: Said) -> None:
        """One more step."""
        self.steps.append(said)

    def decisions(self, step_us: int, request_us: int) -> list[Decision]:
        """Of every step that has one; `step_us`: the step of the request."""
        return [
            decision_of(said.prediction, (said.time_us - step_us) / 1000, request_us)
            for said in self.steps
            if said.prediction is not None
        ]

    def aborted_ms(self, step_us: int) -> list[float]:
        """The steps in which a sleeve on its way was stopped."""
        return [
            (now.time_us - step_us) / 1000
            for before, now in pairwise(self.steps)
            if now.state is ControllerState.HALTED is not before.state
        ]

    def driven(self, step_us: int, request_us: int) -> dict[str, list[tuple[float, float]]]:
        """From when to when each valve is on by its commands; valves never on are left out."""
        starts = [(said.time_us - step_us) / 1000 for said in self.steps]
        ends = [*starts[1:], (starts[-1] if starts else 0.0) + LAST_STEP_MS]
        found = {}
        for valve, name in NAMES.items():
            switches = [(0.0, False)]
            for said, start_ms, end_ms in zip(self.steps, starts, ends, strict=True):
                if said.command is None:
                    continue
                on, at_ms = _switch(said.command, valve, start_ms, request_us)
                if at_ms < end_ms and on != switches[-1][1]:
                    switches.append((at_ms, on))
            switches.append((ends[-1] if ends else 0.0, False))
            spans = [(a, b) for (a, on), (b, _) in pairwise(switches) if on]
            if spans:
                found[name] = spans
        return found


def _switch(
    command: ValveCommand, valve: ValveName, start_ms: float, request_us: int
) -> tuple[bool, float]:
    """What a command wants of a valve, and from when on; never before it was said."""
    action = command[valve]
    on = action in (ValveAction.ON_NOW, ValveAction.ON_AT)
    if action in (ValveAction.ON_NOW, ValveAction.OFF_NOW):
        return on, start_ms
    return on, max(start_ms, _ms(int(command[valve + len(ValveName)]), request_us))


def differing(theirs: Said, mine: Said) -> list[str]:
    """What two steps command differently: valves by name, `clutch`, `engine`."""
    if theirs.command is None or mine.command is None:
        return []
    count = len(ValveName)
    differ = [
        name
        for valve, name in NAMES.items()
        if (theirs.command[valve], theirs.command[valve + count])
        != (mine.command[valve], mine.command[valve + count])
    ]
    differ += ["clutch"] if theirs.clutch != mine.clutch else []
    return [*differ, "engine"] if _asked(theirs) != _asked(mine) else differ


def _asked(said: Said) -> TSC1 | None:
    """What was asked of the engine, whichever frame of the run it was."""
    if said.engine is None:
        return None
    return said.engine._replace(message_counter=None, message_checksum=None)


def trajectory_parted_ms(
    recorded: Trajectory, replayed: Trajectory, step_us: int, request_us: int
) -> float | None:
    """The first switch of a valve that only one of them makes, or the first step at which clutch or
    engine are commanded differently."""
    edges = [
        {(at_ms, name, k) for name, spans in trajectory.driven(step_us, request_us).items()
         for span in spans for k, at_ms in enumerate(span)}
        for trajectory in (recorded, replayed)
    ]  # fmt: skip
    parted = [at_ms for at_ms, _, _ in edges[0] ^ edges[1]]
    for theirs, mine in zip(recorded.steps, replayed.steps, strict=True):
        if {"clutch", "engine"} & set(differing(theirs, mine)):
            parted.append((theirs.time_us - step_us) / 1000)
            break
    return min(parted, default=None)
