"""The log driver: a recorded bus through the same core, step by step.

A log is enough to repeat a live run byte for byte: each status frame says when its step was, how
many frames it consumed and their CRC, and which run header it belongs to. `verify` says one of
three things: identical; differs at step n; not verifiable, and why. Steps of a link outage are not
in the log: where the controller has kept what they were made of
(`bus/outage_record.py`), they are repeated from that, and what follows is verified
again: identical in parts.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol

from meshpoint.base.version import product_version
from meshpoint.bus.authentication.frames import PROOF
from meshpoint.bus.core import Core
from meshpoint.bus.diagnosis.core import SENT_GROUPS
from meshpoint.bus.outage_record import OutageError, StepInput, load_outages
from meshpoint.controller.core.core import OWN_ADDRESS, ControllerCore
from meshpoint.controller.settings.header import (
    HeaderError,
    RunHeader,
    XcpAccess,
    load_header,
    run_hash_of,
)
from meshpoint.dbc import DBC_SHA256
from meshpoint.dbc.e2e import check_crc
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import XCP_RESPONSE_ID, canonical, group_of
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import read_alone
from meshpoint.dbc.messages import ControllerStatus
from meshpoint.dbc.node import Node
from meshpoint.logs.consumed import (
    CONSUMED_IDS,
    UNKNOWN_FRAME,
    DiffersError,
    NotVerifiableError,
    WaitingFrames,
    compare,
)
from meshpoint.replays.session import Hole, Session, Verification

if TYPE_CHECKING:
    from meshpoint.replays.classic_replay import ClassicReplay

STATUS: Final = CODECS[ControllerStatus.__name__]
OWN: Final = {
    codec.spec.can_id: codec.spec
    for codec in CODECS.values()
    if codec.spec.sender is Node.TRANSMISSION_CONTROL
}
"""What the controller sends."""
OF_CLASSIC: Final = frozenset({0x0CFF9103, 0x18FF8080})
"""ValveOrders and SensorRead, which a bus of the classic profile has all the time."""
CLASSIC_LOG: Final = (
    "the log is of --profile classic, whose runs are repeated as they were alone: without another "
    "strategy or settings; meshpoint report shows its contacts"
)
NO_STATUS: Final = "the log holds no controller status frame"


@dataclass
class _Recorded:
    """A step as the log shows it: its status and all frames the controller sent in it."""

    status: ControllerStatus
    frames: list[Frame] = field(default_factory=list)


class Onlooker(Protocol):
    """Watches while a log is repeated."""

    def start(self, header: RunHeader, errors: dict[str, int]) -> None:
        """A session begins; `errors` of its strategies are counted there."""

    def before(
        self,
        core: ControllerCore,
        status: ControllerStatus,
        sent: list[Frame],
        consumed: list[Frame],
    ) -> None:
        """A step is about to be repeated with the frames that it consumed."""

    def after(self, status: ControllerStatus, sent: list[Frame], made: list[Frame]) -> None:
        """It has been: `made` instead of `sent`."""

    def unheard(self, core: ControllerCore, time_us: int, consumed: list[Frame]) -> None:
        """A step that the log does not hold has been repeated from the record of an outage."""

    def end(self) -> None:
        """The session cannot go on, or the log has ended."""


class LogReplay:
    """Feeds a log's frames to controllers, one for each session that the log holds.

    `change(header)` may give another header to build the controller from (another strategy); it
    raises NotVerifiableError where a run cannot be repeated. `on_step` is called after each step of
    a controller with what that sent; not in a log of the classic profile.
    """

    def __init__(
        self,
        folder: Path,
        verify: bool,
        change: Callable[[RunHeader], RunHeader] | None = None,
        on_output: Callable[[Frame], None] | None = None,
        on_event: Callable[[int, str], None] | None = None,
        onlooker: Onlooker | None = None,
        on_step: Callable[[ControllerCore, list[Frame]], None] | None = None,
    ) -> None:
        self._onlooker, self._on_step = onlooker, on_step
        self._folder = folder
        self._verify = verify
        self._change = change
        self._on_output = on_output
        self._on_event = on_event
        self._waiting = WaitingFrames(exact=verify)
        self._sent: list[Frame] = []
        self._core: ControllerCore | None = None
        self._node: Core | None = None
        """The core with what stands around it and sends frames that a step is compared by."""
        self._kept: dict[int, StepInput] | None = None
        """What this session's records of outages hold, read at the first hole."""
        self._foreign = 0
        self._intruders: Counter[int] = Counter()
        self.sessions: list[Session] = []
        self.is_classic = False
        """Whether there are frames of the classic profile in the log."""
        self._classic: ClassicReplay | None = None

    def run(self, frames: Iterable[Frame]) -> list[Session]:
        """Takes the whole log. A session that cannot go on is skipped to the next one."""
        for frame in frames:
            self.take(frame)
        self._tell_intruders()
        if self._onlooker is not None:
            self._onlooker.end()
        if self._classic is not None:
            self.sessions += self._classic.finish()
        if not self.sessions:
            session = Session(verdict=Verification.NOT_VERIFIABLE)
            session.reason = CLASSIC_LOG if self.is_classic else NO_STATUS
            self.sessions.append(session)
        return self.sessions

    def take(self, frame: Frame) -> None:
        """One frame of the log, in order."""
        frame = canonical(frame)
        if frame.can_id in OF_CLASSIC and frame.is_extended and not self.is_classic:
            self._begin_classic()
        if self._classic is not None:
            self._classic.take(frame)
        if self.is_classic and not self.sessions:
            return
        if not (frame.is_extended and frame.can_id & 0xFF == OWN_ADDRESS):
            if frame.is_extended and frame.can_id in CONSUMED_IDS:
                self._waiting.add(frame)
            return
        if frame.can_id == PROOF.can_id or group_of(frame.can_id) in SENT_GROUPS:
            return  # of the wrappers around the core: says nothing of a decision
        if not _is_own(frame):
            self._intruders[frame.can_id] += 1
            return
        self._sent.append(frame)
        status = _status(frame)
        if status is not None:
            sent = self._sent if status.step_number else _last_step(self._sent)
            step = _Recorded(status, sent)
            self._sent = []
            self._close_step(step)

    def _begin_classic(self) -> None:
        """The log is of the classic profile, at least from here on."""
        self.is_classic = True
        if self._onlooker is not None:
            return
        from meshpoint.replays.classic_replay import ClassicReplay

        self._classic = ClassicReplay(
            self._folder, self._waiting, self._header, self._on_output, self._on_event
        )

    def _header(self, run_hash: int) -> tuple[RunHeader, RunHeader]:
        """The header of a run, and the one to repeat it from. HeaderError; NotVerifiableError for
        one of another version."""
        header = load_header(self._folder, run_hash)
        if self._verify:
            _check_same_product(header)
        return header, self._change(header) if self._change else header

    def _close_step(self, step: _Recorded) -> None:
        number = step.status.step_number
        starts = not self.sessions or number == 0
        try:
            if starts:
                self._start(step.status)
            session = self.sessions[-1]
            self._tell_intruders()
            if session.goes_on:
                self._repeat(session, step)
        except (NotVerifiableError, HeaderError, OutageError) as error:
            self._end(Verification.NOT_VERIFIABLE, number, str(error))
        except DiffersError as error:
            self._end(Verification.DIFFERS, number, str(error))

    def _tell_intruders(self) -> None:
        if self.sessions:
            self.sessions[-1].intruders += self._intruders
            self._intruders.clear()

    def _end(self, verdict: Verification, number: int, reason: str) -> None:
        self.sessions[-1].end(verdict, number, reason)
        self._core = self._node = None
        if self._onlooker is not None:
            self._onlooker.end()

    def _start(self, status: ControllerStatus) -> None:
        run_hash = run_hash_of(status)
        session = Session(run_hash=run_hash)
        self.sessions.append(session)
        self._core = self._node = self._kept = None
        self._foreign = 0
        self._waiting.lose_place()
        if status.step_number != 0:
            raise NotVerifiableError(
                "the log starts in mid-run; what the steps before it saw is unknown"
            )
        session.header, changed = self._header(run_hash)
        self._core = ControllerCore(changed)
        self._node = _node_of(self._core)
        session.strategy_errors = self._core.strategy_errors
        if self._onlooker is not None:
            self._onlooker.start(session.header, session.strategy_errors)

    def _repeat(self, session: Session, step: _Recorded) -> None:
        core, node, status = self._core, self._node, step.status
        if core is None or node is None:
            raise RuntimeError("a session without a core")
        if status.step_number != session.steps:
            self._bridge(core, node, session, status.step_number)
            step.frames = _last_step(step.frames)
        consumed = self._consumed(status)
        if self._onlooker is not None:
            self._onlooker.before(core, status, step.frames, consumed)
        for frame in consumed:
            node.receive(frame)
        made = node.step(status.step_time_us)
        if self._onlooker is not None:
            self._onlooker.after(status, step.frames, made.frames)
        if self._on_step is not None:
            self._on_step(core, made.frames)
        session.steps += 1
        session.frames += len(made.frames)
        for line in made.events:
            if self._on_event is not None:
                self._on_event(status.step_time_us, line)
        for frame in made.frames:
            if self._on_output is not None:
                self._on_output(frame)
        if self._verify:
            own, others = _without_unprotected_intruders(made.frames, step.frames)
            session.intruders += others
            _compare(made.frames, own)

    def _bridge(self, core: ControllerCore, node: Core, session: Session, number: int) -> None:
        """Repeats the steps before `number` that the log does not hold, from the record that the
        controller has kept of an outage."""
        missing = range(session.steps, number)
        if missing and self._kept is None:
            self._kept = load_outages(self._folder, session.run_hash)
        kept = self._kept if missing and self._kept is not None else {}
        lost = next((each for each in missing if each not in kept), None)
        if lost is not None or not missing:
            raise NotVerifiableError(
                f"step {session.steps} is missing: frames were lost between bus and log"
                + (f", and no record of an outage beside it holds step {lost}" if kept else "")
            )
        for each in missing:
            _, time_us, consumed = kept[each]
            for frame in consumed:
                node.receive(frame)
            made = node.step(time_us)
            if self._onlooker is not None:
                self._onlooker.unheard(core, time_us, consumed)
            if self._on_event is not None:
                for line in made.events:
                    self._on_event(time_us, line)
            for status in filter(None, map(_status, made.frames)):
                self._foreign = status.foreign_frames
        hole = Hole(missing[0], missing[-1], kept[missing[0]].time_us, kept[missing[-1]].time_us)
        session.holes.append(hole)
        session.steps, session.verdict = number, Verification.IN_PARTS
        # What it has heard meanwhile stands in the record: the log goes on at some later frame.
        self._waiting.lose_place()

    def _consumed(self, status: ControllerStatus) -> list[Frame]:
        """The frames this step consumed, by its count and CRC; foreign ones by its counter."""
        unknown = (status.foreign_frames - self._foreign) & 0xFFFF
        self._foreign = status.foreign_frames
        known = self._waiting.take(status.consumed_count, status.consumed_crc)
        return known + [UNKNOWN_FRAME] * unknown


