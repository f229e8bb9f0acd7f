"""How long nodes that are quiet are waited for: by what the machine and the bus gave them.

A node that starts is measured by its own time: the processor time that it had, and the time in
which it asked for none. What it spent ready to run, but without a processor, does not count, so a
busy machine makes a start slow, not late. An emulated machine does not know when it was kept from
running, and is slow itself: its limits are longer by how much slower it computes. Once the bus
runs, what counts is bus time.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

START_S: Final = 120.0
"""A node's own seconds before it must be heard; it needs two, and sixty where it compiles."""
SHIFT_SILENCE_US: Final = 20_000_000
"""Bus time without a shift after which a run is given up: the bench itself is patient for 8 s."""
NODE_QUIET_US: Final = 1_000_000
"""Bus time after which a node counts as silent; each speaks every 10 ms."""
RUNNABLE: Final = "R"


class Taken(NamedTuple):
    """What a process has had of the machine: processor seconds, and its state as the kernel
    abbreviates it."""

    processor_s: float
    state: str


def taken(process: int) -> Taken | None:
    """What a process has had so far; None where the system does not say, or it has ended."""
    try:
        # The name, in brackets, may hold anything; the state follows it.
        text = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    fields = text.rpartition(")")[2].split()
    return Taken((int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"), fields[0])


class OwnTime:
    """Seconds of a process's own time, added up look by look."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._before: Taken | None = None

    def look(self, now: Taken | None, passed_s: float) -> None:
        """`passed_s` after the poll before. A system that does not say counts them all."""
        before, self._before = self._before, now
        if now is None or before is None:
            self.seconds += passed_s
            return
        used_s = now.processor_s - before.processor_s
        if used_s > 0.0:
            self.seconds += used_s
        elif now.state != RUNNABLE:
            self.seconds += passed_s


@dataclass
class Heard:
    """When each node was last heard, in the bus time at which the run looked."""

    frames: dict[str, int] = field(default_factory=lambda: {"rig": 0, "controller": 0})
    """Frames so far, by node."""
    _seen: dict[str, int] = field(default_factory=dict)
    _last_us: dict[str, int] = field(default_factory=dict)

    def missing(self) -> list[str]:
        """The nodes not heard at all."""
        return [name for name, count in self.frames.items() if not count]

    def look(self, now_us: int) -> None:
        """Notes who has spoken since the look before."""
        for name, count in self.frames.items():
            if count != self._seen.get(name):
                self._seen[name], self._last_us[name] = count, now_us

    def silent(self, now_us: int) -> list[str]:
        """The nodes that have not spoken for a while."""
        return [name for name, at_us in self._last_us.items() if now_us - at_us > NODE_QUIET_US]


def not_started(missing: list[str], limit_s: float) -> str:
    """Says which side was late, after how many seconds of its own time, and what to do."""
    late = " and ".join(missing)
    alone = " or ".join(f"meshpoint {name}" for name in missing)
    return (
        f"{late} not heard on the bus after {limit_s:.0f} s of time to run: see what was said "
        f"above, or start it by hand ({alone}) and see what it says"
    )


def no_shift(silent: list[str], paced: bool) -> str:
    """The same for a run in which shifts no longer come."""
    seconds = SHIFT_SILENCE_US // 1_000_000
    if silent:
        late = " and ".join(silent)
        return f"no shift within {seconds} s of bus time: {late} silent; see what was said above"
    advice = (
        "the log in the output folder has what they said (meshpoint replay)"
        if paced
        else "a machine that cannot keep up needs bus time that waits: leave out --wall-clock"
    )
    return f"no shift within {seconds} s of bus time, though both nodes were heard: {advice}"
