"""What every bench sees of its bus, and how it makes a shift: in virtual time and live alike."""

from __future__ import annotations

import shutil
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self, TypeVar

from meshpoint.api.choices import PathLike
from meshpoint.base.errors import RunError
from meshpoint.bench.bench import BenchCore, PlannedShift, plan_shifts
from meshpoint.bench.pauses import pauses_of
from meshpoint.bench.schedules import check_preset
from meshpoint.bench.setup import Setup
from meshpoint.bench.simulate import LAYSHAFT_RAD_S
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import read_alone
from meshpoint.dbc.messages import (
    ControllerStatus,
    Message,
    ShiftOutcome,
    ShiftResult,
)
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.results.faults import explain
from meshpoint.results.monitor import RowMonitor
from meshpoint.results.output import folder_for
from meshpoint.results.rows import ShiftRow
from meshpoint.results.states import standing_words

M = TypeVar("M", bound=Message)
DEFAULT_TIMEOUT_S = 30.0
LEARNING_TRIES = 3


class ShiftError(RunError):
    """A shift that was refused, or of which the bus has reported no end; the message says why."""


class Watching(ABC):
    """The part that `Bench` and `LiveBench` share."""

    def __init__(self, setup: Setup, gear: int) -> None:
        _check_gear(gear)
        self.sheet = setup.sheet
        """The data sheet of controller and rig."""
        self.settings = setup.settings
        """The controller's settings."""
        self._preset = setup.preset
        self._gear = gear
        self._monitor = RowMonitor(setup.sheet, setup.settings)
        pauses = pauses_of(setup.sheet, setup.profile, setup.preset)
        self._operator = BenchCore([], pauses)
        self._planned: list[PlannedShift] = []
        self._latest: dict[int, Frame] = {}

    # ------------------------------------------------------ what was seen ----

    @property
    @abstractmethod
    def now_s(self) -> float:
        """Bus time since the start, s."""

    @property
    def shifts(self) -> list[ShiftRow]:
        """Every shift so far: what the controller reported beside the rig's truth."""
        return list(self._monitor.rows.rows)

    @property
    def status(self) -> ControllerStatus | None:
        """The controller's newest status; None before the first."""
        return self._monitor.status

    @property
    def gear(self) -> int:
        """The gear the next shift begins in, unless `from_gear` says otherwise."""
        return self._gear

    @property
    def reference_known(self) -> frozenset[int]:
        """Main-box gears (1 crawl to 4 third) whose phase reference the controller knows."""
        mask = 0 if self.status is None else self.status.reference_known
        return frozenset(gear for gear in range(1, 5) if mask >> (gear - 1) & 1)

    def latest(self, kind: type[M]) -> M | None:
        """The newest message of a type of `meshpoint.messages`; None where none has come."""
        codec = CODECS[kind.__name__]
        frame = self._latest.get(codec.spec.can_id)
        message = None if frame is None else read_alone(codec, frame)
        return message if isinstance(message, kind) else None

    def _see(self, frame: Frame) -> None:
        """A frame in bus order."""
        self._latest[frame.can_id] = frame
        self._monitor.take(frame)

    # ------------------------------------------------------------- shifts ----

    def shift(self, to_gear: int, from_gear: int | None = None) -> ShiftRow:
        """One shift, and the pause after it in which the new gear's phase is learned.

        The rig is first brought into `from_gear` by its bench script (without a shift), at the
        speeds that `meshpoint simulate` begins at; without it, into the gear of the last shift.
        Gears are 1 to 12; 13 and 14 are the crawl gears.

        Returns the shift's record: `contact` is "gap", "tooth" or None. A shift that fails has a
        record too, its `result` says how. ShiftError where it was refused or has no end.
        """
        before, number = len(self.shifts), self.begin(to_gear, from_gear)
        self._until_done()
        rows = self.shifts
        if len(rows) == before:
            raise ShiftError(self._why_no_row(number))
        row = rows[-1]
        self._gear = row.to if row.result == "engaged" else self._planned[number].from_
        return row

    def begin(self, to_gear: int, from_gear: int | None = None) -> int:
        """As `shift`, but returns at once: the shift is made while time goes on. Returns its
        number, counted from 0; `shift_is_over` says when it has ended."""
        from_gear = self._gear if from_gear is None else from_gear
        for gear in (from_gear, to_gear):
            _check_gear(gear)
        if from_gear == to_gear:
            raise ValueError(f"the bench is in gear {to_gear} already; from_gear begins elsewhere")
        pair = ((from_gear, to_gear),)
        check_preset(pair, self.sheet, self._preset)
        planned = plan_shifts(self.sheet, list(pair), 1, LAYSHAFT_RAD_S)[0]
        self._planned.append(planned)
        self._order(lambda: self._operator.add(planned))
        return len(self._planned) - 1

    @property
    def shift_is_over(self) -> bool:
        """Whether nothing is left of the shifts that were begun."""
        return self._operator.done and self._operator.index >= len(self._planned)

    def learn(self, *gears: int) -> list[ShiftRow]:
        """Shifts into each of these gears whose phase reference is not known yet, at most three
        times: once it is, the controller can aim at the gear's gap. The next shift begins in the
        gear that this one began in. ShiftError where it stays unknown."""
        origin, rows = self._gear, []
        for gear in gears:
            _check_gear(gear)
            main, tries = int(DRIVE_GEARS[gear].main), 0
            while main not in self.reference_known:
                if tries == LEARNING_TRIES:
                    raise ShiftError(f"gear {gear}: phase reference not learned in {tries} shifts")
                rows.append(self.shift(gear, origin))
                tries += 1
        self._gear = origin
        return rows

    def send(self, message: Message) -> None:
        """Sends a message of the bench (TC1, BenchCommand, BenchFault) with its next step, within
        10 ms. EncodeError for a message the bench does not send, or a value out of range."""
        self._order(lambda: self._operator.send(message))

    def _why_no_row(self, number: int) -> str:
        planned = self._planned[number]
        what = f"shift {planned.from_} -> {planned.to}"
        outcome = self.latest(ShiftOutcome)
        if outcome is not None and outcome.result is ShiftResult.REFUSED:
            return f"{what}: refused, {explain(outcome.fault)}"
        status = self.status
        if status is None:
            return f"{what}: no controller was heard"
        return f"{what}: no outcome; the controller stands {standing_words(status)}"

    # ------------------------------------------------------- how it goes on ----

    @abstractmethod
    def _order(self, order: Callable[[], None]) -> None:
        """Passes an order to the operator, at a moment when it may be given."""

    @abstractmethod
    def _until_done(self) -> None:
        """Lets time go on until nothing is left of the shifts begun."""

    def save_log(self, folder: PathLike) -> Path:
        """Copies the log so far into a folder, with the run header beside it; returns where it is.
        RuntimeError where the bus is not recorded."""
        source, target = self._complete_log(), folder_for(Path(folder))
        for header in source.parent.glob("header-*.json"):
            shutil.copy(header, target)
        return Path(shutil.copy(source, target / source.name))

    @abstractmethod
    def _complete_log(self) -> Path:
        """Brings everything recorded so far to disk; where it is."""

    @abstractmethod
    def close(self) -> None:
        """Ends the nodes, all valves off, and completes the log."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: Any) -> None:
        self.close()


def _check_gear(gear: int) -> None:
    if gear not in DRIVE_GEARS:
        raise ValueError(f"gear {gear!r}, allowed are 1 to {len(DRIVE_GEARS)}")
