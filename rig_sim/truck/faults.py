"""Faults that can be injected into the truck: by a scenario file, for a time, or by a bench frame.

`KINDS` describes the target and the value of each. A fault ends after its duration if it has one;
NO_FAULT ends all.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Final, Generic, NamedTuple, Protocol, TypeVar

from meshpoint.dbc.messages import RigFault
from meshpoint.gearbox.gears import SLEEVE_OF_MAIN, Sleeve
from meshpoint.gearbox.wheels import WHEEL_NAMES
from meshpoint.rig_sim.orders import FaultOrder
from meshpoint.rig_sim.parts.cylinder import Cylinder
from meshpoint.rig_sim.shared.capture_records import CHANNELS, WHEELS
from meshpoint.rig_sim.shared.edge_ring import EdgeRead
from meshpoint.rig_sim.shared.engagement import GEAR_OF_VALVE
from meshpoint.rig_sim.shared.node_state import NodeState
from meshpoint.rig_sim.shared.script import BenchScript
from meshpoint.rig_sim.shared.sensor_clock import SensorClock
from meshpoint.rig_sim.shared.valve_drivers import Valve
from meshpoint.rig_sim.shared.world import SensorRead
from meshpoint.rig_sim.truck.clutch import TruckClutch, TruckEngine
from meshpoint.rig_sim.truck.engagement import TruckEngagement
from meshpoint.rig_sim.truck.plant import TruckPlant
from meshpoint.rig_sim.truck.position_sensors import PositionSensors
from meshpoint.units import BAR, MM, MS, SECOND_US

T = TypeVar("T")
CHANNEL_TARGETS: Final = (
    f"channel 0..{CHANNELS - 1}: {', '.join(WHEEL_NAMES)}, each rise then fall", CHANNELS,
)  # fmt: skip
WHEEL_TARGETS: Final = (
    "wheel " + ", ".join(f"{k} {name}" for k, name in enumerate(WHEEL_NAMES)), WHEELS,
)  # fmt: skip
VALVE_TARGETS: Final = "valve 0..8 in the order of ValveCommand"
SLEEVE_TARGETS: Final = "sleeve 0 first/second, 1 crawl/third, 2 splitter, 3 range"
MAIN_VALVE_TARGETS: Final = "valve 3..6 in the order of ValveCommand: first, second, crawl, third"
MAIN_SLEEVE_TARGETS: Final = "sleeve 0 first/second, 1 crawl/third"
MOST_SHARE: Final = 10.0
MOST_PPM: Final = 1e4
MOST_RATE: Final = 4.0
FAULT_FOREVER_US: Final = 1 << 53


class Kind(NamedTuple):
    """The description of a fault for users. targets: number of possible targets, 0 if it has
    none."""

    text: str
    target: str
    targets: int
    value: str
    first: int = 0
    """The lowest target."""

    def allows(self, target: int) -> bool:
        """Whether there is such a target."""
        return not self.targets or self.first <= target < self.first + self.targets


KINDS: Final[dict[RigFault, Kind]] = {
    RigFault.NO_FAULT: Kind("ends all faults", "-", 0, "-"),
    RigFault.HALL_DROPOUT: Kind("a Hall channel is silent", *CHANNEL_TARGETS, "-"),
    RigFault.HALL_MISSING_TOOTH: Kind("a tooth gives no edge", *CHANNEL_TARGETS, "tooth, from 0"),
    RigFault.HALL_DOUBLE_EDGE: Kind("each edge comes twice, 60 us apart", *CHANNEL_TARGETS, "-"),
    RigFault.HALL_NOISE_BURST: Kind(
        "each edge comes with a burst", *CHANNEL_TARGETS, "edges more, 1..8"
    ),
    RigFault.VALVE_STUCK: Kind("a valve stays as it is", VALVE_TARGETS, 9, "-"),
    RigFault.VALVE_SLOW: Kind("a valve follows its coil late", VALVE_TARGETS, 9, "ms"),
    RigFault.SUPPLY_DROP: Kind("the tank leaks down to a pressure", "-", 0, "bar, absolute"),
    RigFault.SLEEVE_JAMMED: Kind("activations do not move a sleeve", SLEEVE_TARGETS, 4, "-"),
    RigFault.POSITION_OFFSET: Kind("a position sensor lies by", SLEEVE_TARGETS, 4, "mm"),
    RigFault.POSITION_FROZEN: Kind("a position sensor repeats itself", SLEEVE_TARGETS, 4, "-"),
    RigFault.FROZEN_PAYLOAD: Kind("old content under a live counter", "0 edges, 1 slow", 2, "-"),
    RigFault.BRAKE_FADE: Kind("the brake has this share of its torque", "-", 0, "%"),
    RigFault.CLUTCH_STUCK: Kind("the clutch stays on its way", "-", 0, "-"),
    RigFault.ENGINE_DEAF: Kind("the engine does not follow TSC1", "-", 0, "-"),
    RigFault.CLOCK_DRIFT: Kind("the sensor clock runs fast", "-", 0, "ppm"),
    RigFault.CLOCK_STEP: Kind("the sensor clock jumps ahead, at the end back", "-", 0, "us"),
    RigFault.NODE_RESTART: Kind(
        "the gearbox I/O is off the bus, valves off; then counters and clock from zero", "-", 0, "-"
    ),
    RigFault.NODE_STALLED: Kind(
        "the rig's event loop hangs; what was due comes in one go afterwards", "-", 0, "-"
    ),
    RigFault.WHEEL_FACTOR: Kind(
        "a speed wheel gives this many times its edges", *WHEEL_TARGETS, "factor, 0..4"
    ),
    RigFault.VALVE_SLOW_ON: Kind("a valve is slow to open", VALVE_TARGETS, 9, "ms"),
    RigFault.VALVE_SLOW_OFF: Kind("a valve is slow to close", VALVE_TARGETS, 9, "ms"),
    RigFault.VALVE_LEAKS: Kind(
        "a closed main valve lets air in", MAIN_VALVE_TARGETS, 4, "% of its own conductance", 3
    ),
    RigFault.SLEEVE_STIFF: Kind(
        "a main sleeve has more friction", MAIN_SLEEVE_TARGETS, 2, "% of its own, added"
    ),
    RigFault.SLEEVE_HEAVY: Kind(
        "a main sleeve has more mass", MAIN_SLEEVE_TARGETS, 2, "% of its own, added"
    ),
}


class Freezer(Generic[T]):
    """Passes readings on; while frozen, repeats the last one before."""

    def __init__(self) -> None:
        self.frozen = False
        self._last: T | None = None

    def pass_on(self, value: T) -> T:
        """The value to be sent."""
        if self.frozen and self._last is not None:
            return self._last
        self._last = value
        return value


class Faultable(Protocol):
    """The parts of a truck that faults may change; `world.TruckWorld` implements it."""

    plant: TruckPlant
    engagement: TruckEngagement[Any]
    script: BenchScript
    positions: PositionSensors
    clutch: TruckClutch
    engine: TruckEngine
    clock: SensorClock
    node: NodeState

    def all_valves_off(self, now_us: float) -> None:
        """No valve is driven from now on."""

    def later(self, delay_us: float, action: Callable[[], None]) -> None:
        """Does something this much after the plant's present instant."""

    def switch(self, valve: Valve, on: bool) -> None:
        """A valve's coil is switched at the plant's present instant."""


