"""What the repeating of a log came to: a session for each run of a controller, and its verdict."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

from meshpoint.controller.settings.header import RunHeader


class Verification(Enum):
    """What a log's verification came to."""

    IDENTICAL = "identical"
    IN_PARTS = "identical in parts"
    """Before and after link outages, whose steps are not in the log."""
    DIFFERS = "differs"
    NOT_VERIFIABLE = "not verifiable"


class Hole(NamedTuple):
    """Steps that are not in the log, from `first` to `last`, repeated from the record of an
    outage; `from_us` and `to_us` are the times of these two."""

    first: int
    last: int
    from_us: int
    to_us: int

    def __str__(self) -> str:
        lasted_s = (self.to_us - self.from_us) / 1e6
        return f"{self.first} to {self.last} ({lasted_s:.2f} s)"


@dataclass
class Session:
    """One run of a controller within a log."""

    header: RunHeader | None = None
    run_hash: int = 0
    steps: int = 0
    frames: int = 0
    verdict: Verification = Verification.IDENTICAL
    step: int | None = None
    """The step at which it differs or stops being verifiable."""
    reason: str = ""
    strategy_errors: dict[str, int] = field(default_factory=dict)
    """What was wrong with a user's own strategy, and how many shifts ended of it."""
    intruders: Counter[int] = field(default_factory=Counter)
    """Frames under the controller's address that are damaged or not its own, by identifier."""
    holes: list[Hole] = field(default_factory=list)

    unlogged: int = 0
    """Steps that the controller has made after the log's end, where a record shows them."""

    def end(self, verdict: Verification, step: int, reason: str) -> None:
        """Goes no further than this step. A difference where floating point may round otherwise
        shows nothing of the code."""
        otherwise = self.header.rounds_otherwise if self.header is not None else ""
        if verdict is Verification.DIFFERS and otherwise:
            verdict = Verification.NOT_VERIFIABLE
            reason = f"{reason}; {otherwise}, which may round otherwise"
        self.verdict, self.step, self.reason = verdict, step, reason

    @property
    def goes_on(self) -> bool:
        """Whether all that was compared so far is identical."""
        return self.verdict in (Verification.IDENTICAL, Verification.IN_PARTS)

    @property
    def compared_steps(self) -> int:
        """Those of the log."""
        return self.steps - sum(hole.last - hole.first + 1 for hole in self.holes)

    def __str__(self) -> str:
        return self._verdict_text() + self.intruders_text

    def _verdict_text(self) -> str:
        if self.verdict is Verification.IDENTICAL:
            more = f"; the controller made {self.unlogged} more after it" if self.unlogged else ""
            return f"identical: {self.steps} steps, {self.frames} frames{more}"
        holes = ", ".join(map(str, self.holes))
        if self.verdict is Verification.IN_PARTS:
            return (
                f"identical in parts: {self.compared_steps} steps, {self.frames} frames; not in "
                f"the log, for a link outage, and repeated from its record: steps {holes}"
            )
        where = "" if self.step is None else f" at step {self.step}"
        outage = f"; steps {holes} were repeated from the record of a link outage" if holes else ""
        return f"{self.verdict.value}{where}: {self.reason}{outage}"

    @property
    def intruders_text(self) -> str:
        """Who else has sent under its address, as the end of a sentence."""
        if not self.intruders:
            return ""
        each = ", ".join(f"{can_id:08X} ({n})" for can_id, n in sorted(self.intruders.items()))
        return f"; under its address, damaged or not its own: {each}"
