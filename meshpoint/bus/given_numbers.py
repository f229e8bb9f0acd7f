"""argparse types of numbers. Every number on a command line goes through one of them: what is no
number, no finite one, or out of range ends the command with what is allowed."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import Final

LONGEST_S: Final = 1e8
"""Three years: no command waits longer, and every clock can add it."""


def whole(low: int, high: int) -> Callable[[str], int]:
    """A whole number from `low` to `high`."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(
                f"{text!r}, allowed is a whole number from {low} to {high}"
            )
        return value

    return parse


def number(low: float = -math.inf, high: float = math.inf) -> Callable[[str], float]:
    """A finite number from `low` to `high`."""

    def parse(text: str) -> float:
        value = _value(text)
        if not (math.isfinite(value) and low <= value <= high):
            raise argparse.ArgumentTypeError(f"{text!r}, allowed is {_allowed(low, high)}")
        return value

    return parse


def percent(low: float, high: float) -> Callable[[str], float]:
    """Per cent from `low` to `high`, as a share."""

    def parse(text: str) -> float:
        value = _value(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r}, allowed are {low:g} to {high:g} per cent")
        return value / 100.0

    return parse


speed = number(1e-3, 1e3)
"""How many times as fast as the wall clock."""


def seconds(text: str) -> float:
    """A time to wait, 0 s or longer."""
    value = _value(text)
    if not 0.0 <= value <= LONGEST_S:
        raise argparse.ArgumentTypeError(f"{text!r}, allowed are 0 to {LONGEST_S:g} seconds")
    return value


def some_seconds(text: str) -> float:
    """A time to wait, longer than 0 s."""
    value = _value(text)
    if not 0.0 < value <= LONGEST_S:
        raise argparse.ArgumentTypeError(
            f"{text!r}, allowed are more than 0 and up to {LONGEST_S:g} seconds"
        )
    return value


def _value(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _allowed(low: float, high: float) -> str:
    if math.isfinite(high):
        return f"a number from {low:g} to {high:g}"
    return f"a finite number, {low:g} or more" if math.isfinite(low) else "a finite number"