class FaultInjector:
    """Starts and ends the faults of one world, at the plant's present time."""

    def __init__(self, world: Faultable) -> None:
        self._world = world
        self.edges: Freezer[list[EdgeRead]] = Freezer()
        self.slow: Freezer[SensorRead] = Freezer()
        self._stuck: set[Valve] = set()
        self._missed: dict[Valve, bool] = {}
        """Stuck valves whose coil is not as they are."""
        self._slow_us: dict[tuple[Valve, bool, RigFault], float] = {}
        """By valve, by whether it opens or closes, and by fault."""
        self._ends: dict[tuple[RigFault, int], Callable[[], None]] = {}
        self._begun = 0
        self._current: dict[tuple[RigFault, int], int] = {}

    @property
    def active(self) -> list[tuple[RigFault, int]]:
        """Kind and target of each active fault."""
        return list(self._ends)

    def valve_delay_us(self, valve: Valve, on: bool) -> float | None:
        """What faults add (us) between a valve's coil and the valve, as it is switched on or off;
        None if it is stuck."""
        if valve in self._stuck:
            return None
        return sum(us for key, us in self._slow_us.items() if key[:2] == (valve, on))

    def miss(self, valve: Valve, on: bool) -> None:
        """The coil of a stuck valve has changed."""
        if self._missed.pop(valve, None) is None:
            self._missed[valve] = on

    def begin(self, order: FaultOrder) -> None:
        """Starts a fault now. An unknown one is reported in the log and changes nothing."""
        kinds = {int(kind): kind for kind in RigFault}
        kind = kinds.get(order.kind)
        lines, time_us = self._world.engagement.lines, self._world.plant.time_us
        if kind is None or not KINDS[kind].allows(order.target):
            lines.append((time_us, f"fault {order.kind} at {order.target} refused: unknown"))
            return
        if kind is RigFault.NO_FAULT:
            for key in list(self._ends):
                self.end(*key)
            return
        self.end(kind, order.target)
        lines.append((time_us, f"fault {kind.name} at {order.target} begins"))
        key = (kind, order.target)
        self._ends[key] = _STARTERS[kind](self._world, self, order)
        self._begun += 1
        self._current[key] = number = self._begun
        if order.duration_us:
            self._world.later(order.duration_us, partial(self._expire, key, number))

    def end(self, kind: RigFault, target: int) -> None:
        """Ends a fault now, if it is active."""
        undo = self._ends.pop((kind, target), None)
        if undo is not None:
            undo()
            text = f"fault {kind.name} at {target} ends"
            self._world.engagement.lines.append((self._world.plant.time_us, text))

    def _expire(self, key: tuple[RigFault, int], number: int) -> None:
        if self._current.get(key) == number:
            self.end(*key)

    def stick(self, valve: Valve) -> Callable[[], None]:
        """The valve stops following its coil. When the fault ends its spring, or the coil, moves it
        to where it should be."""
        self._stuck.add(valve)
        return partial(self._loosen, valve)

    def _loosen(self, valve: Valve) -> None:
        self._stuck.discard(valve)
        on = self._missed.pop(valve, None)
        if on is not None:
            self._world.switch(valve, on)

    def slow_down(self, order: FaultOrder, on: bool, off: bool) -> Callable[[], None]:
        """The valve follows late: to open, to close, or both."""
        kind, valve = RigFault(order.kind), Valve(order.target)
        late_us = max(order.value, 0.0) * MS * SECOND_US
        keys = [(valve, to, kind) for to, is_late in ((True, on), (False, off)) if is_late]
        self._slow_us.update(dict.fromkeys(keys, late_us))
        return partial(self._hurry, keys)

    def _hurry(self, keys: list[tuple[Valve, bool, RigFault]]) -> None:
        for key in keys:
            del self._slow_us[key]


