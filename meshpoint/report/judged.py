"""One shift as two controllers decide it on the same frames, and where they part.

Times are in ms since the request. What came of the recorded commands is not read here: the other
controller's contact is never taken from the log.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.shift.table import ShiftRecord
from meshpoint.dbc.messages import ShiftOutcome, ShiftResult
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.report.counterfactual import Counterfactual
from meshpoint.report.trajectory import (
    Decision,
    Said,
    Trajectory,
    decision_of,
    differing,
    firing_of,
    trajectory_parted_ms,
)

Known = TypeVar("Known")


@dataclass(frozen=True)
class Parting(Generic[Known]):
    """The first step in which two controllers do something different."""

    at_ms: float
    differ: tuple[str, ...]
    """In what: valves by name, `clutch`, `engine`; or messages."""
    knew: tuple[Known, Known]
    """What each had decided, or knew, in it."""


OfCommands = Parting[Decision | None]
"""By commands: the recorded controller's decision and the other one's; None: it had none."""


@dataclass(frozen=True)
class Judged:
    """A recorded shift as the other controller decides it."""

    from_: int
    to: int
    request_us: int
    strategy: str
    """The one that acts: the fallback while the reference is unknown."""
    reference: str
    status: str
    """One of `fired`; `planned` (a firing sent that could still be moved); `waiting`; `refused`;
    `ended` (it gave up before it fired)."""
    fault: str
    last: Decision | None
    """Its last decision before the recorded sleeve met its gear."""
    recorded: Decision | None
    """The first firing of the recorded controller that it did not abort; None where there is
    none."""
    parted: OfCommands | None
    """None: it commands what was recorded."""
    trajectory_parted_ms: float | None
    """When a valve is first driven, or clutch or engine commanded, differently: later frames answer
    to other commands than its own."""
    judged_to_ms: float | None
    """When the recorded sleeve was expected at its gear: decisions after it mean nothing."""
    contact_why: str
    """Why it is not reported where the tooth would have met."""
    aborted_ms: list[float] = field(default_factory=list)
    """When it stopped a sleeve on its way, on frames that answer to its own commands."""
    strayed_at_step: int | None = None
    """From this step on the recorded controller is not repeated exactly."""
    decisions: list[Decision] = field(default_factory=list)
    """Of every step up to there."""
    driven: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    """When each valve is commanded on up to there, for drawing."""
    events: list[str] = field(default_factory=list)
    """What it says of its decisions, up to its firing or up to there."""
    counterfactual: Counterfactual | None = None
    """Where its tooth would have landed, worked out; None where that was not asked for."""

    @property
    def on_own_trajectory(self) -> bool | None:
        """Whether the last decision was made on frames that answer to its own commands."""
        if self.last is None:
            return None
        return self.trajectory_parted_ms is None or self.last.at_ms < self.trajectory_parted_ms

    @property
    def last_on_own_trajectory(self) -> Decision | None:
        """Its last decision on frames that answer to its own commands."""
        end_ms = self.trajectory_parted_ms
        own = [d for d in self.decisions if end_ms is None or d.at_ms < end_ms]
        return own[-1] if own else None

    def without_traces(self) -> Judged:
        """The same, as rows and tables need it."""
        last, found = self.last_on_own_trajectory, self.counterfactual
        return replace(
            self,
            decisions=[] if last is None else [last],
            driven={},
            counterfactual=None if found is None else replace(found, trajectory=()),
        )

    @property
    def predictions(self) -> list[Decision]:
        """Of every step that had a firing planned."""
        return [d for d in self.decisions if d.decision in ("fire", "committed")]

    @property
    def fired_ms(self) -> float | None:
        """When it fires its sleeve; None where it has not decided to."""
        return self.last.fired_ms if self.last and self.status in ("fired", "planned") else None

    def to_json(self) -> dict[str, Any]:
        """By name, as `replay --strategy --json` has it; without what the log says."""
        last, reported = self.last, self.fired_ms is not None
        values = {
            "from": self.from_,
            "to": self.to,
            "request_us": self.request_us,
            "strategy": self.strategy,
            "reference": self.reference,
            "status": self.status,
            "fault": self.fault,
            "release_ms": last.release_ms if last else None,
            "fired_ms": self.fired_ms,
            "expected_contact_ms": last.expected_contact_ms if last and reported else None,
            "predicted_phase_deg": last.predicted_phase_deg if last and reported else None,
            "predicted_phase_sd_deg": last.predicted_phase_sd_deg if last and reported else None,
            "predicted_slip_rpm": last.predicted_slip_rpm if last and reported else None,
            "decided_ms": last.at_ms if last else None,
            "on_own_trajectory": self.on_own_trajectory,
            "trajectory_parted_ms": self.trajectory_parted_ms,
            "judged_to_ms": self.judged_to_ms,
            "aborted_ms": self.aborted_ms,
            "contact": None,
            "contact_why": self.contact_why,
            "counterfactual": self._counterfactual_json(),
            "strayed_at_step": self.strayed_at_step,
            "events": self.events,
        }
        own = self.last_on_own_trajectory
        return {
            **rounded(values),
            "last_on_own_trajectory": None if own is None else rounded(vars(own)),
            "parted": _parting_json(self.parted),
        }

    def _counterfactual_json(self) -> dict[str, Any] | None:
        if self.counterfactual is None:
            return None
        reported = {"decidable": self.counterfactual.decidable} | vars(self.counterfactual)
        reported.pop("trajectory")
        return rounded(reported | {"why": self.counterfactual.why or None})


def judge(
    outcome: ShiftOutcome,
    step_us: int,
    recorded: Trajectory,
    replayed: Trajectory,
    record: ShiftRecord | None,
    settings: ControllerSettings,
    *,
    known: int,
    strayed: int | None,
) -> Judged:
    """outcome: the log's, for gears and request alone; record: the other controller's shift, None
    where it refused; known: gears whose phase reference is known, one bit each."""
    request_us = outcome.request_time_us
    theirs = recorded.decisions(step_us, request_us)
    firing = firing_of(theirs, recorded.aborted_ms(step_us))
    judged_to_ms = firing.expected_contact_ms if firing else None
    mine = [
        decision
        for decision in replayed.decisions(step_us, request_us)
        if judged_to_ms is None or decision.at_ms < judged_to_ms
    ]
    target = DRIVE_GEARS[outcome.to_gear].main
    driven = replayed.driven(step_us, request_us)
    parted = _parting(recorded, replayed, step_us, request_us, judged_to_ms)
    trajectory_ms = trajectory_parted_ms(recorded, replayed, step_us, request_us)
    if judged_to_ms is not None and trajectory_ms is not None and trajectory_ms >= judged_to_ms:
        trajectory_ms = None
    end_ms = math.inf if judged_to_ms is None else judged_to_ms
    own_ms = end_ms if trajectory_ms is None else trajectory_ms
    aborted_ms = [at_ms for at_ms in replayed.aborted_ms(step_us) if at_ms < own_ms]
    fired = firing_of(mine, aborted_ms)
    status, last, fault = _status(mine, fired, record, judged_to_ms, step_us, replayed)
    if status == "fired" and last is not None:
        end_ms = last.at_ms

    def at(said: Said) -> float:
        return (said.time_us - step_us) / 1000

    return Judged(
        from_=outcome.from_gear,
        to=outcome.to_gear,
        request_us=request_us,
        strategy=settings.name_of(record.strategy) if record else settings.strategy_name,
        reference="known" if known >> (target - 1) & 1 else "unknown",
        status=status,
        fault=fault,
        last=last,
        recorded=firing,
        parted=parted,
        trajectory_parted_ms=trajectory_ms,
        judged_to_ms=judged_to_ms,
        contact_why=_contact_why(status, last, parted, firing),
        aborted_ms=aborted_ms,
        strayed_at_step=strayed,
        decisions=mine,
        driven=_up_to(driven, judged_to_ms),
        events=[line for said in replayed.steps for line in said.events if at(said) <= end_ms],
    )


def rounded(values: dict[str, Any]) -> dict[str, Any]:
    """Floats to six places."""
    return {k: round(v, 6) if isinstance(v, float) else v for k, v in values.items()}


def _status(
    mine: list[Decision],
    fired: Decision | None,
    record: ShiftRecord | None,
    judged_to_ms: float | None,
    step_us: int,
    replayed: Trajectory,
) -> tuple[str, Decision | None, str]:
    """What became of it up to there, by its firing or else its last decision; its fault."""
    if record is None or record.result is ShiftResult.REFUSED:
        return "refused", None, "none" if record is None else record.fault.name.lower()
    if fired is not None:
        return "fired", fired, "none"
    last = mine[-1] if mine else None
    for said in replayed.steps:
        if said.ended is not None:
            at_ms = (said.time_us - step_us) / 1000
            if judged_to_ms is None or at_ms < judged_to_ms:
                return "ended", last, said.ended.fault.name.lower()
            break
    is_planned = last is not None and last.decision == "fire"
    return "planned" if is_planned else "waiting", last, "none"


def _parting(
    recorded: Trajectory,
    replayed: Trajectory,
    step_us: int,
    request_us: int,
    judged_to_ms: float | None,
) -> OfCommands | None:
    for theirs, mine in zip(recorded.steps, replayed.steps, strict=True):
        at_ms = (theirs.time_us - step_us) / 1000
        if judged_to_ms is not None and at_ms >= judged_to_ms:
            return None
        differ = differing(theirs, mine)
        if not differ:
            continue
        was, now = (
            None if s.prediction is None else decision_of(s.prediction, at_ms, request_us)
            for s in (theirs, mine)
        )
        return Parting(at_ms, tuple(differ), (was, now))
    return None


def _up_to(
    driven: dict[str, list[tuple[float, float]]], end_ms: float | None
) -> dict[str, list[tuple[float, float]]]:
    if end_ms is None:
        return driven
    cut = {
        name: [(start, min(end, end_ms)) for start, end in spans if start < end_ms]
        for name, spans in driven.items()
    }
    return {name: spans for name, spans in cut.items() if spans}


def _contact_why(
    status: str,
    last: Decision | None,
    parted: OfCommands | None,
    firing: Decision | None,
) -> str:
    """Why the log does not show where the other controller's tooth would have met."""
    if parted is None:
        return "its commands are the recorded ones: what came of them is the log's"
    if status not in ("fired", "planned") or last is None:
        until = "the recorded shift had ended"
        if firing is not None:
            until = f"the recorded sleeve met its gear ({firing.expected_contact_ms:.0f} ms)"
        return f"no firing was decided before {until}"
    was = firing.release_ms if firing else None
    if was is not None and last.release_ms is not None and was != last.release_ms:
        apart = last.release_ms - was
        later = "later" if apart > 0 else "earlier"
        return (
            f"the brake would have been released {abs(apart):.1f} ms {later} than recorded: the "
            "gear would have turned otherwise than the log shows"
        )
    return "the sensors of the log answer to the recorded commands alone"


def _parting_json(parted: OfCommands | None) -> dict[str, Any] | None:
    if parted is None:
        return None
    each = {
        name: None if decision is None else rounded(vars(decision))
        for name, decision in zip(("recorded", "replayed"), parted.knew, strict=True)
    }
    return {"at_ms": round(parted.at_ms, 6), "commands": list(parted.differ), **each}
