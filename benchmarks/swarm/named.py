"""Every fault of the list as a scenario of its own: who finds it, when, and what comes of it.

A shift from gear 8 to 10 (or the one named) of the gearbox truck12, or truck12-dog, meets the fault
at a moment, by the controller's state. Detected: from the fault's begin to the first word about it
on the bus or in the node's log: a fault code, a block of the guard, a counter, a line.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, Final, NamedTuple

from benchmarks.swarm.episode import Episode
from benchmarks.swarm.events import (
    BUS_KINDS,
    NODE_KINDS,
    REQUEST,
    RIG_KINDS,
    Event,
    Group,
    World,
)
from benchmarks.swarm.invariants import Broken
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.messages import ControllerState, RigFault
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.truck.faults import KINDS

State = ControllerState
STRIKES_AFTER_MS: Final = 300
SEED: Final = 3
SAFETY_MS: Final = 5_000


class Named(NamedTuple):
    """A fault, and the shift that it strikes."""

    kind: str
    target: int = 0
    value: float = 0.0
    for_ms: int = 1_500
    state: ControllerState = State.SYNCHRONISING
    from_: int = 8
    to: int = 10
    asked_ms: int = STRIKES_AFTER_MS
    """When the shift is asked for."""
    dog_splitter: bool = False
    """Whether it is of `truck12-dog`."""
    after_ms: int = 0
    """So long after the state was entered it strikes."""


_N = Named
WRONG_WHEELS: Final = ((0, 0.8), (1, 2.0), (1, 0.5), (1, 0.8), (2, 0.8), (3, 0.8))
NAMED: Final = (
    _N("hall_dropout", 2), _N("hall_missing_tooth", 2, 3.0), _N("hall_double_edge", 2),
    _N("hall_noise_burst", 2, 4.0),
    *(_N("wheel_factor", wheel, factor) for wheel, factor in WRONG_WHEELS),
    *(_N("wheel_factor", wheel, factor, state=State.IN_GEAR, asked_ms=1_500)
      for wheel, factor in WRONG_WHEELS),
    _N("valve_stuck", 4, state=State.COASTING),
    _N("valve_stuck", 4, state=State.ENGAGING), _N("valve_stuck", 3, state=State.DISENGAGING),
    _N("valve_slow", 4, 40.0, state=State.COASTING),
    *(_N(kind, 4, late_ms, state=State.COASTING)
      for kind in ("valve_slow_on", "valve_slow_off") for late_ms in (10.0, 40.0)),
    *(_N("valve_leaks", valve, percent, state=State.COASTING)
      for valve in (3, 4) for percent in (2.0, 20.0)),
    *(_N("sleeve_stiff", 0, percent, state=State.COASTING) for percent in (50.0, 300.0)),
    _N("sleeve_heavy", 0, 100.0, state=State.COASTING),
    _N("supply_drop", 0, 4.0),
    _N("sleeve_jammed", 0, state=State.COASTING), _N("position_offset", 1, 3.0),
    _N("sleeve_jammed", 2, state=State.SPLITTER_CHANGING, from_=8, to=7),
    *(_N("sleeve_jammed", 2, for_ms=4_000, state=State.SPLITTER_CHANGING, from_=8, to=7,
         dog_splitter=True, after_ms=ms) for ms in (0, 300)),
    _N("position_frozen", 0, state=State.COASTING), _N("frozen_payload", 0),
    _N("frozen_payload", 1), _N("brake_fade", 0, 0.0),
    _N("clutch_stuck", state=State.CLUTCH_OPENING),
    _N("engine_deaf", for_ms=4_000, state=State.CLUTCH_OPENING, from_=10, to=8),
    _N("clock_drift", 0, 200.0),
    _N("clock_step", 0, 1_000_000.0), _N("clock_step", 0, -1_000_000.0),
    _N("node_restart", for_ms=200), _N("node_stalled", for_ms=200),
    _N("bus_drop", Group.SLOW, 1.0), _N("bus_drop", Group.EDGES, 1.0),
    _N("bus_drop", Group.VALVE_STATUS, 1.0), _N("bus_drop", Group.COMMANDS, 1.0),
    _N("bus_drop", Group.ALL, 0.05), _N("bus_duplicate", Group.SLOW, 1.0),
    _N("bus_bit_flip", Group.SLOW, 1.0), _N("bus_bit_flip", Group.EDGES, 1.0),
    _N("bus_delay", Group.ALL, 60.0), _N("bus_reorder", Group.ALL, 0.3),
    _N("bus_babble", 0, 1.0), _N("bus_own_identifier", 0, 5.0), _N("bus_off", for_ms=500),
    _N("controller_stalled", for_ms=200), _N("controller_restarted"),
)  # fmt: skip


class Outcome(NamedTuple):
    """What came of a named fault."""

    named: Named
    found_ms: float | None
    """None: nothing was said, the shift was made as if nothing were."""
    by: str
    result: str
    broken: list[Broken]


class _Scene(Episode):
    """A world whose one fault begins at a state, listening to what is said."""

    def __init__(self, named: Named) -> None:
        events = (Event(named.asked_ms, REQUEST, 0, float(named.to)),)
        layshaft_rpm = 1400.0 if named.to > named.from_ else 1100.0
        world = World(SEED, named.from_, layshaft_rpm, {}, events, SAFETY_MS, named.dog_splitter)
        super().__init__(load_sheet("truck12"), ControllerSettings(), world)
        self.named = named
        self.struck_us: int | None = None
        self.found: tuple[int, str] | None = None
        self.result = "no shift"
        self._event = Event(0, named.kind, int(named.target), named.value, named.for_ms)
        self._until_us: int | None = None
        self._entered_us: int | None = None

    def _after_controller(self, now_us: int) -> None:
        core = self._controller
        row = core.rows[0] if core.rows else None
        super()._after_controller(now_us)
        if self.struck_us is None and self.world.safety_ms * 1000 > now_us:
            if core.state is not self.named.state:
                self._entered_us = None
            elif self._entered_us is None:
                self._entered_us = now_us
            entered_us, after_us = self._entered_us, self.named.after_ms * 1000
            is_time = entered_us is not None and now_us - entered_us >= after_us
            if is_time and now_us > STRIKES_AFTER_MS * 1000:
                self.struck_us = now_us
                self._until_us = now_us + self.named.for_ms * 1000
                self.begin(self._event, now_us)
        elif self._until_us is not None and now_us >= self._until_us and self.back_by_us is None:
            self.end(self._event, now_us)
            self._until_us = None
        if row is not None:
            self._find(now_us, f"guard, row {row}")
        elif not core.sees_all:
            self._find(now_us, "channel not valid")

    def _find(self, now_us: int, by: str) -> None:
        if self.struck_us is not None and self.found is None and self.back_by_us is None:
            self.found = (now_us, by)

    def say(self, time_us: int, node: int, line: str) -> None:
        """A line of a node's log."""
        if "wrong CRC or counter" in line:
            self._find(time_us, "the gearbox's node: another sender")
        elif "did not follow on" in line:
            self._find(time_us, "the gearbox's node: frames lost")
        elif "no valve command" in line:
            self._find(time_us, "the gearbox's node: no command")
        elif node == 0 and line.startswith("speed wheel reads wrong"):
            self._find(time_us, line)
        elif node == 0 and ("clock jumped" in line or "late" in line or "lost" in line):
            self._find(time_us, "controller: " + line.split(":")[0])
        elif node == 0 and line.startswith("shift ") and self.back_by_us is None:
            result, _, fault = line.split(": ", 1)[1].partition(", fault ")
            self.result = result.replace("_", " ")
            if fault != "none":
                self._find(time_us, f"fault code {fault}")
        elif node == 0 and "refused" in line and self.back_by_us is None:
            self.result = "refused"