Starter = Callable[[Faultable, FaultInjector, FaultOrder], Callable[[], None]]
"""Starts a fault and returns the function that ends it: a `partial`, so that in a copy of the world
it acts on the copy."""


def _channel(field: str, value: Callable[[FaultOrder], int]) -> Starter:
    def start(world: Faultable, _: FaultInjector, order: FaultOrder) -> Callable[[], None]:
        hall = world.plant.rig.hall[order.target]
        setattr(hall, field, value(order))
        return partial(setattr, hall, field, 0)

    return start


def _freeze(_: Faultable, injector: FaultInjector, order: FaultOrder) -> Callable[[], None]:
    freezer: Freezer[list[EdgeRead]] | Freezer[SensorRead]
    freezer = injector.edges if order.target == 0 else injector.slow
    freezer.frozen = True
    return partial(setattr, freezer, "frozen", False)


def _leak(world: Faultable, _: FaultInjector, order: FaultOrder) -> Callable[[], None]:
    g, y, p = world.plant.g, world.plant.y, world.plant.p
    before = g.governed_pa
    g.governed_pa = max(order.value * BAR, p.air.atmosphere_pa)
    y.supply_pa = g.governed_pa
    return partial(setattr, g, "governed_pa", before)


def _fade(world: Faultable, _: FaultInjector, order: FaultOrder) -> Callable[[], None]:
    brake = world.plant.p.brake
    before = brake.gain_nm_pa
    brake.gain_nm_pa = before * max(order.value, 0.0) / 100.0
    return partial(setattr, brake, "gain_nm_pa", before)


