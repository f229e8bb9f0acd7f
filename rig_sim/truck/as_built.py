"""The gearbox as built: the data sheet plus a deviation of everything, drawn from the seed.

`truck.toml` lists every parameter with default, deviation and range; a profile changes defaults and
deviations (`typical.toml`, `harsh.toml`). `--as-built` takes a profile's name, or a file that fixes
what it names (`[group]` tables of numbers, or the JSON a run has put out) and may name the profile
of the rest: `profile = "typical"`. The rest is drawn as ever, so the same seed, profile and file
give the same gearbox.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from meshpoint.gearbox.reading import read_text
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.gearbox.tables import TableError, load_toml
from meshpoint.gearbox.wheels import Splitter
from meshpoint.rig_sim.settings import DEFAULT_PROFILE, Profile

AS_BUILT_STREAM: Final = 0xA5B
"""Keeps the draws of the gearbox apart from those of the start and of the delays."""


LATER: Final = (
    ("driveline.stiffness_nm_rad", "driveline.damping_nms"),
    (
        "driveline.backlash_deg",
        "driveline.wheels_kgm2",
        "driveline.tyre_nm_rad",
        "driveline.tyre_nms",
        "engine.first_order",
        "engine.main_order",
        "clutch.drag_nm",
        "air.valve_scatter_ms",
        "disc.judder_",
        "sleeve.correlation",
        "sleeve.stiction_",
        "hall.load_runout_mm",
        "pressure.",
        "disturbance.",
    ),
    ("driveline.tyre_relaxation_m", "drag.propeller_nm"),
    ("sleeve.static_factor", "sleeve.detent_mm", "sleeve.valve_"),
)
"""What was added later, in the order of its coming: all names that begin so. It is drawn last, so
that a seed still gives the same gearbox as before."""

RUN_LIMIT_BYTES: Final = 64 * 1024 * 1024
"""Of a run's JSON, all its shifts included."""


class AsBuiltError(TableError):
    """An as-built file that cannot be used; the message names file, key, found and allowed."""


class Parameter(NamedTuple):
    """A line of `truck.toml`, in its units."""

    name: str
    default: float
    deviation: float
    low: float
    high: float
    note: str


class AsBuiltChoice(NamedTuple):
    """What `--as-built` says: the profile, and the values that are fixed."""

    profile: Profile
    fixed: dict[str, float]


@cache
def parameters(profile: Profile = Profile.CLEAN) -> dict[str, Parameter]:
    """All parameters of a profile by name, `group.key`, in the order of `truck.toml`."""
    changed = {} if profile is Profile.CLEAN else dict(_lines(f"{profile}.toml"))
    found = {}
    for name, (default, deviation, low, high, note) in _lines("truck.toml"):
        default, deviation = changed.pop(name, (default, deviation))
        found[name] = Parameter(name, default, deviation, low, high, note)
    return found


def _lines(file: str) -> list[tuple[str, list[Any]]]:
    with resources.as_file(resources.files("meshpoint.rig_sim.truck") / file) as path:
        tables = load_toml(path)
    return [
        (f"{group}.{key}", line) for group, table in tables.items() for key, line in table.items()
    ]


@cache
def _in_order_of_drawing(profile: Profile) -> tuple[tuple[Parameter, ...], tuple[Parameter, ...]]:
    """What is drawn before the teeth's seed, and what after it."""
    known = parameters(profile)
    later = [p for names in LATER for name, p in known.items() if name.startswith(names)]
    first = [p for p in known.values() if p not in later]
    return tuple(first), tuple(later)


@dataclass(frozen=True)
class AsBuilt:
    """The values of one gearbox by name, in the units of `truck.toml`, and its teeth's seed."""

    values: Mapping[str, float]
    teeth_seed: int
    profile: Profile = DEFAULT_PROFILE

    def __getitem__(self, name: str) -> float:
        """The value of a parameter. KeyError where there is none of that name."""
        return self.values[name]

    def changed(self, values: Mapping[str, float]) -> AsBuilt:
        """The same gearbox at work in other conditions: these values by name."""
        return replace(self, values={**self.values, **values})

    def to_json(self) -> dict[str, Any]:
        """The profile and groups of numbers, as in a run's JSON and as `--as-built` reads them."""
        tables: dict[str, Any] = {"profile": self.profile, "teeth": {"seed": self.teeth_seed}}
        for name, value in self.values.items():
            group, _, key = name.partition(".")
            tables.setdefault(group, {})[key] = value
        return tables


def draw_as_built(
    seed: int, fixed: Mapping[str, float] | None = None, profile: Profile = DEFAULT_PROFILE
) -> AsBuilt:
    """The gearbox of a seed. Everything is drawn, whatever is fixed, so runs stay comparable."""
    rng = np.random.Generator(np.random.PCG64([seed, AS_BUILT_STREAM]))
    first, later = _in_order_of_drawing(profile)
    values = {parameter.name: _drawn(rng, parameter) for parameter in first}
    teeth_seed = int(rng.integers(1 << 31))
    values |= {parameter.name: _drawn(rng, parameter) for parameter in later}
    values = {name: values[name] for name in parameters(profile)}
    fixed = dict(fixed or {})
    teeth_seed = int(fixed.pop("teeth.seed", teeth_seed))
    return AsBuilt(values | fixed, teeth_seed, profile)


def _drawn(rng: np.random.Generator, parameter: Parameter) -> float:
    drawn = parameter.default + parameter.deviation * float(rng.uniform(-1.0, 1.0))
    return float(f"{min(max(drawn, parameter.low), parameter.high):.6g}")