def _node_of(core: ControllerCore) -> Core:
    """The core with what has stood around it, by its header."""
    if core.header.xcp is XcpAccess.OFF:
        return core
    from meshpoint.xcp.node import XcpCore

    return XcpCore(core, core)


def _last_step(frames: list[Frame]) -> list[Frame]:
    """The frames of the last step alone: a controller that ended before has sent its last frames
    without a status. Within a step identifiers rise, but for what another sender put between."""
    start = first = len(frames) - 1
    for i in range(len(frames) - 2, -1, -1):
        if not _is_protected(frames[i]):
            start = i
        elif frames[i].can_id < frames[first].can_id:
            start = first = i
        else:
            break
    return frames[start:]


def _status(frame: Frame) -> ControllerStatus | None:
    """The status frame that closes a step, whatever its counter: a controller that has started
    anew counts from zero."""
    status = read_alone(STATUS, frame)
    return status if isinstance(status, ControllerStatus) else None


def _is_own(frame: Frame) -> bool:
    """Whether a frame under the controller's address may be its own: of a message that it sends,
    and with undamaged protection. J1939's and XCP's have none."""
    if frame.can_id == XCP_RESPONSE_ID:
        return True
    spec = OWN.get(frame.can_id)
    if spec is None or len(frame.data) != spec.length or frame.is_fd != spec.is_fd:
        return False
    return spec.data_id is None or check_crc(frame.data, spec.data_id)


