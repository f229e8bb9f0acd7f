"""The state of the rig's own node under a fault: hanging, or off the bus while it restarts."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class NodeState:
    """What `RigCore` looks at; faults set it. Times are microseconds since power-up.

    stalled_until_us  the event loop hangs until then: nothing is sent, nothing is consumed, and
                      what was due comes in one go afterwards
    away              the gearbox I/O is off the bus and deaf; engine and reference go on
    restarts          how often it has started anew: counters and receivers from the beginning
    """

    stalled_until_us: int = 0
    away: bool = False
    restarts: int = 0
