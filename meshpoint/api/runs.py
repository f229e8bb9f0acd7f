"""`simulate`, `campaign` and `replay`: whole runs, as the commands of the same names make them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from meshpoint.api.bench import open_recording
from meshpoint.api.choices import (
    AsBuilt,
    PathLike,
    Strategy,
    load_gearbox,
    load_settings,
    pairs_of,
    setup_of,
)
from meshpoint.api.logs import Log, load_arrow, shifts_table
from meshpoint.bench.compiling import prepare_once
from meshpoint.bench.schedules import Pairs, check_preset
from meshpoint.bench.simulate import Result
from meshpoint.bench.simulate import simulate as run_simulation
from meshpoint.campaigns.draw import upshifts
from meshpoint.campaigns.record import JudgedShift
from meshpoint.campaigns.result import Collected, to_json
from meshpoint.campaigns.runner import run_all, workplace
from meshpoint.campaigns.spec import CampaignSpec
from meshpoint.controller.settings.header import RunHeader
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.settings.strategy_file import StrategyFile
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox import GearboxSheet
from meshpoint.replays.chosen import Chosen, other_header, recorded_header
from meshpoint.replays.open_loop import OpenLoop
from meshpoint.replays.replay import LogReplay
from meshpoint.replays.replay_rows import ReplayRows
from meshpoint.replays.session import Session, Verification
from meshpoint.report.judged_rows import JudgedRow
from meshpoint.results.monitor import Monitor, RowMonitor
from meshpoint.results.rows import ShiftRow, Summary, summarise
from meshpoint.rig_sim.orders import ScheduledFault
from meshpoint.rig_sim.settings import DEFAULT_PRESET, DEFAULT_PROFILE, Preset

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class Simulation:
    """What `simulate` came to."""

    strategy: str
    result: Result
    """Everything, also what was drawn for the rig and how well the estimators did."""

    @property
    def shifts(self) -> list[ShiftRow]:
        """One record a shift."""
        return self.result.rows

    @property
    def summary(self) -> Summary:
        """Counts, gap rate, mean duration."""
        return summarise(self.strategy, self.result.rows)

    def table(self) -> pa.Table:
        """The shifts as an Arrow table."""
        return shifts_table(self.result.rows)

    def to_json(self) -> dict[str, Any]:
        """As `meshpoint simulate --json` writes it."""
        return self.result.to_json(self.strategy)


def simulate(
    shifts: int = 20,
    *,
    seed: int = 1,
    pairs: str | Pairs = "upshifts",
    gearbox: PathLike | GearboxSheet | None = None,
    preset: str = DEFAULT_PRESET,
    as_built: AsBuilt = DEFAULT_PROFILE,
    faults: PathLike | tuple[ScheduledFault, ...] = (),
    strategy: Strategy | None = None,
    estimator: str | None = None,
    settings: PathLike | ControllerSettings | None = None,
    log: PathLike | None = None,
    on_shift: Callable[[ShiftRow], None] | None = None,
    score_estimators: bool = True,
) -> Simulation:
    """Shifts in virtual time, as `meshpoint simulate`: the same arguments give the same result.

    pairs: a schedule's name (`upshifts`, `main-box`, `mixed`), or ((8, 10), (10, 12)).
    log: records the bus, with the run header beside it.
    on_shift: called with each record as it comes.
    score_estimators: compare the estimators with the encoder, which takes a quarter longer;
        without it, `estimation` is empty.

    The others are those of `Bench`. TableError and its like name what cannot be used.
    """
    chosen = load_settings(settings, strategy=strategy, estimator=estimator)
    setup = setup_of(gearbox, preset, seed, as_built, faults, chosen, shifts, pairs)
    check_preset(setup.pairs, setup.sheet, setup.preset)
    prepare_once(thesis=setup.preset is Preset.THESIS)
    monitor = (Monitor if score_estimators else RowMonitor)(setup.sheet, setup.settings)
    with ExitStack() as stack:
        recording = None if log is None else open_recording(log, setup.header)
        if recording is not None:
            stack.enter_context(recording)

        def on_frame(time_us: int, frame: Frame) -> None:
            if recording is not None:
                recording.write(time_us / 1e6, frame)

        heard = None if recording is None else on_frame
        result = run_simulation(setup, heard, on_shift, monitor=monitor)
    return Simulation(setup.settings.strategy_name, result)


@dataclass(frozen=True)
class Campaign:
    """What `campaign` came to."""

    spec: CampaignSpec
    shifts: list[JudgedShift]
    """Every judged shift of every strategy."""
    values: dict[str, Any]
    """As `meshpoint campaign --json` writes it: figures with their intervals, and ratios."""

    def table(self) -> pa.Table:
        """The judged shifts as an Arrow table."""
        return load_arrow().Table.from_pylist([record.to_row() for record in self.shifts])


def campaign(
    runs: int = 100,
    *,
    strategies: Sequence[Strategy] = ("speed_window", "target_phase"),
    true_state: bool = False,
    learn: int = 6,
    judged: int = 2,
    seed: int = 1,
    pairs: str | Pairs | None = None,
    gearbox: PathLike | GearboxSheet | None = None,
    preset: str = DEFAULT_PRESET,
    as_built: AsBuilt = DEFAULT_PROFILE,
    estimator: str | None = None,
    settings: PathLike | ControllerSettings | None = None,
    jobs: int = 1,
) -> Campaign:
    """Many seeded draws, strategies compared on the same ones, as `meshpoint campaign`.

    learn, judged: shifts of each run in which the controller learns, and that are judged.
    pairs: gear changes to draw from; None: all upshifts of the main box.
    jobs: worker processes; more than one need the caller's script to be importable
        (`if __name__ == "__main__":`). The result does not depend on it.

    RuntimeError where a run broke off, with its seed.
    """
    chosen = load_settings(settings, estimator=estimator)
    setup = setup_of(gearbox, preset, seed, as_built, (), chosen)
    own = [load_settings(chosen, strategy=strategy) for strategy in strategies]
    files: dict[str, StrategyFile] = {
        each.strategy_name: each.strategy_file for each in own if each.strategy_file is not None
    }
    spec = CampaignSpec(
        sheet=setup.sheet,
        settings=chosen,
        preset=Preset(preset),
        strategies=tuple(dict.fromkeys(each.strategy_name for each in own)),
        true_state=true_state,
        pairs=upshifts() if pairs is None else pairs_of(pairs),
        learn=learn,
        judged=judged,
        seed=seed,
        profile=setup.profile,
        as_built=setup.as_built,
        strategy_files=files,
    )
    collected = Collected(spec, spec.jobs(runs))
    with workplace(jobs, None) as where:
        if not run_all(spec, collected.jobs, where, collected.take):
            raise KeyboardInterrupt
    if collected.failed:
        failed = collected.failed[0]
        raise RuntimeError(f"run {failed.job.seed} failed: {failed.reason}")
    return Campaign(spec, collected.records, to_json(spec, collected))


@dataclass(frozen=True)
class Replay:
    """What `replay` came to."""

    sessions: list[Session]
    """One for each run of a controller in the log, with its verdict."""
    shifts: list[ShiftRow] = field(default_factory=list)
    """As recorded."""
    judged: list[JudgedRow] = field(default_factory=list)
    """Where something else was asked about: each shift with what would have been decided."""

    @property
    def verdict(self) -> Verification:
        """The worst of all sessions: identical, identical in parts, not verifiable, differs."""
        order = (
            Verification.IDENTICAL,
            Verification.IN_PARTS,
            Verification.NOT_VERIFIABLE,
            Verification.DIFFERS,
        )
        return max((session.verdict for session in self.sessions), key=order.index)

    @property
    def strategy_errors(self) -> Counter[str]:
        """What was wrong with a user's own strategy, and how many shifts ended of it."""
        errors: Counter[str] = Counter()
        for session in self.sessions:
            errors += Counter(session.strategy_errors)
        return errors