def run_named(named: Named) -> Outcome:
    """The scenario, to the shift that comes back after it."""
    scene = _Scene(named)
    scene.listen(scene.say)
    result = scene.run()
    struck_us = scene.struck_us
    found = scene.found

    def since_ms(time_us: int | None) -> float | None:
        return None if time_us is None or struck_us is None else (time_us - struck_us) / 1000.0

    return Outcome(
        named,
        since_ms(None if found is None else found[0]),
        "-" if found is None else found[1],
        scene.result,
        result.broken if struck_us is not None else [Broken("never_struck", 0, named.kind)],
    )


def what(named: Named) -> str:
    """The fault in words."""
    if named.kind in RIG_KINDS:
        return KINDS[RigFault[named.kind.upper()]].text
    if named.kind in BUS_KINDS:
        return BUS_KINDS[named.kind]
    return NODE_KINDS[named.kind]


def table_row(outcome: Outcome) -> str:
    """A line of docs/reference/faults.md."""
    named: Any = outcome.named
    found = "-" if outcome.found_ms is None else f"{outcome.found_ms:.0f}"
    value = f" {named.value:g}" if named.value else ""
    name = f"`{named.kind} {int(named.target)}{value}`"
    state = named.state.name.lower()
    state += f", {named.after_ms} ms later" if named.after_ms else ""
    name += ", dog teeth" if named.dog_splitter else ""
    return f"| {name} | {what(named)} | {state} | {found} | {outcome.by} | {outcome.result} |"


HEAD: Final = (
    "| fault, target, value | what it is | strikes at | found after ms | by | the shift |\n"
    "|---|---|---|---|---|---|\n"
)
BEGIN: Final = "<!-- begin: made by `make faults` -->\n"
END: Final = "<!-- end -->"


def write_table(path: Path) -> list[Broken]:
    """Makes the table between its two marks anew. Returns what broke, which must be nothing."""
    outcomes = [run_named(named) for named in NAMED]
    text = path.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    rows = "".join(table_row(outcome) + "\n" for outcome in outcomes)
    path.write_text(before + BEGIN + HEAD + rows + END + rest.split(END)[1], encoding="utf-8")
    return [broken for outcome in outcomes for broken in outcome.broken]


if __name__ == "__main__":
    sys.exit(bool(write_table(Path(sys.argv[1]))))
