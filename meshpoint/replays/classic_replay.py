"""A log of the classic profile through the same core, step by step.

What each step was made of stands in the record that the controller has kept beside the run header
(`bus/classic/step_record.py`); the frames themselves are the log's, by their CRC. What the repeated
steps send is packed as on the bus, and compared to the byte with what the log holds of it.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from e2e.p01 import e2e_p01_check

from meshpoint.bus.classic.cores import ClassicControllerCore
from meshpoint.bus.classic.parts import PartsIntake
from meshpoint.bus.classic.step_record import (
    Kind,
    RecordedStep,
    RecordedSteps,
    StepRecordError,
    kind_of,
    step_record_name,
)
from meshpoint.bus.core import AroundCore, Core, Step
from meshpoint.bus.diagnosis.core import SENT_GROUPS
from meshpoint.controller.core.core import OWN_ADDRESS, ControllerCore
from meshpoint.controller.settings.header import HeaderError, RunHeader, run_hash_of
from meshpoint.dbc.classic.codecs import CLASSIC_CODECS, COUNTER_BYTE, COUNTER_MASK, LENGTH
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import group_of
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ControllerStatus
from meshpoint.dbc.node import Node
from meshpoint.logs.consumed import (
    UNKNOWN_FRAME,
    DiffersError,
    NotVerifiableError,
    WaitingFrames,
    compare,
)
from meshpoint.replays.session import Session, Verification

OWN: Final = {
    codec.spec.can_id: codec.spec
    for codec in CLASSIC_CODECS.values()
    if codec.spec.sender is Node.TRANSMISSION_CONTROL
}
"""What the controller sends."""
ORDERS: Final = CLASSIC_CODECS["ValveOrders"].spec.can_id
STATUS: Final = CODECS[ControllerStatus.__name__]
MOST_BEFORE: Final = 256
"""Own frames kept until the status is whole that says whose they are; it takes four steps."""
MID_RUN: Final = "the log starts in mid-run; what the steps before it saw is unknown"
Headers = Callable[[int], tuple[RunHeader, RunHeader]]


class _Inside(AroundCore[Core]):
    """The core inside, which shows its frames before they are packed. Where the node answered
    garage diagnosis, some steps were of that alone, and not of the core."""

    def __init__(self, core: Core, diagnosed: bool, on_output: Callable[[Frame], None]) -> None:
        super().__init__(core)
        self._diagnosed, self._on_output = diagnosed, on_output

    def step(self, now_us: int) -> Step:
        """The core's step where it is due."""
        if self._diagnosed and now_us < self._core.next_step_us:
            return Step([], [])
        step = self._core.step(now_us)
        for frame in step.frames:
            self._on_output(frame)
        return step