def _jam(world: Faultable, _: FaultInjector, order: FaultOrder) -> Callable[[], None]:
    name = Sleeve(order.target)
    sleeve = world.script.step_sleeve(name)
    if sleeve is None:
        world.engagement.jam(name, True)
        return partial(world.engagement.jam, name, False)
    sleeve.jammed = True
    return partial(setattr, sleeve, "jammed", False)


def _share(order: FaultOrder) -> float:
    return min(max(order.value / 100.0, 0.0), MOST_SHARE)


def _leak_in(world: Faultable, _: FaultInjector, order: FaultOrder) -> Callable[[], None]:
    where = SLEEVE_OF_MAIN[GEAR_OF_VALVE[Valve(order.target)]]
    chamber = "a" if where.direction > 0 else "b"
    alter = world.engagement.alter
    alter(where.sleeve, partial(_let_in, chamber, min(_share(order), 1.0)))
    return partial(alter, where.sleeve, partial(_let_in, chamber, 0.0))


def _let_in(chamber: str, share: float, cylinder: Cylinder) -> None:
    fill = getattr(cylinder, f"{chamber}_fill_m3_spa")
    setattr(cylinder, f"{chamber}_leak_m3_spa", share * fill)


def _stiffen(world: Faultable, _: FaultInjector, order: FaultOrder) -> Callable[[], None]:
    name, alter = Sleeve(order.target), world.engagement.alter
    alter(name, partial(_rub_more, _share(order)))
    return partial(alter, name, partial(_rub_more, 0.0))


def _rub_more(share: float, cylinder: Cylinder) -> None:
    cylinder.added_friction = share


def _burden(world: Faultable, _: FaultInjector, order: FaultOrder) -> Callable[[], None]:
    name, factor, alter = Sleeve(order.target), 1.0 + _share(order), world.engagement.alter
    alter(name, partial(_weigh, factor))
    return partial(alter, name, partial(_weigh, 1.0 / factor))


def _weigh(factor: float, cylinder: Cylinder) -> None:
    cylinder.mass_kg *= factor


def _lie(world: Faultable, _: FaultInjector, order: FaultOrder) -> Callable[[], None]:
    name = Sleeve(order.target)
    world.positions.lie(name, order.value * MM)
    return partial(world.positions.lie, name, 0.0)


def _repeat(world: Faultable, _: FaultInjector, order: FaultOrder) -> Callable[[], None]:
    name = Sleeve(order.target)
    world.positions.freeze(name, frozen=True)
    return partial(world.positions.freeze, name, frozen=False)


def _stick_clutch(world: Faultable, *_: object) -> Callable[[], None]:
    world.clutch.stuck = True
    return partial(setattr, world.clutch, "stuck", False)


def _deafen(world: Faultable, *_: object) -> Callable[[], None]:
    world.engine.deaf = True
    return partial(setattr, world.engine, "deaf", False)


