"""The numbers that a package's sources fix: what controller and rig each take as given.

Read from the sources themselves: numbers assigned to names or fields, defaults of settings, and the
default and deviation of every as-built parameter. A number counts in SI, by the unit in its name:
`lash_deg` of 2.0 and `slack_rad` of 0.0349 are the same number, `near_hz` of 20 and `drag_nm` of 20
are not. One is alike where the names have a word in common, as `lash` is in `backlash`, or where it
has two digits or more in its unit: round numbers meet by chance, 0.28 hardly does.
"""

from __future__ import annotations

import ast
import math
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

from meshpoint import units

UNITS: Final = {
    "deg": ("rad", units.DEG),
    "rad": ("rad", 1.0),
    "turn": ("rad", units.TURN),
    "rpm": ("rad_s", units.RPM),
    "rad_s": ("rad_s", 1.0),
    "rad_s2": ("rad_s2", 1.0),
    "us": ("s", units.US),
    "ms": ("s", units.MS),
    "s": ("s", 1.0),
    "mm": ("m", units.MM),
    "m": ("m", 1.0),
    "bar": ("pa", units.BAR),
    "pa": ("pa", 1.0),
    "percent": ("", 0.01),
    "share": ("", 1.0),
    "nm": ("nm", 1.0),
    "nms": ("nms", 1.0),
    "m_s": ("m_s", 1.0),
    "nm_s": ("nm_s", 1.0),
    "per_s": ("per_s", 1.0),
    "per_k": ("per_k", 1.0),
    "nm_rad": ("nm_rad", 1.0),
    "kg": ("kg", 1.0),
    "kgm2": ("kgm2", 1.0),
    "hz": ("hz", 1.0),
    "j": ("j", 1.0),
    "n": ("n", 1.0),
}
"""Units as names end with them: dimension, and their value in SI."""
SETTINGS: Final = ("quantity", "count")
WITH_SCALE: Final = 4
"""What declares a setting: key, limits and scale; with a scale its default is in SI."""
KNOWN: Final = {name: value for name, value in vars(units).items() if name.isupper()}
KNOWN |= {"math.pi": math.pi}


class Constant(NamedTuple):
    """A number that a source fixes."""

    dimension: str
    """The SI unit, empty for what has none or does not say it."""
    value: float
    where: str
    """File and name."""


def unit_of(name: str) -> tuple[str, float]:
    """Dimension and SI value of the unit a name ends with."""
    words = name.lower().split("_")
    for length in (2, 1):
        ending = "_".join(words[-length:])
        if len(words) > length and ending in UNITS:
            return UNITS[ending]
    return "", 1.0


def number(node: ast.expr) -> float | None:
    """The value of an expression of literals and units; None for any other."""
    if isinstance(node, ast.Constant):
        is_number = isinstance(node.value, (int, float)) and not isinstance(node.value, bool)
        return float(node.value) if is_number else None
    if isinstance(node, (ast.Name, ast.Attribute)):
        return KNOWN.get(ast.unparse(node))
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        inner = number(node.operand)
        return None if inner is None else -inner
    if isinstance(node, ast.BinOp):
        left, right = number(node.left), number(node.right)
        if left is None or right is None:
            return None
        if isinstance(node.op, ast.Mult):
            return left * right
        if isinstance(node.op, ast.Div) and right:
            return left / right
        if isinstance(node.op, ast.Pow):
            return float(left**right)
    return None


def numbers(node: ast.expr) -> Iterator[float]:
    """The values of an expression, those of a tuple one by one."""
    parts = node.elts if isinstance(node, (ast.Tuple, ast.List)) else [node]
    for part in parts:
        value = number(part)
        if value is not None:
            yield value


