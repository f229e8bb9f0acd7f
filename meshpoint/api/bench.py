"""`Bench`: controller, rig and operator in this process, in virtual time, step by step."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Self

from meshpoint.api.choices import AsBuilt, PathLike, Strategy, load_settings, setup_of
from meshpoint.api.watching import DEFAULT_TIMEOUT_S, ShiftError, Watching
from meshpoint.bench.bench import plan_shifts
from meshpoint.bench.bench_builder import virtual_bench
from meshpoint.bench.compiling import prepare_once
from meshpoint.bench.setup import Setup
from meshpoint.bench.simulate import LAYSHAFT_RAD_S, LIMIT_US_PER_SHIFT
from meshpoint.bus.core import Core, Step
from meshpoint.bus.logs.files import RotatingLog, open_log
from meshpoint.bus.logs.recorder import LogWriter
from meshpoint.bus.settle import settle
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.header import RunHeader
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox import GearboxSheet
from meshpoint.results.output import folder_for
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.orders import ScheduledFault
from meshpoint.rig_sim.settings import DEFAULT_PRESET, DEFAULT_PROFILE, Preset, RigSettings

NODES = ("controller", "rig", "bench")
LOG_CHANNEL = "virtual"


class Event(NamedTuple):
    """A line of a node's own log."""

    time_s: float
    node: str
    text: str