def _drift(world: Faultable, _: FaultInjector, order: FaultOrder) -> Callable[[], None]:
    _run_fast(world, min(max(order.value, -MOST_PPM), MOST_PPM))
    return partial(_run_fast, world, 0.0)


def _run_fast(world: Faultable, ppm: float) -> None:
    world.clock.drift(world.plant.time_us, ppm)


def _jump(world: Faultable, _: FaultInjector, order: FaultOrder) -> Callable[[], None]:
    ahead_us = round(order.value)
    _step_ahead(world, ahead_us)
    return partial(_step_ahead, world, -ahead_us)


def _step_ahead(world: Faultable, ahead_us: int) -> None:
    world.clock.step(world.plant.time_us, ahead_us)


def _restart(world: Faultable, *_: object) -> Callable[[], None]:
    world.node.away = True
    world.all_valves_off(world.plant.time_us)
    return partial(_come_back, world)


def _come_back(world: Faultable) -> None:
    node, time_us = world.node, world.plant.time_us
    node.away = False
    node.restarts += 1
    world.clock.restart(time_us)
    world.plant.edges.power_up(time_us)


def _stall(world: Faultable, _: FaultInjector, order: FaultOrder) -> Callable[[], None]:
    now_us = round(world.plant.time_us)
    world.node.stalled_until_us = now_us + (order.duration_us or FAULT_FOREVER_US)
    return partial(setattr, world.node, "stalled_until_us", 0)


def _turn_otherwise(world: Faultable, _: FaultInjector, order: FaultOrder) -> Callable[[], None]:
    """Both flanks of a tooth are captured (2), every other tooth (0.5), the ring slips on its shaft
    (below 1), or it has another number of teeth than the sheet says."""
    rates = world.plant.rig.wheel_rate
    rates[order.target] = min(max(order.value, 0.0), MOST_RATE)
    return partial(_turn_as_its_shaft, world, order.target)


def _turn_as_its_shaft(world: Faultable, wheel: int) -> None:
    world.plant.rig.wheel_rate[wheel] = 1.0


_STARTERS: Final[dict[RigFault, Starter]] = {
    RigFault.HALL_DROPOUT: _channel("silent", lambda _: 1),
    RigFault.HALL_MISSING_TOOTH: _channel("missing", lambda order: int(order.value) + 1),
    RigFault.HALL_DOUBLE_EDGE: _channel("extra", lambda _: 1),
    RigFault.HALL_NOISE_BURST: _channel("extra", lambda order: min(max(int(order.value), 1), 8)),
    RigFault.VALVE_STUCK: lambda _, injector, order: injector.stick(Valve(order.target)),
    RigFault.VALVE_SLOW: lambda _, injector, order: injector.slow_down(order, on=True, off=True),
    RigFault.SUPPLY_DROP: _leak,
    RigFault.SLEEVE_JAMMED: _jam,
    RigFault.POSITION_OFFSET: _lie,
    RigFault.POSITION_FROZEN: _repeat,
    RigFault.FROZEN_PAYLOAD: _freeze,
    RigFault.BRAKE_FADE: _fade,
    RigFault.CLUTCH_STUCK: _stick_clutch,
    RigFault.ENGINE_DEAF: _deafen,
    RigFault.CLOCK_DRIFT: _drift,
    RigFault.CLOCK_STEP: _jump,
    RigFault.NODE_RESTART: _restart,
    RigFault.NODE_STALLED: _stall,
    RigFault.WHEEL_FACTOR: _turn_otherwise,
    RigFault.VALVE_SLOW_ON: lambda _, injector, order: injector.slow_down(
        order, on=True, off=False
    ),
    RigFault.VALVE_SLOW_OFF: lambda _, injector, order: injector.slow_down(
        order, on=False, off=True
    ),
    RigFault.VALVE_LEAKS: _leak_in,
    RigFault.SLEEVE_STIFF: _stiffen,
    RigFault.SLEEVE_HEAVY: _burden,
}
