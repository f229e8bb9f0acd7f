"""`meshpoint campaign`: many seeded runs, strategies compared on the same draws."""

from __future__ import annotations

import argparse
import os
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from meshpoint.base.errors import CommandError, RunError
from meshpoint.base.exits import Exit
from meshpoint.bench.compiling import prepare
from meshpoint.bench.schedules import pairs
from meshpoint.bus import given_numbers
from meshpoint.campaigns.before import baseline
from meshpoint.campaigns.draw import upshifts
from meshpoint.campaigns.report import write_report
from meshpoint.campaigns.result import Collected, to_json
from meshpoint.campaigns.run import RunResult, run_one
from meshpoint.campaigns.runner import WorkersLostError, run_all, workplace
from meshpoint.campaigns.sequential import FIGURES, GAP, GOAL_FORM, Goal, parse_goal
from meshpoint.campaigns.spec import CampaignSpec, Job
from meshpoint.campaigns.stopping import Against, AllRuns, Stopping, Until
from meshpoint.campaigns.store import Store
from meshpoint.campaigns.sweep import SweepPoint
from meshpoint.campaigns.table import print_tables, records_table
from meshpoint.campaigns.verdict_words import (
    against_table,
    exit_code,
    markdown,
    stopped_words,
    write_junit,
)
from meshpoint.cli import arguments
from meshpoint.cli.interrupt import interruptible
from meshpoint.controller.plan.strategist import make_strategy
from meshpoint.controller.settings.settings import STRATEGY_NAMES
from meshpoint.controller.settings.strategy_file import FORM, StrategyFile
from meshpoint.results.junit import write_text
from meshpoint.results.output import complain, complain_of_strategy, console, write_json
from meshpoint.results.progress import Shown
from meshpoint.rig_sim.settings import Preset

MOST_RUNS: Final = 1_000_000
RUNS: Final = 100
RUNS_UNTIL: Final = 2_000
JUDGED: Final = 2
JUDGED_UNTIL: Final = 6
RUNS_AGAINST: Final = 500
"""Where a commit is compared with: enough for a verdict on the margin that is the default."""
_GOAL_HELP: Final = GOAL_FORM.replace("%", "%%")
DESCRIPTION: Final = """\
Seeded Monte Carlo. A run is one draw: a gearbox as built, oil, load, slope, supply pressure and one
gear change. The controller first makes the learning shifts; then each judged shift is made by every
strategy on a copy of the same bench, so strategies are compared on the same draws. Every shift goes
through encoded frames of both nodes in virtual time. Results do not depend on --jobs or --dask."""


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "campaign",
        description=DESCRIPTION,
    )
    parser.add_argument(
        "--runs", type=given_numbers.whole(1, MOST_RUNS), metavar="N",
        help=f"number of draws (default: {RUNS}; with --until at most {RUNS_UNTIL}; with --against "
        "those of the baseline, "
        f"{RUNS_AGAINST} for a commit); each has --judged paired shifts",
    )  # fmt: skip
    parser.add_argument(
        "--learn", type=given_numbers.whole(0, 1000), default=6, metavar="L",
        help="shifts of each run in which the controller learns, not judged (default: 6)",
    )  # fmt: skip
    parser.add_argument(
        "--judged", type=given_numbers.whole(1, 1000), metavar="K",
        help="shifts of each run and strategy that are judged (default: "
        f"{JUDGED}; with --until {JUDGED_UNTIL}, which takes the least time to an interval)",
    )  # fmt: skip
    parser.add_argument(
        "--judged-blind", type=given_numbers.whole(1, 1000), metavar="K",
        help="of those, this many also by strategies that are blind to the phase, beside the "
        f"controller's own (default: all; with --until {GAP} 1). --until integrates their gap "
        "rate, which is then the same of one shift of a run as of all",
    )  # fmt: skip
    parser.add_argument(
        "--strategy", dest="strategies", type=_strategies, metavar="A,B,...",
        help=f"strategies to compare, of {', '.join(STRATEGY_NAMES)}, and your own as {FORM} "
        "(default: all of ours; with --until the controller's own and the first other one; with "
        "--against the controller's own alone, which is judged)",
    )  # fmt: skip
    parser.add_argument(
        "--true-state", "--oracle", dest="true_state", action="store_true",
        help="also target_phase with the rig's true state and parameters, but no future chance "
        "(--oracle: its old name)",
    )  # fmt: skip
    parser.add_argument(
        "--pairs", type=pairs, default=upshifts(), metavar="LIST",
        help="gear changes to draw from, as 8-10,10-12 (default: all upshifts of the main box)",
    )  # fmt: skip
    parser.add_argument(
        "--rest", type=given_numbers.whole(0, 60_000), metavar="MS",
        help="in the old gear from its clutch's closing to the request (default: until the "
        "driveline has settled)",
    )  # fmt: skip
    parser.add_argument(
        "--sweep", type=_sweep, action="append", default=[], metavar="NAME=V1,V2,...",
        help="all runs again at each of these values, for curves: backlash_percent, delay_sd_ms, "
        "or a controller setting, as window.aim_slip_rpm; may be repeated",
    )  # fmt: skip
    _add_stopping(parser)
    _add_execution(parser)
    parser.add_argument("--faults", action=_Faults, nargs=0, help=argparse.SUPPRESS)
    arguments.add_preset(parser)
    arguments.add_seed(parser)
    arguments.add_as_built(parser)
    arguments.add_gearbox(parser, has_preset=True)
    arguments.add_controller(parser, strategy=False)
    arguments.add_wire(parser)
    arguments.add_json(parser)
    parser.set_defaults(run=run)


