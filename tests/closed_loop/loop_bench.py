"""Controller, rig and an operator on a virtual bus, with a hand on every wire."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from meshpoint.base.version import product_version
from meshpoint.bench.bench import BenchCore, plan_shifts
from meshpoint.bench.pauses import pauses_of
from meshpoint.bench.virtual_time import VirtualTime
from meshpoint.bus.core import Core, Step
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.header import RunHeader, XcpAccess, new_header
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Receiver, Transmitter
from meshpoint.dbc.messages import (
    TC1,
    ControllerState,
    ControllerStatus,
    RigFault,
    ShiftOutcome,
    ValveAction,
    ValveCommand,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import GearboxSheet, load_sheet
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.orders import FaultOrder, ScheduledFault
from meshpoint.rig_sim.settings import Preset, Profile, RigSettings
from meshpoint.xcp.node import XcpCore

SHEET = load_sheet("thesis")
LAYSHAFT_RAD_S = 1400.0 * math.pi / 30.0
PHASES_US = [726, 189, 5_513]
"""First steps of controller, rig and operator: real nodes do not tick together."""
GUEST_PHASE_US = 2_131
Alter = Callable[[Frame], list[Frame]]


def unchanged(frame: Frame) -> list[Frame]:
    return [frame]


class Tapped:
    """A node whose receiving and sending can be changed, and which can be swapped for another."""

    def __init__(self, core: Core, receiving: Alter = unchanged) -> None:
        self.core = core
        self.receiving = receiving
        self.silent = False

    @property
    def next_step_us(self) -> int:
        return self.core.next_step_us

    def receive(self, frame: Frame) -> None:
        for altered in self.receiving(frame):
            self.core.receive(altered)

    def step(self, now_us: int) -> Step:
        frames, events = self.core.step(now_us)
        return Step([] if self.silent else frames, events)

    def shutdown(self, now_us: int) -> Step:
        return self.core.shutdown(now_us)


class Operator:
    """Asks for gears: each once, at a time of the driver's clock."""

    def __init__(self, requests: list[tuple[int, int]]) -> None:
        self._requests = list(requests)
        self._transmitter = Transmitter(Node.BENCH)
        self.next_step_us = 0
        self.done = False

    def ask(self, gear: int, at_us: int) -> None:
        """For one gear more."""
        self._requests.append((at_us, gear))

    def receive(self, frame: Frame) -> None:
        pass

    def step(self, now_us: int) -> Step:
        self.next_step_us = now_us + 10_000
        frames = []
        while self._requests and self._requests[0][0] <= now_us:
            _, gear = self._requests.pop(0)
            frames.append(self._transmitter.encode(TC1(requested_gear=gear)))
        return Step(frames, [])

    def shutdown(self, now_us: int) -> Step:
        return Step([], [])