class ClassicReplay:
    """Feeds a log's frames to controllers, one for each run that the log holds."""

    def __init__(
        self,
        folder: Path,
        waiting: WaitingFrames,
        headers: Headers,
        on_output: Callable[[Frame], None] | None = None,
        on_event: Callable[[int, str], None] | None = None,
    ) -> None:
        """folder: where the records of steps are. waiting: frames that came before. headers: by a
        run's hash its header, and the one to repeat it from."""
        self._folder, self._waiting, self._headers = folder, waiting, headers
        self._on_output = on_output or (lambda _frame: None)
        self._on_event = on_event or (lambda _time_us, _line: None)
        self._status = PartsIntake(ControllerStatus.__name__)
        self._before: deque[Frame] = deque(maxlen=MOST_BEFORE)
        """Own frames that no run has yet."""
        self._core: ClassicControllerCore | None = None
        self._steps: Iterator[RecordedStep] = iter(())
        self._expected: deque[Frame] = deque()
        """Sent by repeated steps, and not met in the log so far."""
        self._odd: list[Frame] = []
        """Frames without protection that stand before the next one expected: of somebody else, if
        it follows."""
        self._has_ended = False
        """The record has shown the controller's end."""
        self._intruders: Counter[int] = Counter()
        self.sessions: list[Session] = []

    def take(self, frame: Frame) -> None:
        """One frame of the log, in order; as `canonical` has it."""
        if not (frame.is_extended and frame.can_id & 0xFF == OWN_ADDRESS):
            if kind_of(frame) is Kind.KNOWN:
                self._waiting.add(frame)
            return
        if group_of(frame.can_id) in SENT_GROUPS:
            return
        if not _is_own(frame):
            self._intruders[frame.can_id] += 1
            return
        self._judge(lambda: self._compare(frame))
        if frame.can_id in self._status.ids:
            for whole in self._status.take(frame):
                status = STATUS.decode(whole.data)
                if isinstance(status, ControllerStatus):
                    self._hear(status)

    def finish(self) -> list[Session]:
        """At the log's end: the runs."""
        self._judge(self._close)
        self._tell_intruders()
        if not self.sessions:
            reason = "the log holds no status of the controller that is whole"
            self.sessions.append(Session(verdict=Verification.NOT_VERIFIABLE, reason=reason))
        return self.sessions

    def _tell_intruders(self) -> None:
        if self.sessions:
            self.sessions[-1].intruders += self._intruders
            self._intruders.clear()

    def _judge(self, act: Callable[[], None]) -> None:
        """Does something for the present run, whose verdict is what that raises."""
        try:
            act()
        except (NotVerifiableError, HeaderError, StepRecordError) as error:
            self._end(Verification.NOT_VERIFIABLE, str(error))
        except DiffersError as error:
            self._end(Verification.DIFFERS, str(error))

    def _end(self, verdict: Verification, reason: str) -> None:
        session = self.sessions[-1]
        session.end(verdict, max(0, session.steps - (verdict is Verification.DIFFERS)), reason)
        self._core = None

    def _hear(self, status: ControllerStatus) -> None:
        """A status is whole: of the present run, or of another one."""
        run_hash = run_hash_of(status)
        if self.sessions and status.step_number and run_hash == self.sessions[-1].run_hash:
            return
        self._judge(self._close)
        self._tell_intruders()
        self.sessions.append(Session(run_hash=run_hash))
        self._judge(lambda: self._start(status))

    def _start(self, status: ControllerStatus) -> None:
        session = self.sessions[-1]
        first, self._before = _of_this_run(self._before), deque(maxlen=MOST_BEFORE)
        if status.step_number:
            raise NotVerifiableError(MID_RUN)
        path = self._folder / step_record_name(session.run_hash, status.step_time_us)
        if not path.exists():
            raise NotVerifiableError(
                f"a frame of 8 bytes has no room for what each step consumed, and {path.name}, in "
                "which a controller keeps it (--header-dir, --log), is not beside the log"
            )
        session.header, header = self._headers(session.run_hash)
        steps = RecordedSteps(path)
        core = ControllerCore(header)
        session.strategy_errors = core.strategy_errors
        inside = _Inside(core, steps.diagnosed, self._on_output)
        self._core, self._steps = ClassicControllerCore(inside, header.sheet), iter(steps)
        self._expected, self._odd, self._has_ended = deque(), [], False
        self._waiting.lose_place()
        for frame in first:
            self._compare(frame)

    def _compare(self, frame: Frame) -> None:
        """A frame that the controller has sent, with the next one of the repeated steps."""
        while self._core is not None and not self._expected and self._repeat(self._core):
            pass
        if self._core is None or not self._expected:
            self._before.append(frame)
            return
        mine = self._expected[0]
        if frame.can_id == mine.can_id and frame.data == mine.data:
            self._expected.popleft()
            self.sessions[-1].frames += 1
            self._intruders.update(each.can_id for each in self._odd)
            self._odd = []
        elif OWN[frame.can_id].data_id is None:
            self._odd.append(frame)
        elif _begins(frame) and not self._repeat(self._core):
            # Killed while it sent its last frames: this one is of the next controller.
            self._expected.clear()
            self._before.append(frame)
        else:
            self._differ(frame)

    def _differ(self, frame: Frame | None) -> None:
        mine = self._expected[0]
        alike = [each for each in self._odd if each.can_id == mine.can_id]
        compare(mine, alike[0] if alike else frame)

    def _repeat(self, core: ClassicControllerCore) -> bool:
        """The next step of the record; False where there is none."""
        step = next(self._steps, None)
        if step is None:
            return False
        session = self.sessions[-1]
        consumed = self._waiting.take(step.known, step.crc)
        for frame in consumed + [UNKNOWN_FRAME] * step.foreign:
            core.receive(frame)
        if step.is_last:
            self._has_ended = True
            made = core.shutdown(step.time_us)
        else:
            session.steps += 1
            made = core.step(step.time_us)
        for line in made.events:
            self._on_event(step.time_us, line)
        self._expected.extend(made.frames)
        return True

    def _close(self) -> None:
        """The present run goes no further in this log."""
        if self._core is None:
            return
        session = self.sessions[-1]
        if self._odd:
            self._differ(None)
        left = _not_of_the_next(self._before)
        if left and self._has_ended:
            compare(None, left[0])
        if left:
            raise NotVerifiableError("the record of its steps ends here")
        if self._expected and not self._has_ended:
            session.steps -= 1  # the log ends within it: what there is of it agrees
            session.unlogged = 1
        session.unlogged += sum(not step.is_last for step in self._steps)
        self._core = None


def _is_own(frame: Frame) -> bool:
    """Whether a frame under the controller's address may be its own: of a message that it sends,
    and with undamaged protection. J1939's messages have none."""
    spec = OWN.get(frame.can_id)
    if spec is None or frame.is_fd or len(frame.data) != LENGTH:
        return False
    return spec.data_id is None or bool(e2e_p01_check(bytearray(frame.data), spec.protected_id))


def _begins(frame: Frame) -> bool:
    """Whether a controller that has just been started may have sent this as its first frame."""
    return frame.can_id == ORDERS and frame.data[COUNTER_BYTE] & COUNTER_MASK == 0


def _beginning(frames: deque[Frame]) -> int:
    """Where among the newest frames the one is that a controller began with; their number where
    there is none. The counter is at 0 again after fifteen steps, and a status takes four."""
    found = [number for number, frame in enumerate(frames) if _begins(frame)]
    return found[-1] if found else len(frames)


def _of_this_run(frames: deque[Frame]) -> list[Frame]:
    """Of the frames up to the first whole status of a run those that are the run's."""
    return list(frames)[_beginning(frames) :]


def _not_of_the_next(frames: deque[Frame]) -> list[Frame]:
    """The others."""
    return list(frames)[: _beginning(frames)]
