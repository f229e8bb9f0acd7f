"""Shifts in virtual time: controller, rig and bench in one process, through encoded frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Protocol

from meshpoint.base.provenance import provenance
from meshpoint.bench.bench import BenchCore, PlannedShift, plan_shifts
from meshpoint.bench.bench_builder import virtual_bench
from meshpoint.bench.boards import around_rig
from meshpoint.bench.pauses import pauses_of
from meshpoint.bench.schedules import UPSHIFTS
from meshpoint.bench.setup import Setup
from meshpoint.bench.shared_bus import Elsewhere, SharedBus
from meshpoint.bench.virtual_time import VirtualTime
from meshpoint.bus.core import AroundCore, Core, Step
from meshpoint.bus.profile import WireProfile
from meshpoint.bus.records import Records
from meshpoint.bus.settle import settle
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.run.kept import Keep
from meshpoint.controller.run.node import CalibrationKeeper
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.messages import ETC1, ControllerEstimates, ShiftOutcome
from meshpoint.gearbox import GearboxSheet
from meshpoint.results.kinematic_bound import kinematic_bound_ms
from meshpoint.results.monitor import RowMonitor
from meshpoint.results.rows import ShiftRow, summarise
from meshpoint.rig_sim.core import RigCore

LAYSHAFT_RAD_S: Final = 1400.0 * math.pi / 30.0
"""Layshaft speed in the old gear: shifts from here shed 400 to 600 rpm, as in the thesis."""
LIMIT_US_PER_SHIFT: Final = 30_000_000
FOR_LOGS: Final = (ControllerEstimates, ETC1)
"""What these say no node acts on: the engine listens to ETC1, whatever it says."""


@dataclass
class Result:
    """What came of it."""

    rows: list[ShiftRow]
    estimation: dict[str, Any]
    """Figures by estimator; empty where none was scored."""
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


class Apart(Protocol):
    """Runs the rig in another process, on a bus that both share."""

    bus: SharedBus

    def run(
        self, time: VirtualTime, until: Callable[[], bool], limit_us: int, end: Callable[[], Step]
    ) -> None:
        """As `VirtualTime.run`; `end` makes the controller's last frames. RunError where the other
        process is lost."""


class _Watched(AroundCore[Core]):
    """Shows each step to somebody."""

    def __init__(self, core: Core, look: Callable[[Step], None]) -> None:
        super().__init__(core)
        self._look = look

    def step(self, now_us: int) -> Step:
        step = super().step(now_us)
        self._look(step)
        return step


def rig_of(setup: Setup) -> RigCore:
    """The rig, in the gear that the first shift begins with."""
    pairs = list(setup.pairs if setup.shifts else UPSHIFTS)
    return RigCore(setup.sheet, setup.rig(plan_shifts(setup.sheet, pairs, 1, LAYSHAFT_RAD_S)[0]))


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


def _unpacker(wire: WireProfile) -> Callable[[Frame], Iterable[Frame]]:
    """What makes frames that a monitor reads of those on the bus."""
    if wire is WireProfile.FD:
        return lambda frame: (frame,)
    from meshpoint.bus.classic.cores import bench_unpacker

    return bench_unpacker().take


def _written_first(
    records: Records, unwritten: list[str], is_over: Callable[[], bool]
) -> Callable[[], bool]:
    """Writes what a step has left, then says whether the run is over."""

    def look() -> bool:
        unwritten.extend(records.write())
        return is_over()

    return look


def _virtual_time(now_us: int) -> str:
    return f"{now_us / 1e6:.2f} s of virtual time"


def simulate(
    setup: Setup,
    on_frame: Callable[[int, Frame], None] | None = None,
    on_row: Callable[[ShiftRow], None] | None = None,
    on_event: Callable[[int, int, str], None] | None = None,
    monitor: RowMonitor | None = None,
    keep: Keep | None = None,
    stop: Callable[[], bool] = lambda: False,
    record: Path | None = None,
    apart: Apart | None = None,
    on_step: Callable[[ControllerCore, list[Frame]], None] | None = None,
) -> Result:
    """Runs all shifts. A function of `setup`: same setup, same frames, same rows.

    `monitor`: one of the caller's making, which may score the estimators. `keep` gets the
    calibration whenever the controller knows more, and at the end; `stop`, looked at after every
    step, ends it early. `record`: the folder of the run header, where a classic run's steps are
    written to be verified by. `apart`: runs the rig in another process, with the same frames.
    `on_step` is called after each step of the controller with what that sends."""
    monitor = monitor or RowMonitor(setup.sheet, setup.settings)
    plan = plan_shifts(setup.sheet, list(setup.pairs), setup.shifts, LAYSHAFT_RAD_S)
    operator = BenchCore(plan, pauses_of(setup.sheet, setup.profile, setup.preset))
    rig = rig_of(setup)
    core = ControllerCore(setup.header)
    is_plain = setup.wire is WireProfile.FD and setup.bus_load is None  # else content is length
    if is_plain and not any((on_frame, on_step, record, apart)):
        core.skip_unsubscribed(FOR_LOGS)
        rig.skip_unsubscribed(monitor.unread)
    controller: Core = core if keep is None else CalibrationKeeper(core, keep, _virtual_time)
    if on_step is not None:
        controller = _Watched(controller, lambda step: on_step(core, step.frames))
    unpack = _unpacker(setup.wire)
    reported = 0

    def take(time_us: int, frame: Frame) -> None:
        nonlocal reported
        is_over = False
        for heard in unpack(frame):
            is_over = type(monitor.take(heard)) is ShiftOutcome or is_over
        if on_frame is not None:
            on_frame(time_us, frame)
        if is_over and on_row is not None:
            for row in monitor.rows.rows[reported:]:
                on_row(row)
            reported = len(monitor.rows.rows)

    records, unwritten = Records(record or Path()), list[str]()
    node: Core = rig
    if setup.firmware is not None:
        node = around_rig(setup.firmware, setup.sheet, setup.wire)(rig)
    bench = virtual_bench(
        setup, controller, node if apart is None else Elsewhere(), operator,
        on_frame=take, on_event=on_event, records=None if record is None else records,
        shared=None if apart is None else apart.bus,
    )  # fmt: skip
    time = bench.time
    settle()
    is_over = _written_first(records, unwritten, lambda: operator.done or stop())
    limit_us = LIMIT_US_PER_SHIFT * len(plan)
    if apart is not None:
        apart.run(time, is_over, limit_us, lambda: bench.controller.shutdown(time.now_us))
    else:
        if plan:
            time.run(is_over, limit_us)
        bench.controller.shutdown(time.now_us)
    unwritten += records.close()
    return Result(
        rows=_with_bounds(monitor.rows.rows, plan, setup.sheet, rig.as_built or {}),
        estimation=monitor.scores(),
        provenance=provenance(setup.sheet, setup.seed, setup.preset, setup.profile),
        simulated_s=time.now_us / 1e6,
        bus_load=time.bus.busy_us / max(1, time.now_us),
        stuck=operator.gave_up,
        as_built=rig.as_built,
        cold_start=setup.calibration is None,
        strategy_errors=core.strategy_errors,
        interrupted=bool(plan) and not operator.done and stop(),
        adapter=None if bench.adapter is None else bench.adapter.figures(),
        bus=None if bench.loaded is None else bench.loaded.figures(),
        unwritten=unwritten,
    )