@dataclass
class Loop:
    """One run. `requests` by an operator, or `shifts` by the bench with a return in between."""

    requests: list[tuple[int, int]] = field(default_factory=list)
    shifts: int = 0
    settings: ControllerSettings = field(default_factory=ControllerSettings)
    seed: int = 1
    receiving: Alter = unchanged
    """What becomes of frames on their way into the controller."""
    sheet: GearboxSheet = SHEET
    start_gear: int = 8
    pairs: Sequence[tuple[int, int]] = ((8, 10), (10, 12))
    preset: Preset = Preset.THESIS
    as_built: Mapping[str, float] = field(default_factory=dict)
    profile: Profile = Profile.CLEAN
    faults: tuple[ScheduledFault, ...] = ()
    toward: int = 0
    """The gear that will be asked for: the main shaft turns so that both gears are possible."""

    layshaft_rad_s: float = LAYSHAFT_RAD_S
    phases_us: Sequence[int] = tuple(PHASES_US)

    armed: bool = True
    xcp: XcpAccess = XcpAccess.OFF
    guests: Sequence[Core] = ()
    """Other nodes on the bus."""

    def __post_init__(self) -> None:
        plan = plan_shifts(self.sheet, list(self.pairs), self.shifts, self.layshaft_rad_s)
        pauses = pauses_of(self.sheet, self.profile, self.preset)
        self.operator = BenchCore(plan, pauses) if plan else self.new_operator()
        self._core = ControllerCore(self.header)
        node: Core = self._core
        if self.xcp is not XcpAccess.OFF:
            node = XcpCore(node, self._core)
        self.controller = Tapped(node, self.receiving)
        self.rig = Tapped(self.new_rig(self.seed))
        self.frames: list[tuple[int, Frame]] = []
        self.messages: list[tuple[int, Any]] = []
        self.events: list[str] = []
        self._decoder = Receiver(*Node)
        self.nodes: list[Core] = [self.controller, self.rig, self.operator, *self.guests]
        phases_us = [*self.phases_us, *(GUEST_PHASE_US for _ in self.guests)]
        self.time = VirtualTime(self.nodes, phases_us, self.take, self._event)

    @property
    def core(self) -> ControllerCore:
        """The controller itself, without the XCP slave around it."""
        core = self.controller.core
        return core if isinstance(core, ControllerCore) else self._core

    @property
    def rig_core(self) -> RigCore:
        """The rig itself."""
        core = self.rig.core
        assert isinstance(core, RigCore)
        return core

    @property
    def world(self) -> Any:
        """The gearbox itself, with what the bus does not carry."""
        return self.rig_core._world

    def watch_guard(self) -> list[tuple[int, Any]]:
        """What the guard sees in each step from now on, and when."""
        view, seen = self.core._guarded._view, list[tuple[int, Any]]()
        take = view.take

        def noted(*given: Any) -> Any:
            seen.append((self.time.now_us, take(*given)))
            return seen[-1][1]

        view.take = noted  # type: ignore[method-assign]
        return seen

    def new_operator(self) -> Operator:
        """Who asks for the gears."""
        return Operator(self.requests)

    def fault(self, kind: RigFault, target: int = 0, value: float = 0.0, for_us: int = 0) -> None:
        """The rig goes wrong from now on, or for so long."""
        order = FaultOrder(int(kind), target, value, for_us)
        self.world.inject(order, self.time.now_us - self.phases_us[1])

    def lose_valves(self) -> None:
        """The valve side forgets all commands at once."""
        self.world.all_valves_off(self.time.now_us - self.phases_us[1])

    @property
    def header(self) -> RunHeader:
        return new_header(
            product_version(), self.sheet, self.settings, armed=self.armed, xcp=self.xcp
        )

    def new_rig(self, seed: int, clock_start_us: int | None = None) -> RigCore:
        """A rig as at power-up."""
        pair = (self.start_gear, self.toward or self.start_gear)
        start = plan_shifts(self.sheet, [pair], 1, self.layshaft_rad_s)
        rpm = start[0].main_rpm
        return RigCore(
            self.sheet,
            RigSettings(
                seed=seed,
                start_gear=self.start_gear,
                main_speed_rpm=rpm,
                clock_start_us=clock_start_us,
                preset=self.preset,
                profile=self.profile,
                as_built=self.as_built,
                faults=self.faults,
            ),
        )

    def take(self, time_us: int, frame: Frame) -> None:
        """A frame that was on the bus."""
        self.frames.append((time_us, frame))
        message = self._decoder.receive(frame).message
        if message is not None:
            self.messages.append((time_us, message))

    def _event(self, time_us: int, node: int, line: str) -> None:
        self.events.append(f"{time_us} {('controller', 'rig', 'operator', 'guest')[node]}: {line}")

    def until(self, met: Callable[[], bool], limit_us: int) -> bool:
        return self.time.run(met, limit_us)

    def run(self, limit_us: int) -> Loop:
        """Runs for that long, or to the end of the bench's plan."""
        self.until(lambda: bool(self.operator.done), limit_us)
        return self

    def run_to_state(self, state: ControllerState, limit_us: int) -> None:
        """Runs until the controller reports the state."""
        reached = self.until(lambda: self.seen(ControllerStatus, state=state), limit_us)
        assert reached, f"{state.name} not reached:\n" + "\n".join(self.events)

    def seen(self, kind: type[Any], **values: Any) -> bool:
        """Whether the newest message of a kind has these values."""
        newest = self.last(kind)
        return newest is not None and all(getattr(newest, k) == v for k, v in values.items())

    def of(self, kind: type[Any]) -> list[Any]:
        """All messages of a kind that were on the bus."""
        return [message for _, message in self.messages if type(message) is kind]

    def switched(self, field_: str, action: ValveAction) -> list[int]:
        """Sensor times, 32 bits, at which the valve side was first told of an action."""
        start_us = self.rig_core.truth.clock_start_us - self.phases_us[1]
        times, before = [], None
        for time_us, message in self.messages:
            if type(message) is ValveCommand:
                now = getattr(message, field_)
                if now is action and before not in (None, action):
                    times.append((start_us + time_us) % (1 << 32))
                before = now
        return times

    def last(self, kind: type[Any]) -> Any:
        return next((m for _, m in reversed(self.messages) if type(m) is kind), None)

    @property
    def status(self) -> ControllerStatus:
        status: ControllerStatus = self.last(ControllerStatus)
        return status

    @property
    def outcomes(self) -> list[ShiftOutcome]:
        return self.of(ShiftOutcome)

    @property
    def states(self) -> list[ControllerState]:
        """The controller's states in the order it went through them."""
        states = [status.state for status in self.of(ControllerStatus)]
        return [s for i, s in enumerate(states) if i == 0 or s is not states[i - 1]]

    @property
    def violations(self) -> int:
        """What the rig says a controller must never bring about."""
        return sum(self.rig_core.truth.violations.values())

    @property
    def valves_driven(self) -> tuple[str, ...]:
        """The valves the rig last reported as driven."""
        status = self.last(ValveStatus)
        return tuple(k for k, v in status._asdict().items() if k.endswith("_energised") and v)

    def sent_as(self, name: str) -> list[Frame]:
        """The frames of a message that were on the bus."""
        can_id = CODECS[name].spec.can_id
        return [frame for _, frame in self.frames if frame.can_id == can_id]