def _is_protected(frame: Frame) -> bool:
    """Whether one of the controller's messages has a checksum: J1939's and XCP's have none."""
    spec = OWN.get(frame.can_id)
    return spec is not None and spec.data_id is not None


def _without_unprotected_intruders(
    made: list[Frame], logged: list[Frame]
) -> tuple[list[Frame], Counter[int]]:
    """A step's frames in the log without those of J1939 and XCP that stand beside the very frame
    that was sent: nothing else shows whose they are. And how many these are, by identifier."""
    held = {(frame.can_id, frame.data) for frame in logged}
    own: list[Frame] = []
    others: Counter[int] = Counter()
    for frame in logged:
        if _is_protected(frame):
            own.append(frame)
            continue
        mine = {(each.can_id, each.data) for each in made if each.can_id == frame.can_id}
        is_other = (frame.can_id, frame.data) not in mine and mine <= held
        if is_other and (mine or frame.can_id == XCP_RESPONSE_ID):
            others[frame.can_id] += 1
        else:
            own.append(frame)
    return own, others


def _check_same_product(header: RunHeader) -> None:
    here = (product_version(), DBC_SHA256)
    there = (header.version, header.dbc_sha256)
    for what, mine, logged in zip(("version", "DBC"), here, there, strict=True):
        if mine != logged:
            raise NotVerifiableError(f"recorded with {what} {logged}, this is {mine}")


def _compare(made: list[Frame], logged: list[Frame]) -> None:
    for mine, theirs in itertools.zip_longest(made, logged):
        compare(mine, theirs)
