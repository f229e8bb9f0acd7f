"""Many worlds, one after the other, until enough time has been simulated or has passed."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Final

from benchmarks.swarm.aimed import aimed_world
from benchmarks.swarm.draw import draw_world
from benchmarks.swarm.episode import Episode, EpisodeResult, Reached, declared
from benchmarks.swarm.events import World, save_world
from benchmarks.swarm.invariants import Broken
from benchmarks.swarm.shrink import shrink
from meshpoint.base.errors import CommandError
from meshpoint.base.provenance import gearbox_words, provenance
from meshpoint.base.version import product_version
from meshpoint.bus.settle import settle
from meshpoint.campaigns.runner import executor
from meshpoint.campaigns.spec import SEEDS_APART
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc import DBC_SHA256
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.reading import read_text
from meshpoint.results.output import folder_for
from meshpoint.rig_sim.settings import DEFAULT_PRESET, DEFAULT_PROFILE, Profile

PART_LIMIT_BYTES: Final = 2_000_000_000
NAMES: Final = ("faults", "fault_codes", "guard_rows", "transitions")


@dataclass(frozen=True)
class SwarmSpec:
    """What the worlds of a swarm share."""

    sheet: GearboxSheet
    settings: ControllerSettings
    seed: int
    profile: Profile = DEFAULT_PROFILE
    as_built: Mapping[str, float] = field(default_factory=dict)

    @property
    def gearbox_words(self) -> str:
        """Which gearboxes it is of, as titles say it."""
        return gearbox_words(self.sheet, DEFAULT_PRESET, self.profile, self.as_built)

    def run(self, world: World) -> EpisodeResult:
        """One world."""
        return Episode(self.sheet, self.settings, world, self.profile, self.as_built).run()

    @property
    def provenance(self) -> dict[str, Any]:
        """Which gearboxes the worlds have, and what else they share."""
        return provenance(self.sheet, self.seed, DEFAULT_PRESET.value, self.profile)

    @property
    def sha256(self) -> str:
        """Parts of one hash go together."""
        values = self.provenance | {"settings": self.settings.values()}
        values["as_built"] = dict(self.as_built)
        values |= {"dbc": DBC_SHA256, "version": product_version()}
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


@dataclass
class Found:
    """A broken invariant, and the least world that breaks it."""

    seed: int
    broken: Broken
    world: World

    def to_json(self) -> dict[str, Any]:
        """As the report has it."""
        return {
            "seed": self.seed,
            "what": self.broken.what,
            "at_ms": self.broken.at_ms,
            "text": self.broken.text,
            "scenario": self.world.to_json(),
        }


@dataclass
class Swarm:
    """What has come of all worlds so far."""

    simulated_s: float = 0.0
    worlds: int = 0
    shifts: int = 0
    engaged: int = 0
    reached: Reached = field(default_factory=Reached)
    found: list[Found] = field(default_factory=list)

    def take(self, result: EpisodeResult) -> None:
        """One world more."""
        self.simulated_s += result.simulated_s
        self.worlds += 1
        self.shifts += result.shifts
        self.engaged += result.engaged
        self.reached.add(result.reached)

    def to_json(self, wall_s: float) -> dict[str, Any]:
        """The figures; of what was to be reached, how often each was, and what was not."""
        values: dict[str, Any] = {
            "simulated_hours": round(self.simulated_s / 3600.0, 3),
            "wall_s": round(wall_s, 1),
            "worlds": self.worlds,
            "shifts": self.shifts,
            "engaged": self.engaged,
            "violations": len(self.found),
            "found": [found.to_json() for found in self.found],
        }
        for name, all_of_them in declared().items():
            counts = getattr(self.reached, name)
            values[f"{name}_reached"] = {
                "declared": len(all_of_them),
                "reached": sum(each in counts for each in all_of_them),
                "missing": [each for each in all_of_them if each not in counts],
                "counts": {each: counts[each] for each in all_of_them if each in counts},
            }
        return values


def world_of(seed: int) -> World:
    """The world of a seed: the first of each swarm are aimed at a corner, the others are drawn."""
    return aimed_world(seed, seed % SEEDS_APART) or draw_world(seed)


@cache
def _settle_once() -> None:
    settle()


def run_seed(spec: SwarmSpec, seed: int) -> tuple[EpisodeResult, list[Found]]:
    """One world, and where it broke something the least that does."""
    _settle_once()
    world = world_of(seed)
    result = spec.run(world)
    found = []
    for broken in result.broken:
        small = shrink(world, broken, lambda each, what=broken.what: breaks(spec, each, what))  # type: ignore[misc]
        found.append(Found(seed, breaks(spec, small, broken.what) or broken, small))
    return result, found


def breaks(spec: SwarmSpec, world: World, what: str) -> Broken | None:
    """Whether a world breaks this invariant."""
    result = spec.run(world)
    return next((broken for broken in result.broken if broken.what == what), None)


def run_swarm(
    spec: SwarmSpec,
    hours: float,
    wall_s: float | None,
    jobs: int,
    folder: Path | None,
    resume: bool,
    tell: Callable[[Swarm], None],
) -> Swarm:
    """Worlds until `hours` are simulated, or `wall_s` have passed; kept in `folder`."""
    parts = None if folder is None else Parts(folder, spec, resume)
    swarm, done = (Swarm(), set[int]()) if parts is None else parts.read()
    until_s = None if wall_s is None else time.monotonic() + wall_s
    seeds = (
        k for k in range(SEEDS_APART * spec.seed, SEEDS_APART * (spec.seed + 1)) if k not in done
    )

    def goes_on() -> bool:
        is_time = until_s is None or time.monotonic() < until_s
        return swarm.simulated_s < 3600.0 * hours and is_time

    for seed, (result, found) in _results(spec, seeds, jobs, goes_on):
        swarm.take(result)
        swarm.found += found
        if parts is not None:
            parts.add(seed, result, found)
        tell(swarm)
    return swarm


def _results(
    spec: SwarmSpec, seeds: Iterator[int], jobs: int, goes_on: Callable[[], bool]
) -> Iterator[tuple[int, tuple[EpisodeResult, list[Found]]]]:
    if jobs == 1:
        while goes_on():
            seed = next(seeds)
            yield seed, run_seed(spec, seed)
        return
    with executor(jobs, None) as where:
        running: dict[Future[tuple[EpisodeResult, list[Found]]], int] = {}
        while running or goes_on():
            while len(running) < 2 * jobs and goes_on():
                seed = next(seeds)
                running[where.submit(run_seed, spec, seed)] = seed
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), future.result()


class Parts:
    """A swarm on disk, a line a world, so that it can be gone on with.

    swarm.json     what it runs, with a hash
    worlds.jsonl   what came of each world
    found-*.json   scenario files of what was found
    """

    def __init__(self, folder: Path, spec: SwarmSpec, resume: bool) -> None:
        self._folder = folder_for(folder)
        self._lines = self._folder / "worlds.jsonl"
        about = self._folder / "swarm.json"
        if not resume and self._lines.exists():
            raise CommandError(f"{folder}: holds a swarm already (--resume goes on with it)")
        if resume and about.exists():
            if json.loads(read_text(about, PART_LIMIT_BYTES)).get("sha256") != spec.sha256:
                raise CommandError(f"{folder}: was begun with other settings or another version")
        else:
            text = json.dumps({"seed": spec.seed, "sha256": spec.sha256})
            about.write_text(text + "\n", encoding="utf-8")

    def read(self) -> tuple[Swarm, set[int]]:
        """What is there. A last line that was cut off is left out."""
        swarm, done = Swarm(), set[int]()
        if not self._lines.exists():
            return swarm, done
        for line in read_text(self._lines, PART_LIMIT_BYTES).splitlines():
            try:
                values = json.loads(line)
            except ValueError:
                continue
            reached = Reached()
            for name in NAMES:
                getattr(reached, name).update(values["reached"][name])
            figures = (values["simulated_s"], values["shifts"], values["engaged"])
            swarm.take(EpisodeResult(values["seed"], *figures, [], reached))
            done.add(values["seed"])
            for what, at_ms, text in values["broken"]:
                swarm.found.append(
                    Found(values["seed"], Broken(what, at_ms, text), world_of(values["seed"]))
                )
        return swarm, done

    def add(self, seed: int, result: EpisodeResult, found: list[Found]) -> None:
        """One world more."""
        values = {
            "seed": seed,
            "simulated_s": result.simulated_s,
            "shifts": result.shifts,
            "engaged": result.engaged,
            "broken": [list(each.broken) for each in found],
            "reached": {name: dict(getattr(result.reached, name)) for name in NAMES},
        }
        with self._lines.open("a", encoding="utf-8") as lines:
            lines.write(json.dumps(values, sort_keys=True) + "\n")
        for each in found:
            path = self._folder / f"found-{seed}-{each.broken.what}.json"
            save_world(path, each.world, {"broken": each.broken._asdict()})