class _Faults(argparse.Action):
    """Says where the campaign of faults is."""

    def __call__(self, parser: argparse.ArgumentParser, *_given: object) -> None:
        parser.error("--faults is `python -m benchmarks.swarm` in the repository (docs/safety.md)")


def _add_stopping(parser: argparse.ArgumentParser) -> None:
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--until", type=_goal, metavar="GOAL",
        help=f"stop when an interval is narrow enough, {_GOAL_HELP}: of the controller's own "
        f"strategy against the first other one of --strategy; figures: {', '.join(FIGURES)}; at "
        "most --runs",
    )  # fmt: skip
    what.add_argument(
        "--against", metavar="FILE|DIR|COMMIT",
        help="an earlier campaign with the same draws (its --out folder, or its table), or a git "
        "commit, whose product then makes them beside this one: stop when it is clear whether "
        "shifts have got worse in first contact, time or impact; exit code 1 when they have in any "
        "of them, 4 where --runs do not tell",
    )  # fmt: skip
    parser.add_argument(
        "--margin", type=given_numbers.percent(0.5, 50.0), default=0.03, metavar="PERCENT",
        help="with --against: by how much the share of gaps must fall to be called worse "
        "(default: 3)",
    )  # fmt: skip
    parser.add_argument(
        "--margin-time", type=given_numbers.percent(0.5, 100.0), default=0.05, metavar="PERCENT",
        help="with --against: by how much shifts must take longer to be called worse (default: 5)",
    )  # fmt: skip
    parser.add_argument(
        "--margin-impact", type=given_numbers.percent(0.5, 500.0), default=0.25, metavar="PERCENT",
        help="with --against: by how much the energy of impacts must rise to be called worse "
        "(default: 25)",
    )  # fmt: skip
    parser.add_argument(
        "--budget", type=given_numbers.some_seconds, metavar="S",
        help="with --until: begin no run that would, by the pace so far, end after this many wall "
        "seconds; the runs made so far are the result",
    )  # fmt: skip
    parser.add_argument(
        "--junit", type=Path, metavar="FILE", help="the result as JUnit XML, for a CI server"
    )
    parser.add_argument(
        "--markdown", type=Path, metavar="FILE", help="verdict and figures as Markdown, for people"
    )


