"""One world from its start to its end: anything fails, then faults end and shifts come back."""

from __future__ import annotations

import dataclasses
import traceback
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from benchmarks.swarm.deeds import DEEDS
from benchmarks.swarm.events import BUS_KINDS, REQUEST, RIG_KINDS, Event, Group, World
from benchmarks.swarm.invariants import Broken, Invariants
from benchmarks.swarm.nodes import WatchedController, WatchedRig
from benchmarks.swarm.wires import BusFault, Stranger, Trouble, Wire
from meshpoint.bench.bench import plan_shifts
from meshpoint.bench.bench_builder import Onlooker, virtual_bench
from meshpoint.bench.setup import Setup
from meshpoint.bus.core import Step
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import (
    TC1,
    BenchAction,
    BenchCommand,
    ControllerState,
    FaultCode,
    RigFault,
    ShiftOutcome,
    ShiftResult,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import GearboxSheet
from meshpoint.rig_sim.orders import FaultOrder
from meshpoint.rig_sim.settings import DEFAULT_PROFILE, Profile
from meshpoint.units import RPM

TICK_US: Final = 10_000
BACK_US: Final = 2_000_000
"""From the end of all faults until shifts must be possible again."""
SHIFT_US: Final = 6_000_000
"""A shift that was asked for then is made within this time."""
AFTERMATH_US: Final = 400_000
"""A fault that has ended still shows for so long: a sensor's held value, a position on its way."""
OUTCOME_ID: Final = CODECS[ShiftOutcome.__name__].spec.can_id
COMMAND_ID: Final = CODECS["ValveCommand"].spec.can_id
CONTROLLER: Final = 0
NOTHING: Final[frozenset[str]] = frozenset()
NEW_GEAR, OLD_GEAR = 10, 8


@dataclass
class Reached:
    """How often each thing was seen to happen."""

    faults: Counter[str] = field(default_factory=Counter)
    fault_codes: Counter[str] = field(default_factory=Counter)
    guard_rows: Counter[str] = field(default_factory=Counter)
    transitions: Counter[str] = field(default_factory=Counter)

    def add(self, other: Reached) -> None:
        """Those of another world besides."""
        for name in ("faults", "fault_codes", "guard_rows", "transitions"):
            getattr(self, name).update(getattr(other, name))


@dataclass
class EpisodeResult:
    """What came of a world."""

    seed: int
    simulated_s: float
    shifts: int
    engaged: int
    broken: list[Broken]
    reached: Reached


def settings_with(base: ControllerSettings, changes: dict[str, float]) -> ControllerSettings:
    """The settings with some values replaced, by group.name in SI. KeyError for an unknown one."""
    for name, value in changes.items():
        group, _, key = name.partition(".")
        values = getattr(base, group)
        kind = type(getattr(values, key))
        base = dataclasses.replace(
            base, **{group: dataclasses.replace(values, **{key: kind(value)})}
        )
    return base


class Episode:
    """Both nodes on one virtual bus, with trouble."""

    def __init__(
        self,
        sheet: GearboxSheet,
        settings: ControllerSettings,
        world: World,
        profile: Profile = DEFAULT_PROFILE,
        as_built: Mapping[str, float] | None = None,
    ) -> None:
        if world.dog_splitter:
            splitter = dataclasses.replace(sheet.splitter, engagement="dog")
            sheet = dataclasses.replace(sheet, splitter=splitter)
        self._sheet, self.world = sheet, world
        self._reached = Reached()
        self.broken: list[Broken] = []
        rng = np.random.Generator(np.random.PCG64([world.seed, 0x77]))
        self._trouble = Trouble(rng, lambda: self._time.now_us)
        self._setup = Setup(
            sheet,
            settings_with(settings, world.settings),
            seed=world.seed,
            profile=profile,
            as_built=as_built or {},
        )
        self._invariants = Invariants(sheet, self.broken, self._setup.settings)
        first = plan_shifts(sheet, [(world.start_gear,) * 2], 1, world.layshaft_rpm * RPM)[0]
        self._rig = WatchedRig(sheet, self._setup.rig(first))
        self._controller = self._new_controller()
        self._wires = (
            Wire(self._controller, self._trouble, self._after_controller),
            Wire(self._rig, self._trouble, self._after_rig),
        )
        self._stranger = Stranger()
        self._operator = Operator(self)
        self._time = virtual_bench(
            self._setup,
            *self._wires,
            self._operator,
            Onlooker(self._stranger, frozenset(), 1),
            on_frame=self._on_frame,
            on_event=self._on_event,
        ).time
        self._tell: Callable[[int, int, str], None] | None = None
        self._active: Counter[str] = Counter()
        self._lately: dict[str, int] = {}
        self._shifts = self._engaged = 0
        self._with_it: FaultOrder | None = None
        """What goes wrong with the gearbox when the deed begins."""
        self.back_by_us: int | None = None
        """In the last phase: when the shift asked for must be made."""
        self.is_back = False

    def _new_controller(self) -> WatchedController:
        return WatchedController(self._setup.header, self.world.seed)

    def listen(self, tell: Callable[[int, int, str], None]) -> None:
        """From now on the nodes' log lines are reported: time (us), node, line."""
        self._tell = tell

    def _on_event(self, time_us: int, node: int, line: str) -> None:
        if self._tell is not None:
            self._tell(time_us, node, line)

    def run(self) -> EpisodeResult:
        """The whole of it, or up to the first broken invariant."""
        limit_us = self.world.safety_ms * 1000 + BACK_US + SHIFT_US + 1_000_000
        try:
            self._time.run(self._is_over, limit_us)
        except Exception:  # noqa: BLE001 (a node that raises is what is looked for)
            lines = traceback.format_exc().strip().splitlines()
            self._invariants.note("crash", self._time.now_us, " | ".join(lines[-3:]))
        return EpisodeResult(
            self.world.seed,
            self._time.now_us / 1e6,
            self._shifts,
            self._engaged,
            self.broken,
            self._reached,
        )

    @property
    def active(self) -> frozenset[str]:
        """Kinds of the faults of now, and of those just over."""
        if not (self._active or self._lately):
            return NOTHING
        since_us = self._time.now_us - AFTERMATH_US
        lately = {kind for kind, until_us in self._lately.items() if until_us >= since_us}
        return frozenset(lately | {kind for kind, count in self._active.items() if count})

    def _is_over(self) -> bool:
        return bool(self.broken) or self.is_back

    def _after_rig(self, now_us: int) -> None:
        self._invariants.rig(self._rig, now_us, self.active)

    def _after_controller(self, now_us: int) -> None:
        core, reached = self._controller, self._reached
        if self._with_it is not None and core.is_mad:
            self._rig.inject(self._with_it, now_us)
            self._active[RigFault(self._with_it.kind).name.lower()] += 1
            self._with_it = None
        self._invariants.controller(core, now_us, self.active)
        self._operator.look(core.state, now_us)
        if core.transitions:
            reached.transitions.update(f"{s.name}+{t.name}".lower() for s, t in core.transitions)
            core.transitions.clear()
        if core.rows:
            reached.guard_rows.update(map(str, core.rows))
            core.rows.clear()
        if self.back_by_us is not None and now_us > self.back_by_us and not self.is_back:
            state = core.state.name.lower()
            self._invariants.note("not_back", now_us, f"no shift after the faults; {state}")

    def _on_frame(self, time_us: int, frame: Frame) -> None:
        if frame.can_id == COMMAND_ID:
            self._invariants.heard(time_us)
        elif frame.can_id == OUTCOME_ID:
            outcome: Any = CODECS[ShiftOutcome.__name__].decode(frame.data)
            self._shifts += 1
            self._engaged += outcome.result is ShiftResult.ENGAGED
            if outcome.fault is not FaultCode.NONE:
                self._reached.fault_codes[outcome.fault.name.lower()] += 1
            if self.back_by_us is not None and outcome.result is ShiftResult.ENGAGED:
                self.is_back = True

    def begin(self, event: Event, now_us: int) -> None:
        """A fault begins."""
        kind = event.kind
        self._reached.faults[kind] += 1
        self._active[kind] += 1
        if kind in RIG_KINDS:
            order = FaultOrder(
                int(RigFault[kind.upper()]), event.target, event.value, event.for_ms * 1000
            )
            self._rig.inject(order, now_us)
        elif kind in BUS_KINDS:
            self._begin_on_bus(event)
        elif kind == "controller_stalled":
            self._stall_controller(now_us, now_us + event.for_ms * 1000)
        elif kind == "controller_restarted":
            self._controller = self._wires[CONTROLLER].core = self._new_controller()
            self._invariants.controller_is_new()
        else:
            deed = DEEDS[kind]
            self._controller.go_mad(deed)
            self._with_it = deed.fault

    def _stall_controller(self, now_us: int, until_us: int) -> None:
        """It hangs. What it has not heard yet of a fault just over, it hears when it goes on."""
        self._wires[CONTROLLER].stalled_until_us = until_us
        since_us = now_us - AFTERMATH_US
        self._lately |= {kind: until_us for kind, us in self._lately.items() if us >= since_us}

    def _begin_on_bus(self, event: Event) -> None:
        if event.kind == "bus_off":
            self._wires[CONTROLLER].is_off = True
        elif event.kind == "bus_babble":
            self._stranger.babble_us = max(500, round(event.value * 1000.0))
        elif event.kind == "bus_own_identifier":
            self._stranger.pretend_us = max(500, round(event.value * 1000.0))
        else:
            fault = BusFault(event.kind, Group(event.target), event.value)
            self._trouble.faults.append(fault)

    def end(self, event: Event, now_us: int) -> None:
        """A fault is over."""
        kind = event.kind
        self._active[kind] -= 1
        self._lately[kind] = max(now_us, self._wires[CONTROLLER].stalled_until_us)
        if kind == "bus_off":
            self._wires[CONTROLLER].is_off = False
        elif kind == "bus_babble":
            self._stranger.babble_us = 0
        elif kind == "bus_own_identifier":
            self._stranger.pretend_us = 0
        elif kind in BUS_KINDS:
            faults = self._trouble.faults
            faults.remove(BusFault(kind, Group(event.target), event.value))
        elif kind in DEEDS:
            self._controller.go_mad(None)
            self._with_it = None

    def end_all(self, now_us: int) -> None:
        """Nothing is wrong any more; shifts must come back."""
        self._rig.inject(FaultOrder(int(RigFault.NO_FAULT), 0, 0.0, 0), now_us)
        self._lately |= {kind: now_us for kind, count in self._active.items() if count}
        self._active.clear()
        self.back_by_us = now_us + BACK_US + SHIFT_US

    def frames_of_return(self, sender: Transmitter, number: int) -> list[Frame]:
        """The bench brings the gearbox back into a gear, at its speed."""
        plan = plan_shifts(self._sheet, [(OLD_GEAR, NEW_GEAR)], 1, 1400.0 * RPM)[0]
        command = BenchCommand(
            action=BenchAction.RETURN_TO_GEAR,
            gear=OLD_GEAR,
            sequence=number,
            main_speed_rad_s=plan.main_rad_s,
        )
        return [sender.encode(command)]


class Operator:
    """Asks for gears, and lets the world's events happen when their time has come."""

    def __init__(self, episode: Episode) -> None:
        self._episode = episode
        world = episode.world
        self._coming = list(world.events)
        self._running: list[tuple[int, Event]] = []
        self._waiting: list[Event] = []
        """For the state that each names."""
        self._ends_us = world.safety_ms * 1000
        self._sender = Transmitter(Node.BENCH)
        self.next_step_us = 0
        self._begun_us: int | None = None
        self._ended_us: int | None = None

    def receive(self, frame: Frame) -> None:
        """It watches nothing."""

    def step(self, now_us: int) -> Step:
        """What is due now."""
        if self._begun_us is None:
            self._begun_us = now_us
        self.next_step_us = now_us + TICK_US
        if self._ended_us is not None:
            return Step(self._come_back(now_us), [])
        episode, frames = self._episode, []
        for until_us, event in [each for each in self._running if each[0] <= now_us]:
            self._running.remove((until_us, event))
            episode.end(event, now_us)
        while self._coming and self._coming[0].at_ms * 1000 <= now_us:
            event = self._coming.pop(0)
            if event.kind == REQUEST:
                frames.append(self._sender.encode(TC1(requested_gear=int(event.value))))
            elif event.state:
                self._waiting.append(event)
            else:
                self._begin(event, now_us)
        if now_us >= self._ends_us:
            self._ended_us = now_us
            for _, event in self._running:
                episode.end(event, now_us)
            episode.end_all(now_us)
        return Step(frames, [])

    def _begin(self, event: Event, now_us: int) -> None:
        self._episode.begin(event, now_us)
        self._running.append((now_us + max(event.for_ms, 1) * 1000, event))

    def look(self, state: ControllerState, now_us: int) -> None:
        """The controller has stepped, and its sequence is in this state now."""
        if not self._waiting or self._ended_us is not None:
            return
        name = state.name.lower()
        for event in [each for each in self._waiting if each.state == name]:
            self._waiting.remove(event)
            self._begin(event, now_us)

    def _come_back(self, now_us: int) -> list[Frame]:
        since_us = now_us - (self._ended_us or 0)
        if since_us < BACK_US:
            return self._episode.frames_of_return(self._sender, 1)
        return [self._sender.encode(TC1(requested_gear=NEW_GEAR))]

    def shutdown(self, now_us: int) -> Step:  # noqa: ARG002
        """Nothing to say."""
        return Step([], [])


def declared() -> dict[str, list[str]]:
    """All that a swarm has to reach."""
    from benchmarks.swarm.events import FAULT_KINDS
    from meshpoint.controller.guard.driveline import CLUTCH_ROWS, ENGINE_ROWS
    from meshpoint.controller.guard.rules import GUARD_ROWS
    from meshpoint.controller.shift.table import TRANSITIONS

    rows = sorted(row.number for row in (*GUARD_ROWS, *CLUTCH_ROWS, *ENGINE_ROWS))
    return {
        "faults": list(FAULT_KINDS),
        "fault_codes": [code.name.lower() for code in FaultCode if code is not FaultCode.NONE],
        "guard_rows": [str(row) for row in rows],
        "transitions": [f"{s.name}+{t.name}".lower() for s, t in TRANSITIONS],
    }
