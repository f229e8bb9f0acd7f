"""`meshpoint campaign --against`: where the shifts before the change come from."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path

from meshpoint.base.errors import CommandError
from meshpoint.bus.options import is_classic_profile
from meshpoint.campaigns.baseline import Baseline, FileBaseline
from meshpoint.campaigns.git_reference import (
    Commit,
    GitBaseline,
    as_of,
    export,
    find_commit,
    own_strategy,
)
from meshpoint.campaigns.spec import CampaignSpec
from meshpoint.cli.arguments import gearbox_of

TABLE_ENDING = ".parquet"


def baseline(
    namespace: argparse.Namespace,
    spec: CampaignSpec,
    runs: int,
    stack: ExitStack,
    compile_kernels: Callable[[], None],
) -> tuple[Baseline, str]:
    """The shifts before the change, and the controller's own strategy then. Sets how many runs
    there are (`runs` where nothing says) and the processes left for the campaign now. `stack` ends
    what works for it and removes its files."""
    path = Path(namespace.against)
    if path.exists() or path.suffix == TABLE_ENDING:
        found = FileBaseline(path, spec.own)
        seeds = {job.seed for job in spec.jobs(namespace.runs or len(found.outcomes))}
        known = len(seeds & set(found.outcomes))
        if known == 0:
            raise CommandError(f"--against {path}: none of its runs is one of --seed {spec.seed}")
        namespace.runs = min(namespace.runs or known, known)
        return found, spec.own
    if namespace.dask is not None or namespace.resume:
        raise CommandError("--against a commit works here and anew: leave out --dask and --resume")
    namespace.runs = namespace.runs or runs
    commit = find_commit(namespace.against)
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="meshpoint-before-")))
    exported = folder / "commit"
    compile_kernels()  # first: the commit's product then takes those that it has as well
    source = exported if export(commit, exported) else None
    files = _files(namespace, commit, exported)
    if source is None and not any(Path(path).is_relative_to(exported) for path in files.values()):
        raise CommandError(
            f"--against {commit}: it holds neither the product nor a file that this command names, "
            "so nothing would differ"
        )
    jobs = max(1, namespace.jobs // 2)
    namespace.jobs = max(1, namespace.jobs - jobs)
    strategy = own_strategy(files.get("settings"))
    work = folder / "campaign" if namespace.out is None else namespace.out / "before"
    command = _command(namespace, files, strategy, jobs, work)
    before = GitBaseline(commit, work, command, source, strategy)
    return stack.enter_context(closing(before)), strategy


def _files(namespace: argparse.Namespace, commit: Commit, exported: Path) -> dict[str, str]:
    """What arguments name, as the commit has it."""
    given = {
        "settings": namespace.settings,
        "gearbox": gearbox_of(namespace),  # named, since the commit may have another default
        "as_built": namespace.as_built,
    }
    return {name: as_of(commit, exported, str(value)) for name, value in given.items() if value}


def _command(
    namespace: argparse.Namespace, files: dict[str, str], strategy: str, jobs: int, work: Path
) -> list[str]:
    """The same campaign, by the controller's own strategy alone."""
    pairs = ",".join(f"{a}-{b}" for a, b in namespace.pairs)
    values = {
        "runs": namespace.runs, "learn": namespace.learn, "judged": namespace.judged,
        "pairs": pairs, "rest": namespace.rest, "preset": namespace.preset, "seed": namespace.seed,
        "profile": "classic" if is_classic_profile(namespace) else None,
        "estimator": namespace.estimator, "strategy": strategy, "jobs": jobs, "out": work, **files,
    }  # fmt: skip
    return ["campaign"] + [
        word
        for name, value in values.items()
        if value is not None
        for word in (f"--{name.replace('_', '-')}", str(value))
    ]
