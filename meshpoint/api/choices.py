"""What a caller may say in several ways, as the bench wants it."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from meshpoint.bench.schedules import SCHEDULES, Pairs
from meshpoint.bench.setup import Setup
from meshpoint.controller.plan.own_strategy import read_strategy
from meshpoint.controller.settings.settings import (
    ESTIMATOR_NAMES,
    STRATEGY_NAMES,
    ControllerSettings,
)
from meshpoint.controller.settings.settings import load_settings as read_settings
from meshpoint.controller.settings.strategy_file import FORM, is_file_name
from meshpoint.gearbox import GearboxSheet, load_sheet
from meshpoint.gearbox.tables import TableError
from meshpoint.rig_sim.orders import ScheduledFault
from meshpoint.rig_sim.settings import DEFAULT_PRESET, Preset
from meshpoint.rig_sim.truck.as_built import as_built_of, read_as_built
from meshpoint.rig_sim.truck.scenario import load_scenario

PathLike = str | Path
AsBuilt = str | Path | Mapping[str, float | str]
Strategy = str | type[Any]


def load_gearbox(name: PathLike | GearboxSheet = DEFAULT_PRESET.sheet_name) -> GearboxSheet:
    """A data sheet: `thesis`, `truck12`, or a TOML file. TableError names file, key and allowed."""
    return name if isinstance(name, GearboxSheet) else load_sheet(str(name))


def load_settings(
    settings: PathLike | ControllerSettings | None = None,
    *,
    strategy: Strategy | None = None,
    estimator: str | None = None,
) -> ControllerSettings:
    """The controller's settings: a TOML file, or the defaults.

    strategy: its name; `FILE.py:CLASS`; or a class, which must stand in a file of its own at the
        top level, because the run header names the file and its hash.
    estimator: `window`, `thesis` or `crossing`.

    TableError names file, key, found and allowed; StrategyError what is wrong with a strategy.
    """
    if isinstance(settings, ControllerSettings):
        found = settings
    else:
        found = read_settings(None if settings is None else Path(settings))
    if strategy is not None:
        name = strategy if isinstance(strategy, str) else _file_name(strategy)
        if name not in STRATEGY_NAMES and not is_file_name(name):
            allowed = ", ".join(STRATEGY_NAMES)
            raise TableError(f"strategy = {name!r}, allowed are {allowed}, {FORM}, or a class")
        found = found.with_strategy(name, read_strategy(name) if is_file_name(name) else None)
    if estimator is not None:
        if estimator not in ESTIMATOR_NAMES:
            allowed = ", ".join(ESTIMATOR_NAMES)
            raise TableError(f"estimator = {estimator!r}, allowed are {allowed}")
        found = replace(found, estimator_name=estimator)
    return found


def _file_name(strategy: type[Any]) -> str:
    """FILE.py:CLASS of a class."""
    try:
        path = inspect.getsourcefile(strategy)
    except (OSError, TypeError):
        path = None
    name = f"{path}:{strategy.__qualname__}"
    if path is None or not is_file_name(name):
        raise TableError(
            f"strategy {strategy.__qualname__}: allowed is a class at the top level of a .py file"
        )
    return name


def pairs_of(pairs: str | Pairs) -> Pairs:
    """Shifts to cycle through: a schedule's name, or a tuple of (from, to)."""
    if isinstance(pairs, str):
        if pairs not in SCHEDULES:
            raise TableError(f"pairs = {pairs!r}, allowed are {', '.join(SCHEDULES)}, or a tuple")
        return SCHEDULES[pairs]
    return tuple(pairs)


def setup_of(
    gearbox: PathLike | GearboxSheet | None,
    preset: str,
    seed: int,
    as_built: AsBuilt,
    faults: PathLike | tuple[ScheduledFault, ...],
    settings: ControllerSettings,
    shifts: int = 1,
    pairs: str | Pairs = "upshifts",
) -> Setup:
    """All of it as one simulated run has it. TableError, SettingsError or AsBuiltError names what
    cannot be used."""
    if preset not in tuple(Preset):
        raise TableError(f"preset = {preset!r}, allowed are {', '.join(Preset)}")
    if isinstance(as_built, Mapping):
        built = as_built_of(as_built)
    else:
        built = read_as_built(Path(as_built))
    return Setup(
        sheet=load_gearbox(Preset(preset).sheet_name if gearbox is None else gearbox),
        settings=settings,
        preset=Preset(preset),
        seed=seed,
        shifts=shifts,
        pairs=pairs_of(pairs),
        profile=built.profile,
        as_built=built.fixed,
        faults=faults if isinstance(faults, tuple) else load_scenario(Path(faults)),
    )