class Bench(Watching):
    """Controller and rig on one virtual CAN bus; time goes on only while a method runs.

    The same arguments and the same calls give the same bytes on the bus.

    gearbox: the data sheet of both: `thesis`, `truck12`, a TOML file, or a sheet; None: that of the
        preset, `truck12` or `thesis`.
    preset: the rig's physics: `truck`, or `thesis`, the thesis's equations alone.
    seed: draws start angles and delays, in the preset `truck` also every part.
    as_built: ranges the truck's parts are drawn from (`clean`, `typical`, `harsh`), a file, or
        values that are fixed, by name (docs/gearbox.md); both may name the profile of the rest,
        `typical` without it.
    faults: a scenario of faults: a TOML file (docs/faults.md).
    strategy, estimator, settings: of the controller, as in `load_settings`.
    gear: the gear the rig stands in at the start.
    controller, rig: a core of your own instead of ours (`Core`). A controller must send
        ControllerStatus and ShiftOutcome, a rig ReferenceEngagement, or a shift has no record.
    log: records the bus, its format known by the ending (.log, .blf, .asc), with the run header
        beside it where the controller is ours.
    """

    def __init__(
        self,
        *,
        gearbox: PathLike | GearboxSheet | None = None,
        preset: str = DEFAULT_PRESET,
        seed: int = 1,
        as_built: AsBuilt = DEFAULT_PROFILE,
        faults: PathLike | tuple[ScheduledFault, ...] = (),
        strategy: Strategy | None = None,
        estimator: str | None = None,
        settings: PathLike | ControllerSettings | None = None,
        gear: int = 8,
        controller: Core | None = None,
        rig: Core | None = None,
        log: PathLike | None = None,
    ) -> None:
        chosen = load_settings(settings, strategy=strategy, estimator=estimator)
        setup = setup_of(gearbox, preset, seed, as_built, faults, chosen)
        prepare_once(thesis=setup.preset is Preset.THESIS)
        super().__init__(setup, gear)
        header = setup.header
        self.as_built: dict[str, Any] | None = None
        """What was drawn for the rig, by group and name; None in the preset thesis."""
        if rig is None:
            ours = RigCore(setup.sheet, rig_settings(setup, gear))
            rig, self.as_built = ours, ours.as_built
        self.controller = _Stepped(ControllerCore(header) if controller is None else controller)
        self._log = None
        if log is not None:
            self._log = open_recording(log, header if controller is None else None)
        self.events: list[Event] = []
        """What the nodes have said, in order."""
        self._time = virtual_bench(
            setup,
            self.controller,
            rig,
            self._operator,
            on_frame=self._take,
            on_event=self._hear,
        ).time
        self._is_closed = False
        settle()

    @property
    def now_s(self) -> float:
        """Virtual time since the start, s."""
        return self._time.now_us / 1e6

    def step(self) -> Step:
        """Goes on to the controller's next step, and makes it: 10 ms further, now and then less,
        where the controller wakes for the clock of its sensors. On the way frames are delivered and
        the rig is stepped as it comes. Returns what the controller sent and said; its frames reach
        the bus when time goes on."""
        before = self.controller.steps
        limit_us = self._time.now_us + round(DEFAULT_TIMEOUT_S * 1e6)
        if not self._go(lambda: self.controller.steps > before, limit_us):
            raise TimeoutError(f"the controller asks for no step within {DEFAULT_TIMEOUT_S:g} s")
        return self.controller.last

    def run_for(self, seconds: float) -> None:
        """Goes on by so much virtual time."""
        self._go(lambda: False, self._time.now_us + round(seconds * 1e6))

    def run_until(
        self, condition: Callable[[Self], object], timeout_s: float = DEFAULT_TIMEOUT_S
    ) -> float:
        """Goes on until `condition(bench)` is true, which is asked after every step of a node.

        Returns the time, s. TimeoutError after `timeout_s` of virtual time."""
        if not condition(self):
            limit_us = self._time.now_us + round(timeout_s * 1e6)
            if not self._go(lambda: bool(condition(self)), limit_us):
                raise TimeoutError(f"not so within {timeout_s:g} s of virtual time")
        return self.now_s

    def close(self) -> None:
        """Ends the controller, all valves off, and completes the log."""
        if self._is_closed:
            return
        self._is_closed = True
        self.controller.shutdown(self._time.now_us)
        if self._log is not None:
            self._log.close()

    def _complete_log(self) -> Path:
        if self._log is None:
            raise RuntimeError("this bench records nothing: log= names a file")
        if not self._is_closed:
            self._log.flush()
        return self._log.path

    def _go(self, until: Callable[[], bool], limit_us: int) -> bool:
        if self._is_closed:
            raise RuntimeError("this bench is closed")
        met = self._time.run(until, limit_us)
        if not met:
            self._time.now_us = max(self._time.now_us, limit_us)
        return met

    def _order(self, order: Callable[[], None]) -> None:
        order()

    def _until_done(self) -> None:
        limit_us = self._time.now_us + 2 * LIMIT_US_PER_SHIFT
        if not self._go(lambda: self.shift_is_over, limit_us):
            raise ShiftError(self._why_no_row(len(self._planned) - 1))

    def _take(self, time_us: int, frame: Frame) -> None:
        self._see(frame)
        if self._log is not None:
            self._log.write(time_us / 1e6, frame)

    def _hear(self, time_us: int, node: int, line: str) -> None:
        self.events.append(Event(time_us / 1e6, NODES[node], line))


class _Stepped:
    """A controller's core, and what its newest step came to."""

    def __init__(self, core: Core) -> None:
        self.core = core
        """The core itself."""
        self.receive = core.receive
        self.shutdown = core.shutdown
        self.steps = 0
        self.last = Step([], [])

    @property
    def next_step_us(self) -> int:
        """As the core's."""
        return self.core.next_step_us

    def step(self, now_us: int) -> Step:
        """As the core's."""
        self.last = self.core.step(now_us)
        self.steps += 1
        return self.last


def open_recording(log: PathLike, header: RunHeader | None) -> LogWriter | RotatingLog:
    """The log of a run in virtual time, in a folder that is made where there is none; beside it the
    header of a controller of ours."""
    path = Path(log)
    folder_for(path.parent)
    writer = open_log(str(path), channel=LOG_CHANNEL, by_frame_time=True)
    if header is not None:
        header.save(writer.path.parent)
    return writer


def rig_settings(setup: Setup, gear: int) -> RigSettings:
    """The rig of a run that stands in a gear, at the speeds shifts begin at."""
    return setup.rig(plan_shifts(setup.sheet, [(gear, gear)], 1, LAYSHAFT_RAD_S)[0])