def _goal(text: str) -> Goal:
    try:
        return parse_goal(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _stopping(namespace: argparse.Namespace, spec: CampaignSpec, stack: ExitStack) -> Stopping:
    """What ends the campaign, and how many runs it may have; `stack` ends what works for it.
    CommandError where it cannot be judged."""
    if namespace.against is None:
        namespace.runs = namespace.runs or (RUNS if namespace.until is None else RUNS_UNTIL)
    if namespace.until is None and namespace.against is None:
        if namespace.budget is not None:
            raise CommandError("--budget needs --until: the interval that is waited for")
        return AllRuns()
    if spec.sweep:
        raise CommandError("--until and --against judge the base alone: leave out --sweep")
    if namespace.against is not None:
        return _against(namespace, spec, stack)
    others = [name for name in spec.names if name != spec.own]
    if spec.own not in spec.names or not others:
        raise CommandError(
            f"--until compares {spec.own} with another strategy: name both with --strategy"
        )
    return Until(namespace.until, (spec.own, others[0]), namespace.budget)


def _against(namespace: argparse.Namespace, spec: CampaignSpec, stack: ExitStack) -> Against:
    if spec.own not in spec.names:
        raise CommandError(f"--against judges {spec.own}, the controller's own: name it")
    before, strategy = baseline(namespace, spec, RUNS_AGAINST, stack, lambda: _compile(namespace))
    seeds = [job.seed for job in spec.jobs(namespace.runs)]
    margins = {"duration_ms": namespace.margin_time, "impact_j": namespace.margin_impact}
    return Against(before, (strategy, spec.own), namespace.margin, margins, seeds)


def _add_execution(parser: argparse.ArgumentParser) -> None:
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--jobs", type=given_numbers.whole(1, 1024), default=os.cpu_count() or 1, metavar="J",
        help="worker processes (default: one a processor)",
    )  # fmt: skip
    where.add_argument(
        "--dask", metavar="ADDRESS", help="a Dask scheduler, as tcp://host:8786 (extra: dask)"
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR",
        help="keep every judged shift (shifts.parquet) and a report here",
    )  # fmt: skip
    parser.add_argument(
        "--resume", action="store_true", help="go on with the campaign in --out; it may grow"
    )
    parser.add_argument(
        "--only", type=given_numbers.whole(0, 2**63 - 1), metavar="SEED",
        help="make the run of this seed alone, here, and show its shifts",
    )  # fmt: skip


def run(namespace: argparse.Namespace) -> int:
    """Runs it."""
    built = arguments.as_built_of(namespace)
    settings = arguments.settings_of(namespace)
    strategies = namespace.strategies or _compared(namespace, settings.strategy_name)
    spec = CampaignSpec(
        sheet=arguments.sheet_of(namespace),
        settings=settings,
        preset=Preset(namespace.preset),
        strategies=strategies,
        true_state=namespace.true_state,
        pairs=namespace.pairs,
        learn=namespace.learn,
        judged=namespace.judged or (JUDGED if namespace.until is None else JUDGED_UNTIL),
        judged_blind=_judged_blind(namespace),
        rest_us=None if namespace.rest is None else 1000 * namespace.rest,
        seed=namespace.seed,
        profile=built.profile,
        wire=arguments.wire_of(namespace),
        as_built=built.fixed,
        sweep=tuple(point for points in namespace.sweep for point in points),
        strategy_files=_strategy_files(strategies),
    )
    for name in spec.strategy_files:
        make_strategy(spec.sheet, spec.engagement(name))
    for point in spec.sweep:
        spec.at(point)  # a name or value that cannot be used is found before a long run
    out = console(namespace.json)
    if namespace.only is not None:
        return _only(namespace, spec, out)
    return _all(namespace, spec, out)


def _only(namespace: argparse.Namespace, spec: CampaignSpec, out: Console) -> int:
    """One run, where a debugger can follow it."""
    result = run_one(spec, Job(namespace.only))
    if result.error is not None:
        complain(result.error)
        return Exit.FAILED
    complain_of_strategy(result.strategy_errors)
    if namespace.json is not None:
        write_json(namespace.json, {"shifts": [record.to_row() for record in result.records]})
    if namespace.json != "-":
        out.print(records_table(f"run {namespace.only}, {spec.gearbox_words}", result.records))
    return Exit.FAILED if result.strategy_errors else Exit.DONE


def _all(namespace: argparse.Namespace, spec: CampaignSpec, out: Console) -> int:
    if namespace.resume and namespace.out is None:
        raise CommandError("--resume needs the --out of the campaign to go on with")
    store = None
    if namespace.out is not None:
        store = Store(namespace.out, spec, namespace.resume)
    with ExitStack() as stack:
        stopping = _stopping(namespace, spec, stack)
        jobs = spec.jobs(namespace.runs)
        _compile(namespace)
        collected = Collected(spec, jobs, None if store is None else store.shifts)
        if collected.left_out:
            raise CommandError(
                f"{namespace.out}: this line leaves out {collected.left_out} of the runs that it "
                "has; --runs and --sweep may only grow"
            )
        lost: WorkersLostError | None = None
        try:
            finished = _make(namespace, spec, store, collected, stopping)
        except WorkersLostError as error:
            lost, finished = error, False
    values = to_json(spec, collected) | stopping.to_json()
    if not finished:
        values["interrupted"] = True
        if namespace.json is not None:
            write_json(namespace.json, values)
        if lost is not None:
            raise RunError(f"{lost}: {_kept(namespace, collected)}") from lost
        complain(f"interrupted: {_kept(namespace, collected)}")
        return Exit.INTERRUPTED
    return _write(namespace, spec, collected, store, values, out)