def setting(call: ast.Call) -> Iterator[tuple[str, float, bool]]:
    """Key, default, and whether that is in SI, of a setting that has one."""
    made = call.func.id if isinstance(call.func, ast.Name) else ""
    key = call.args[0] if call.args else None
    if made in SETTINGS and isinstance(key, ast.Constant):
        for keyword in call.keywords:
            if keyword.arg == "default" and (value := number(keyword.value)) is not None:
                yield str(key.value), value, len(call.args) == WITH_SCALE


def in_source(path: Path) -> Iterator[Constant]:
    """The constants of a Python file."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        targets = node.targets if isinstance(node, ast.Assign) else []
        if isinstance(node, ast.AnnAssign):
            targets = [node.target]
        for target in targets:
            value = node.value  # type: ignore[union-attr]
            if not isinstance(target, (ast.Name, ast.Attribute)) or value is None:
                continue
            name = target.id if isinstance(target, ast.Name) else target.attr
            where = f"{path.name}: {name}"
            if isinstance(value, ast.Call):
                for key, found, is_si in setting(value):
                    dimension, scale = unit_of(key)
                    yield Constant(dimension, found if is_si else found * scale, where)
                continue
            dimension, scale = unit_of(name)
            for found in numbers(value):
                yield Constant(dimension, found * scale, where)


def in_table(path: Path) -> Iterator[Constant]:
    """Default and deviation of each as-built parameter of a TOML file."""
    for group, table in tomllib.loads(path.read_text(encoding="utf-8")).items():
        lines = table.items() if isinstance(table, dict) else ()
        for key, line in lines:
            dimension, scale = unit_of(f"{group}_{key}")
            for found in line[:2] if isinstance(line, list) else [line]:
                yield Constant(dimension, float(found) * scale, f"{path.name}: {group}.{key}")


@cache
def constants(folder: Path) -> dict[tuple[str, float], list[str]]:
    """All constants of a package: where each value of each dimension stands. Zero says nothing."""
    found: dict[tuple[str, float], list[str]] = defaultdict(list)
    for path in sorted(folder.rglob("*")):
        kind = {".py": in_source, ".toml": in_table}.get(path.suffix)
        if kind is None:
            continue
        for constant in kind(path):
            if constant.value != 0.0 and math.isfinite(constant.value):
                rounded = float(f"{abs(constant.value):.9g}")
                found[constant.dimension, rounded].append(constant.where)
    return found


FILLERS: Final = frozenset(
    ("first", "second", "main", "time", "factor", "limit", "start", "after", "least", "most")
)
"""Words of names that say nothing of what is measured."""
UNITS_OR_FILLERS: Final = FILLERS | set(UNITS)


def digits(value: float, dimension: str) -> int:
    """Significant digits, in the unit of the dimension that needs the fewest."""
    scales = {scale for name, scale in UNITS.values() if name == dimension} or {1.0}
    written = (f"{value / scale:.6e}".split("e")[0] for scale in scales)
    return min(len(mantissa.rstrip("0").replace(".", "")) for mantissa in written)


def subjects(where: str) -> set[str]:
    """The words of a name that say what is measured."""
    name = where.partition(": ")[2].lower().replace(".", "_")
    return {word for word in name.split("_") if len(word) >= 4 and word not in UNITS_OR_FILLERS}


def is_akin(one: str, other: str) -> bool:
    """Whether two names have a word in common, or one word within another."""
    mine, theirs = subjects(one), subjects(other)
    return any(a in b or b in a for a in mine for b in theirs)


def alike(one: Path, other: Path) -> dict[tuple[str, float], list[tuple[str, str]]]:
    """The numbers that two packages share, with the names on both sides that make them alike."""
    mine, theirs = constants(one), constants(other)
    found = {}
    for key in sorted(set(mine) & set(theirs)):
        dimension, value = key
        pairs = [(a, b) for a in mine[key] for b in theirs[key]]
        if digits(value, dimension) < 2:
            pairs = [pair for pair in pairs if is_akin(*pair)]
        if pairs:
            found[key] = pairs
    return found
