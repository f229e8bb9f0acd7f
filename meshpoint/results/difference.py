"""Where two sets of values differ: by path, with tolerances and what is left out."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any, Final, NamedTuple

ABSENT: Final = "(absent)"


class Difference(NamedTuple):
    """A value that differs; `ABSENT` where one side has none."""

    path: str
    a: Any
    b: Any

    @property
    def size(self) -> float | None:
        """How far numbers are apart; None for anything else."""
        if _is_number(self.a) and _is_number(self.b):
            return float(self.b) - float(self.a)
        return None


@dataclass(frozen=True)
class Allowed:
    """What counts as equal. Names are paths such as `shifts.3.slip_rpm` or patterns (`*slip_rpm`);
    in a tolerance or an ignored name the last part alone is enough."""

    tolerance: float = 0.0
    """Of numbers without one of their own, in their unit."""
    tolerances: Mapping[str, float] = field(default_factory=dict)
    ignored: tuple[str, ...] = ()

    def ignores(self, path: str) -> bool:
        """Whether a value is left out."""
        return any(_named(path, pattern) for pattern in self.ignored)

    def of(self, path: str) -> float:
        """The tolerance of a value."""
        for pattern, tolerance in self.tolerances.items():
            if _named(path, pattern):
                return tolerance
        return self.tolerance

    def equal(self, path: str, a: Any, b: Any) -> bool:
        """Whether two values count as equal."""
        if _is_number(a) and _is_number(b):
            a, b = float(a), float(b)
            return (math.isnan(a) and math.isnan(b)) or a == b or abs(a - b) <= self.of(path)
        return bool(a == b)


def differences(a: Any, b: Any, allowed: Allowed, path: str = "") -> Iterator[Difference]:
    """Every value that differs beyond what is allowed, in the order of the first."""
    if path and allowed.ignores(path):
        return
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in [*a, *(key for key in b if key not in a)]:
            below = f"{path}.{key}" if path else str(key)
            yield from differences(a.get(key, ABSENT), b.get(key, ABSENT), allowed, below)
    elif isinstance(a, list) and isinstance(b, list):
        for k in range(max(len(a), len(b))):
            left, right = (side[k] if k < len(side) else ABSENT for side in (a, b))
            yield from differences(left, right, allowed, f"{path}.{k}" if path else str(k))
    elif not allowed.equal(path, a, b):
        yield Difference(path, a, b)


def _named(path: str, pattern: str) -> bool:
    last = path.rsplit(".", 1)[-1]
    return fnmatchcase(path, pattern) or fnmatchcase(last, pattern)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
