"""Counting the operations of the product's code: numbers that count what is done with them.

A time in microseconds says something of one machine on one day; a count is the same everywhere.
"""

from __future__ import annotations

import types
from collections.abc import Callable
from typing import Any


class Counter:
    """How many operations were done: + - * / and negation, and functions such as exp."""

    def __init__(self) -> None:
        self.arithmetic = 0
        self.functions = 0

    def number(self, value: float) -> Counted:
        """A number that counts here."""
        return Counted(value, self)


class Counted:
    """A float that counts. `math.exp` and its like ask for `__float__`, which counts as one."""

    def __init__(self, value: float, counter: Counter) -> None:
        self.value = value
        self._counter = counter

    def _new(self, value: float) -> Counted:
        self._counter.arithmetic += 1
        return Counted(value, self._counter)

    def __add__(self, other: Any) -> Counted:
        return self._new(self.value + _plain(other))

    def __sub__(self, other: Any) -> Counted:
        return self._new(self.value - _plain(other))

    def __rsub__(self, other: Any) -> Counted:
        return self._new(_plain(other) - self.value)

    def __mul__(self, other: Any) -> Counted:
        return self._new(self.value * _plain(other))

    def __truediv__(self, other: Any) -> Counted:
        return self._new(self.value / _plain(other))

    def __rtruediv__(self, other: Any) -> Counted:
        return self._new(_plain(other) / self.value)

    __radd__ = __add__
    __rmul__ = __mul__

    def __neg__(self) -> Counted:
        return self._new(-self.value)

    def __abs__(self) -> Counted:
        return Counted(abs(self.value), self._counter)

    def __lt__(self, other: Any) -> bool:
        return self.value < float(_plain(other))

    def __gt__(self, other: Any) -> bool:
        return self.value > float(_plain(other))

    def __float__(self) -> float:
        self._counter.functions += 1
        return self.value


def _plain(other: Any) -> Any:
    return other.value if isinstance(other, Counted) else other


def plain_code(kernel: Callable[..., Any], **names: Any) -> Callable[..., Any]:
    """A compiled kernel as plain Python, calling `names` in the place of kernels of its own."""
    function = getattr(kernel, "py_func", kernel)
    scope = {**function.__globals__, **names}
    return types.FunctionType(function.__code__, scope, function.__name__)
