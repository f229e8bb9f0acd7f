"""Shifts in virtual time: controller, rig and bench in one process, through encoded frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from meshpoint.bus.authentication.cores import ProvingCore, VerifyingCore
from meshpoint.bus.authentication.keys import CommandKeys
from meshpoint.bus.authentication.proof import CHALLENGE_BITS
from meshpoint.bus.core import Core
from meshpoint.bus.profile import WireProfile
from meshpoint.bus.records import Records
from meshpoint.bus.settle import settle
from meshpoint.bus.simulated.core import QueueOrder
from meshpoint.controller.calibration.learned import Calibration
from meshpoint.controller.calibration_keeper import CalibrationKeeper, Keep
from meshpoint.controller.core import ControllerCore
from meshpoint.controller.header import RunHeader, new_header
from meshpoint.controller.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ShiftOutcome
from meshpoint.dbc.node import Node
from meshpoint.gearbox import GearboxSheet
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.orders import ScheduledFault
from meshpoint.rig_sim.settings import DEFAULT_PROFILE, Preset, Profile, RigSettings
from meshpoint.testbench.loop.adapter import AdapterCore, AdapterProfile
from meshpoint.testbench.loop.bench import TICK_US, BenchCore, PlannedShift, plan_shifts
from meshpoint.testbench.loop.loaded_bus import LoadedBus
from meshpoint.testbench.loop.schedules import UPSHIFTS, Pairs
from meshpoint.testbench.loop.virtual_time import VirtualTime
from meshpoint.testbench.provenance import provenance
from meshpoint.testbench.results.kinematic_bound import kinematic_bound_ms
from meshpoint.testbench.results.monitor import Monitor
from meshpoint.testbench.results.rows import ShiftRow, summarise
from meshpoint.testbench.version import product_version

LAYSHAFT_RAD_S: Final = 1400.0 * math.pi / 30.0
"""Layshaft speed in the old gear: shifts from here shed 400 to 600 rpm, as in the thesis."""
LIMIT_US_PER_SHIFT: Final = 30_000_000


@dataclass(frozen=True)
class Setup:
    """One simulated run."""

    sheet: GearboxSheet
    settings: ControllerSettings
    preset: Preset = Preset.TRUCK
    seed: int = 1
    shifts: int = 20
    pairs: Pairs = UPSHIFTS
    as_built: Mapping[str, float] = field(default_factory=dict)
    faults: tuple[ScheduledFault, ...] = ()
    calibration: Calibration | None = None
    """What the controller starts with."""
    profile: Profile = DEFAULT_PROFILE
    keys: CommandKeys | None = None
    """Commands are proven with these; None: they are not."""
    bus_load: float | None = None
    """The load of the bus, other nodes' traffic included; None: a bus of our own frames, of average
    length."""
    adapter: AdapterProfile | None = None
    """What lies between the controller and the bus; None: nothing."""
    bus_queue: QueueOrder = QueueOrder.FIFO
    """In which order a node's waiting frames leave, where the bus has a load."""
    wire: WireProfile = WireProfile.FD

    @property
    def header(self) -> RunHeader:
        """The controller's run header."""
        return new_header(product_version(), self.sheet, self.settings, self.calibration)


@dataclass
class Result:
    """What came of it."""

    rows: list[ShiftRow]
    estimation: dict[str, Any]
    provenance: dict[str, Any]
    simulated_s: float
    bus_load: float
    stuck: list[int] = field(default_factory=list)
    as_built: dict[str, Any] | None = None
    """What was drawn for the rig; None for the preset thesis."""
    cold_start: bool = True
    """The controller started without a calibration."""
    strategy_errors: Mapping[str, int] = field(default_factory=dict)
    """What was wrong with a user's own strategy, and how many shifts ended of it."""

    interrupted: bool = False
    """It was ended before its last shift."""
    adapter: Mapping[str, Any] | None = None
    """What the adapter did to the controller's frames; None: there was none."""
    bus: Mapping[str, Any] | None = None
    """What the frames went through on a loaded bus."""
    unwritten: Sequence[str] = ()
    """What of the records beside the log could not be written."""

    def to_json(self, strategy: str) -> dict[str, Any]:
        """As `simulate --json` prints it."""
        errors = {"strategy_errors": dict(self.strategy_errors)} if self.strategy_errors else {}
        more = errors | ({} if self.as_built is None else {"as_built": self.as_built})
        more |= {"interrupted": True} if self.interrupted else {}
        more |= {} if self.bus is None else {"bus": dict(self.bus)}
        more |= {} if self.adapter is None else {"adapter": dict(self.adapter)}
        return {
            "shifts": [row.to_json() for row in self.rows],
            "summary": summarise(strategy, self.rows).to_json(),
            "estimation": self.estimation,
            "simulated_s": self.simulated_s,
            "bus_load": round(self.bus_load, 4),
            "cold_start": self.cold_start,
            "provenance": self.provenance,
        } | more


def not_addressed_to(*nodes: Node) -> frozenset[int]:
    """The acceptance filter of a node: identifiers of the DBC that it does not receive."""
    specs = [codec.spec for codec in CODECS.values()]
    return frozenset(spec.can_id for spec in specs if not spec.receivers & set(nodes))


def tick_phases(seed: int) -> list[int]:
    """First step times of controller, rig and bench: real nodes do not tick together."""
    rng = np.random.Generator(np.random.PCG64([seed, 0x7_1C]))
    return [int(phase) for phase in rng.integers(0, TICK_US, 3)]


