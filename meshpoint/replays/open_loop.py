"""Open loop: what another strategy decides at every recorded request, beside what was sent.

A log's sensors answer to the recorded commands alone. So the recorded controller is repeated as it
was, and at each step in which it begins a shift a copy of it, with the other settings, is fed the
same frames until that shift has ended; then the copy is thrown away. Each recorded shift is thus
judged from the state in which it was begun (gear, valves, brake history, references learned by
then), whatever was decided in the shifts before it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.estimate.brake_model import BrakeModel
from meshpoint.controller.settings.header import RunHeader
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.shift.table import ShiftRecord
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.messages import ControllerState, ControllerStatus
from meshpoint.replays.copies import copied
from meshpoint.replays.landing import DRAWS, PartedController, work_out
from meshpoint.replays.recorded_trajectory import RecordedTrajectory
from meshpoint.replays.replay_estimator import ReplayEstimator
from meshpoint.report.counterfactual import Counterfactual, undecidable
from meshpoint.report.judged import Judged, judge
from meshpoint.report.trajectory import (
    Trajectory,
    differing,
    said,
    trajectory_parted_ms,
)

SHIFTING: Final = frozenset(ControllerState) - {
    ControllerState.STARTING,
    ControllerState.IN_GEAR,
    ControllerState.NEUTRAL,
    ControllerState.CLUTCH_CLOSING,
    ControllerState.FAULTED,
}
"""States in which a shift is under way."""


@dataclass
class _Branch:
    """A copy of the controller with the other settings, in one recorded shift."""

    core: ControllerCore
    step_us: int
    known: int
    """Gears whose phase reference was known at the request, one bit each."""
    recorded: Trajectory = field(default_factory=Trajectory)
    replayed: Trajectory = field(default_factory=Trajectory)
    record: ShiftRecord | None = None
    trajectory: RecordedTrajectory = field(default_factory=RecordedTrajectory)
    parting: PartedController | None = None
    sent: list[tuple[float, list[Frame]]] = field(default_factory=list)
    """Frames of each step, by ms since the request."""
    undriven: str = ""
    """What else than valves was commanded differently when the trajectories parted."""

    def step(self, time_us: int, consumed: list[Frame]) -> None:
        """The same frames at the same step."""
        for frame in consumed:
            self.core.receive(frame)
        made = self.core.step(time_us)
        self.record = self.core.running_shift or self.record
        self.sent.append(((time_us - self.step_us) / 1000, made.frames))
        self.replayed.take(said(time_us, made.frames, tuple(made.events)))

    def part(self) -> None:
        """Keeps the copy as it is at the last step before the frames answer to other commands than
        its own."""
        theirs, mine = self.recorded.steps[-1], self.replayed.steps[-1]
        if self.parting is not None or self.record is None or not differing(theirs, mine):
            return
        request_us = self.record.request_us
        if trajectory_parted_ms(self.recorded, self.replayed, self.step_us, request_us) is None:
            return
        self.undriven = " and ".join({"clutch", "engine"} & set(differing(theirs, mine)))
        self.parting = PartedController(self.core, len(self.trajectory.steps) + 1)

    def counterfactual(self, known: BrakeModel, judged: Judged, draws: int) -> Counterfactual:
        """Where its tooth would have landed. The recorded trajectory is closed; known: the brake as
        learned by then."""
        if judged.parted is None:
            return undecidable(judged.contact_why)
        if self.parting is None or judged.trajectory_parted_ms is None:
            return undecidable(judged.contact_why)
        if self.undriven:
            return undecidable(f"{self.undriven} commanded otherwise: they have no model here")
        return work_out(self.parting, self.trajectory, known, judged.request_us, draws)


class OpenLoop:
    """Watches while a log is repeated (`meshpoint.replays.replay.Onlooker`).

    change(header): the header of the other controller. A session in which nothing can be repeated
    has no shifts.
    """

    def __init__(
        self,
        change: Callable[[RunHeader], RunHeader],
        draws: int = DRAWS,
        *,
        keeps_traces: bool = True,
    ) -> None:
        """draws: of each shift's landing (`counterfactual`); 0: landings are not worked out.
        keeps_traces: each shift's decisions and trajectories are kept, for drawing."""
        self._keeps_traces = keeps_traces
        self._change = change
        self._draws = draws
        self._core: ControllerCore | None = None
        self._consumed: list[Frame] = []
        self._settings = ControllerSettings()
        self._follower: ReplayEstimator | None = None
        self._branch: _Branch | None = None
        self._session = -1
        self._strayed: int | None = None
        self._errors: dict[str, int] = {}
        self.judged: dict[tuple[int, int], Judged] = {}
        """By session, counted from 0, and the request's 32-bit sensor time."""
        self.unfinished = 0
        """Shifts under way where a session ended: they have no outcome in the log."""

    @property
    def steps_sent(self) -> list[tuple[float, list[Frame]]]:
        """What the other controller has sent in the shift under way: ms since the request and
        frames, step by step."""
        return [] if self._branch is None else self._branch.sent

    def start(self, header: RunHeader, errors: dict[str, int]) -> None:
        """A session begins; `errors`: what is wrong with a user's own strategy is counted there."""
        self.end()
        self._session += 1
        other = self._change(header)
        self._settings, self._errors, self._strayed = other.settings, errors, None
        self._follower = ReplayEstimator(other) if estimates_differ(header, other) else None

    def end(self) -> None:
        """The session, or what can be repeated of it, has ended."""
        if self._branch is not None:
            self.unfinished += 1
        self._branch = None

    def before(
        self,
        core: ControllerCore,
        status: ControllerStatus,
        sent: list[Frame],
        consumed: list[Frame],
    ) -> None:
        """A step is about to be repeated: `core` as recorded up to here, and what it sent."""
        was = said(status.step_time_us, sent)
        if self._branch is None and (status.state in SHIFTING or was.ended is not None):
            other = self._other(core)
            self._branch = _Branch(other, status.step_time_us, other.calibration_revision[1])
        if self._branch is not None:
            self._branch.step(status.step_time_us, consumed)
            self._branch.recorded.take(was)
            self._branch.part()
        self._core, self._consumed = core, consumed

    def _other(self, core: ControllerCore) -> ControllerCore:
        """The other controller, put into the recorded state."""
        other = copied(core)
        if self._follower is None:
            other.change_settings(self._settings)
        else:
            copied(self._follower).hand_over(other)
        other.strategy_errors = {}
        return other

    def unheard(self, core: ControllerCore, time_us: int, consumed: list[Frame]) -> None:
        """A shift into whose time an outage falls is not judged: nothing was sent of it."""
        self.end()
        if self._follower is not None and core.snapshot is not None:
            self._follower.step(consumed, time_us, core.sequence, core.snapshot)

    def after(self, status: ControllerStatus, sent: list[Frame], made: list[Frame]) -> None:
        """The step has been repeated: `made` instead of `sent`."""
        now = status.step_time_us
        was, is_now = said(now, sent), said(now, made)
        if self._strayed is None and was.command != is_now.command:
            self._strayed = status.step_number
        branch, core = self._branch, self._core
        if core is None or core.snapshot is None:
            return
        seen, brake = core.snapshot, core.sequence.brake
        known = core.observer.brake
        if self._follower is not None:
            seen = self._follower.step(self._consumed, now, core.sequence, seen)
            observer = self._follower.observer
            brake, known = observer.brake_input, observer.brake
        if branch is None:
            return
        branch.trajectory.take(seen, core.running_shift, brake)
        if was.ended is None:
            return
        self._branch = None
        for line, count in branch.core.strategy_errors.items():
            self._errors[line] = self._errors.get(line, 0) + count
        key = self._session, was.ended.request_time_us
        judged = judge(
            was.ended,
            branch.step_us,
            branch.recorded,
            branch.replayed,
            branch.record,
            self._settings,
            known=branch.known,
            strayed=self._strayed,
        )
        if self._draws:
            branch.trajectory.close()
            landing = branch.counterfactual(known, judged, self._draws)
            judged = replace(judged, counterfactual=landing)
        self.judged[key] = judged if self._keeps_traces else judged.without_traces()


def estimates_differ(recorded: RunHeader, other: RunHeader) -> bool:
    """Whether the other controller estimates otherwise: by another estimator or tuning, from
    another data sheet or calibration."""
    was, now = recorded.settings, other.settings
    tunings = (
        (was.estimator, was.crossing_filter, was.cruise_filter, was.thesis_filter),
        (now.estimator, now.crossing_filter, now.cruise_filter, now.thesis_filter),
    )
    same = recorded.sheet == other.sheet and recorded.calibration == other.calibration
    return not same or tunings[0] != tunings[1]