def _compile(namespace: argparse.Namespace) -> None:
    """The kernels that the runs made here call, where there are none yet."""
    if namespace.dask is None:
        baselines = namespace.estimator not in (None, "crossing")
        prepare(thesis=namespace.preset == Preset.THESIS.value, baselines=baselines)


def _write(
    namespace: argparse.Namespace,
    spec: CampaignSpec,
    collected: Collected,
    store: Store | None,
    values: dict[str, Any],
    out: Console,
) -> int:
    """Everything that was asked for; the command's exit code."""
    if store is not None:
        store.finish(collected.shifts)
        out.print(f"table {store.table}")
        write_report(store.report, spec, collected, values)
        out.print(f"report {store.report}")
    if namespace.json is not None:
        write_json(namespace.json, values)
    if namespace.json != "-":
        print_tables(out, values, spec.gearbox_words)
    for failed in collected.failed:
        complain(
            f"meshpoint campaign: run {failed.job.seed} failed: {failed.reason} "
            f"(again alone: --only {failed.job.seed})"
        )
    complain_of_strategy(collected.strategy_errors)
    if "against" in values and namespace.json != "-":
        out.print()
        out.print(against_table(values["against"], spec.gearbox_words))
    for line in stopped_words(values):
        out.print(line)
    if namespace.junit is not None:
        write_junit(namespace.junit, values, spec.gearbox_words)
    if namespace.markdown is not None:
        write_text(namespace.markdown, markdown(values, spec.gearbox_words))
    went_wrong = bool(collected.failed or collected.strategy_errors)
    return Exit.FAILED if went_wrong else exit_code(values)


def _make(
    namespace: argparse.Namespace,
    spec: CampaignSpec,
    store: Store | None,
    collected: Collected,
    stopping: Stopping,
) -> bool:
    """All runs that are left, and on standard error how far they are."""
    done, total = len(collected.done), len(collected.jobs)
    with Shown("campaign", "runs", total, done) as shown:

        def take(results: list[RunResult]) -> None:
            # Results are taken whole: what is in the table on disk is in the JSON as well.
            with interruptible() as interrupted:
                if store is not None:
                    store.add([record for result in results for record in result.records])
                collected.take(results)
                shown.advance(len(results))
            if interrupted():
                raise KeyboardInterrupt

        made, before = collected.jobs[:0], len(collected.done)
        at_once = 1 if namespace.dask is not None else namespace.jobs
        in_flight = None if namespace.budget is None else namespace.jobs

        def may_begin() -> bool:
            return stopping.may_begin(len(collected.done) - before, at_once)

        with workplace(namespace.jobs, namespace.dask) as where:
            for runs in stopping.looks(namespace.runs):
                made = spec.jobs(runs)
                if not run_all(spec, collected.left(made), where, take, may_begin, in_flight):
                    return False
                left = set(collected.left(made))
                made = [job for job in made if job not in left]
                if stopping.enough(collected.within(made)) or left:
                    break
        collected.stop_at(made)
        return True


def _kept(namespace: argparse.Namespace, collected: Collected) -> str:
    """What there is of a campaign that did not come to its end, and where."""
    kept = f"{len(collected.done)} of {len(collected.jobs)} runs done"
    more = "; kept is what --json or --out is given for"
    if namespace.out is not None:
        more = f" and kept in {namespace.out}; --resume goes on"
    elif namespace.json is not None:
        more = " and in the JSON"
    return f"{kept}{more}"


def _compared(namespace: argparse.Namespace, own: str) -> tuple[str, ...]:
    """The strategies that are compared where none are named."""
    if namespace.against is not None:
        return (own,)
    others = [name for name in STRATEGY_NAMES if name != own]
    return (own, others[0]) if namespace.until is not None else tuple(STRATEGY_NAMES)


def _judged_blind(namespace: argparse.Namespace) -> int | None:
    """One where the campaign waits for gaps: more of them add nothing to an integrated rate."""
    waits_for_gaps = namespace.until is not None and namespace.until.figure == GAP
    return namespace.judged_blind or (1 if waits_for_gaps else None)


def _strategy_files(names: tuple[str, ...]) -> dict[str, StrategyFile]:
    files = {name: arguments.strategy_file(name) for name in names}
    return {name: file for name, file in files.items() if file is not None}


def _strategies(text: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(arguments.strategy_name(name) for name in text.split(",")))


def _sweep(text: str) -> tuple[SweepPoint, ...]:
    name, _, values = text.partition("=")
    value = given_numbers.number()
    return tuple(SweepPoint(name, value(word)) for word in values.split(","))