def _with_bounds(
    rows: list[ShiftRow],
    plan: list[PlannedShift],
    sheet: GearboxSheet,
    as_built: Mapping[str, Mapping[str, float]],
) -> list[ShiftRow]:
    """The rows with the kinematic bound of the shift of the plan that each of them is of."""
    planned = iter(plan)
    found = []
    for row in rows:
        shift = next((p for p in planned if (p.from_, p.to) == (row.from_, row.to)), None)
        bound_ms = None
        if shift is not None:
            gears = (shift.from_, shift.to)
            bound_ms = kinematic_bound_ms(sheet, as_built, gears, shift.main_rad_s)
        found.append(replace(row, bound_ms=bound_ms))
    return found


def _challenges(seed: int) -> Callable[[], int]:
    """Challenges of a run that can be repeated; live ones are the operating system's."""
    rng = np.random.Generator(np.random.PCG64([seed, 0xC4A1]))
    return lambda: int.from_bytes(rng.bytes(CHALLENGE_BITS // 8), "little")


def _written_first(
    records: Records, unwritten: list[str], is_over: Callable[[], bool]
) -> Callable[[], bool]:
    """Writes what a step has left, then says whether the run is over."""

    def look() -> bool:
        unwritten.extend(records.write())
        return is_over()

    return look


def _as_it_is(frame: Frame) -> Iterable[Frame]:
    return (frame,)


def _virtual_time(now_us: int) -> str:
    return f"{now_us / 1e6:.2f} s of virtual time"


def simulate(
    setup: Setup,
    on_frame: Callable[[int, Frame], None] | None = None,
    on_row: Callable[[ShiftRow], None] | None = None,
    on_event: Callable[[int, int, str], None] | None = None,
    monitor: Monitor | None = None,
    keep: Keep | None = None,
    stop: Callable[[], bool] = lambda: False,
    record: Path | None = None,
) -> Result:
    """Runs all shifts. A function of `setup`: same setup, same frames, same rows.

    `monitor` is one of the caller's making that hears more; `keep` gets the calibration whenever
    the controller knows more, and at the end; `stop`, looked at after every step, ends it early.
    `record`: the folder of the run header, where a classic run's steps are written to be verified
    by."""
    monitor = monitor or Monitor(setup.sheet, setup.settings)
    plan = plan_shifts(setup.sheet, list(setup.pairs), setup.shifts, LAYSHAFT_RAD_S)
    bench = BenchCore(plan)
    rig_settings = RigSettings(
        preset=setup.preset,
        seed=setup.seed,
        start_gear=plan[0].from_ if plan else UPSHIFTS[0][0],
        main_speed_rpm=plan[0].main_rad_s * 30.0 / math.pi if plan else 600.0,
        profile=setup.profile,
        as_built=setup.as_built,
        faults=setup.faults,
    )
    rig = RigCore(setup.sheet, rig_settings)
    reported = 0

    def take(time_us: int, frame: Frame) -> None:
        nonlocal reported
        messages = [monitor.take(heard) for heard in unpack(frame)]
        if on_frame is not None:
            on_frame(time_us, frame)
        if on_row is not None and any(type(message) is ShiftOutcome for message in messages):
            for row in monitor.rows.rows[reported:]:
                on_row(row)
            reported = len(monitor.rows.rows)

    core = ControllerCore(setup.header)
    controller: Core = core if keep is None else CalibrationKeeper(core, keep, _virtual_time)
    gearbox: Core = rig
    if setup.keys is not None:
        controller = ProvingCore(controller, setup.keys)
        gearbox = VerifyingCore(rig, setup.keys, _challenges(setup.seed))
    adapter = None
    operator: Core = bench
    unpack = _as_it_is
    records = Records(record or Path())
    if setup.wire is WireProfile.CLASSIC:
        from meshpoint.bus.classic.cores import bench_unpacker, on_classic_bus

        controller, gearbox, operator = on_classic_bus(setup.sheet, controller, gearbox, bench)
        unpack = bench_unpacker().take
        if record is not None:
            from meshpoint.bus.classic.step_record import StepRecord

            run_hash = setup.header.run_hash
            controller = StepRecord(controller, records, run_hash, diagnosed=False)
    if setup.adapter is not None:
        controller = adapter = AdapterCore(controller, setup.adapter, setup.seed)
    cores: list[Core] = [controller, gearbox, operator]
    filters = [
        frozenset[int](),
        not_addressed_to(Node.GEARBOX_IO, Node.ENGINE, Node.REFERENCE),
        not_addressed_to(Node.BENCH),
    ]
    bus = None
    if setup.bus_load is not None:
        bus = LoadedBus(setup.bus_load, setup.seed, setup.bus_queue)
    driver = VirtualTime(cores, tick_phases(setup.seed), take, on_event, filters, bus)
    if adapter is not None:
        adapter.now_us = lambda: driver.now_us

    unwritten: list[str] = []

    settle()
    if plan:
        is_over = _written_first(records, unwritten, lambda: bench.done or stop())
        driver.run(is_over, LIMIT_US_PER_SHIFT * len(plan))
    controller.shutdown(driver.now_us)
    unwritten += records.close()
    return Result(
        rows=_with_bounds(monitor.rows.rows, plan, setup.sheet, rig.as_built or {}),
        estimation=monitor.estimation.figures(),
        provenance=provenance(setup.sheet, setup.seed, setup.preset),
        simulated_s=driver.now_us / 1e6,
        bus_load=driver.bus.busy_us / max(1, driver.now_us),
        stuck=bench.gave_up,
        as_built=rig.as_built,
        cold_start=setup.calibration is None,
        strategy_errors=core.strategy_errors,
        interrupted=bool(plan) and not bench.done and stop(),
        adapter=None if adapter is None else adapter.figures(),
        bus=None if bus is None else bus.figures(),
        unwritten=unwritten,
    )