def nominal(profile: Profile = Profile.CLEAN) -> dict[str, float]:
    """Every parameter at its default: a gearbox of the profile without deviations."""
    return {name: float(parameter.default) for name, parameter in parameters(profile).items()}


def read_as_built(given: Path) -> AsBuiltChoice:
    """What `--as-built` says: the name of a profile or a file. AsBuiltError names what is wrong."""
    if str(given) in tuple(Profile):
        return AsBuiltChoice(Profile(str(given)), {})
    if not given.exists():
        known = ", ".join(Profile)
        raise AsBuiltError(
            f"{given}: no such file, and no profile of that name; profiles are {known}"
        )
    return load_as_built(given)


def as_built_of(values: Mapping[str, float | str]) -> AsBuiltChoice:
    """The same of values by name, as `clutch.drag_nm`; `profile` names the profile of the rest.
    AsBuiltError names key and allowed."""
    given, where = dict(values), Path("as_built")
    profile = _profile(where, given.pop("profile", None))
    return AsBuiltChoice(profile, {name: _checked(where, name, given[name]) for name in given})


def load_as_built(path: Path) -> AsBuiltChoice:
    """The profile and the values a file fixes, TOML or a run's JSON. AsBuiltError names file, key
    and allowed."""
    tables = _read(path)
    profile = _profile(path, tables.pop("profile", None))
    fixed: dict[str, float] = {}
    for group, table in tables.items():
        if not isinstance(table, dict):
            raise AsBuiltError(f"{path}: {group} = {table!r}, allowed is a table")
        if group not in _groups():
            raise AsBuiltError(f"{path}: unknown table [{group}], allowed are {_known_groups()}")
        for key, value in table.items():
            name = f"{group}.{key}"
            fixed[name] = _checked(path, name, value)
    return AsBuiltChoice(profile, fixed)


def _profile(path: Path, name: Any) -> Profile:
    """A run's JSON of before there were profiles has none: it is a clean gearbox."""
    if name is None:
        return Profile.CLEAN if path.suffix == ".json" else DEFAULT_PROFILE
    if name not in tuple(Profile):
        allowed = ", ".join(Profile)
        raise AsBuiltError(f"{path}: profile = {name!r}, allowed are {allowed}")
    return Profile(name)


def linear() -> dict[str, float]:
    """The as-built values that switch every non-linearity off (`linear.toml`)."""
    with resources.as_file(resources.files("meshpoint.rig_sim.truck") / "linear.toml") as path:
        return load_as_built(path).fixed


def _read(path: Path) -> dict[str, Any]:
    if path.suffix != ".json":
        try:
            return load_toml(path)
        except TableError as error:
            raise AsBuiltError(str(error)) from error
    try:
        values = json.loads(read_text(path, RUN_LIMIT_BYTES))
    except (ValueError, RecursionError) as error:
        raise AsBuiltError(f"{path}: cannot be read as JSON: {error}") from error
    found = values.get("as_built", values) if isinstance(values, dict) else None
    if not isinstance(found, dict):
        raise AsBuiltError(f"{path}: found no object of groups")
    return found


def _groups() -> set[str]:
    return {"teeth"} | {name.partition(".")[0] for name in parameters()}


def _known_groups() -> str:
    return ", ".join(sorted(_groups()))


def _checked(path: Path, name: str, value: Any) -> float:
    low, high = 0.0, float((1 << 31) - 1)
    if name != "teeth.seed":
        parameter = parameters().get(name)
        if parameter is None:
            raise AsBuiltError(
                f"{path}: unknown key '{name}'; groups are {_known_groups()}, "
                "their keys are in `meshpoint rig --describe`"
            )
        low, high = parameter.low, parameter.high
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (is_number and math.isfinite(value) and low <= value <= high):
        raise AsBuiltError(f"{path}: {name} = {value!r}, allowed is a number {low:g}..{high:g}")
    return float(value)


def as_built_sheet(sheet: GearboxSheet, built: AsBuilt) -> GearboxSheet:
    """The data sheet with the factors of group `sheet` applied: the real values of this gearbox."""
    factor = {key.partition(".")[2]: v for key, v in built.values.items() if "sheet." in key}
    shafts, brake, clutch, dog = sheet.shafts, sheet.brake, sheet.clutch, sheet.dog
    return replace(
        sheet,
        shafts=replace(
            shafts,
            layshaft_inertia_kgm2=shafts.layshaft_inertia_kgm2 * factor["layshaft_inertia_factor"],
            input_inertia_kgm2=shafts.input_inertia_kgm2 * factor["input_inertia_factor"],
            friction_nms=shafts.friction_nms * factor["friction_factor"],
        ),
        brake=replace(
            brake,
            max_torque_nm=brake.max_torque_nm * factor["brake_torque_factor"],
            valve_delay_s=brake.valve_delay_s * factor["brake_valve_delay_factor"],
            time_constant_s=brake.time_constant_s * factor["brake_lag_factor"],
        ),
        clutch=replace(
            clutch,
            open_delay_s=clutch.open_delay_s * factor["clutch_open_factor"],
            close_delay_s=clutch.close_delay_s * factor["clutch_close_factor"],
        ),
        dog=replace(dog, backlash_share=dog.backlash_share * factor["backlash_factor"]),
        splitter=_as_built_splitter(sheet.splitter, factor["backlash_factor"]),
    )


def _as_built_splitter(splitter: Splitter, backlash_factor: float) -> Splitter:
    """Teeth of its own as worn as those of the main box."""
    if splitter.dog is None:
        return splitter
    worn = splitter.dog.backlash_share * backlash_factor
    return replace(splitter, dog=replace(splitter.dog, backlash_share=worn))