def replay(
    *log: PathLike,
    strategy: Strategy | None = None,
    settings: PathLike | None = None,
    estimator: str | None = None,
    gearbox: PathLike | GearboxSheet | None = None,
    verify: bool | None = None,
    bus: str | None = None,
    header_dir: PathLike | None = None,
) -> Replay:
    """A recorded log through the same controller, as `meshpoint replay`.

    Without anything else it is verified: `verdict` says whether the controller of today sends the
    same bytes at every step. strategy, settings (a TOML file), estimator, gearbox: what a
    controller that has these otherwise would decide in each recorded shift; `judged` has it
    (docs/replay.md).

    verify: compare with the log; without it, where nothing else is asked about. A log made by a
    strategy of your own is verified with `strategy` and `verify=True`.

    LogError where the log cannot be read, or not to its end.
    """
    recorded = Log(*log, bus=bus, header_dir=header_dir)
    own = None if strategy is None else load_settings(strategy=strategy)
    chosen = Chosen(
        name=None if own is None else own.strategy_name,
        file=None if own is None else own.strategy_file,
        settings=None if settings is None else Path(settings),
        estimator=estimator,
        sheet=None if gearbox is None else load_gearbox(gearbox),
    )
    asked = chosen if chosen.changes else None
    verify = asked is None if verify is None else verify
    if verify and chosen._replace(name=None, file=None).changes:
        raise ValueError("verify=True compares with the log: nothing but strategy may be given")
    open_loop = None
    if asked is not None and not verify:
        open_loop = OpenLoop(lambda header: other_header(header, asked))
    rows = ReplayRows(False, open_loop, str(asked or ""))

    def change(header: RunHeader) -> RunHeader:
        changed = recorded_header(header, asked, verify)
        rows.start(changed)
        return changed

    folder = Path(header_dir) if header_dir is not None else recorded.files[0].parent
    repeat = LogReplay(folder, verify, change, rows.made, onlooker=open_loop)

    def fed() -> Iterator[Frame]:
        for _, frame in recorded:
            rows.logged(frame)
            yield frame

    sessions = repeat.run(fed())
    return Replay(sessions, rows.rows, rows.judged if open_loop is not None else [])
