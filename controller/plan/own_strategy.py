"""A strategy that a user has written, behind checks.

Whatever it raises, and whatever it returns that cannot be used, becomes a StrategyError that names
the user's file and line. The sequence then switches all valves off and ends the shift with a fault.
What is not caught: a strategy that never returns stops the node, and its valves expire by
themselves.
"""

from __future__ import annotations

import math
import sys
import types
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final

from meshpoint.controller.plan.gear_predictor import GearPredictor
from meshpoint.controller.plan.strategy import LATEST_RELEASE_US, ReleasePlan
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.settings.strategy_file import (
    StrategyError,
    StrategyFile,
    read_source,
    sha256_of,
    split_name,
)
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.kinematics import wrap_to_pitch

METHODS: Final = ("release", "contact")
LATEST_CONTACT_US: Final = 1_000_000
"""No contact is planned further ahead than this."""
MOST_SLIP_RAD_S: Final = 100.0
"""`fire_slip_rad_s` at most, to either side of zero: some 950 rpm."""
MESSAGE_LIMIT: Final = 200


class OwnStrategy:
    """A user's class as an `EngagementStrategy`."""

    def __init__(
        self, file: StrategyFile, sheet: GearboxSheet, settings: ControllerSettings
    ) -> None:
        if file.source is None:
            raise StrategyError(f"{file.name}: its file has not been read")
        self._file, self._dog = file, sheet.dog
        made = _load(file.name, file.source)
        self._strategy: Any = _guarded(file.path, made, made, sheet, settings)
        self.aims = file.aims
        self.fire_slip_rad_s = self._slip(made)

    def _slip(self, made: type) -> float:
        found = _guarded(self._file.path, made, getattr, self._strategy, "fire_slip_rad_s")
        where, what = _place_of(self._file.path, made), "fire_slip_rad_s"
        return _number(where, what, found, -MOST_SLIP_RAD_S, MOST_SLIP_RAD_S)

    def release(self, predictor: GearPredictor, now_us: int, earliest_us: int) -> ReleasePlan:
        """The user's release, checked."""
        method, found = self._asked("release", predictor, now_us, earliest_us)
        where = _place_of(self._file.path, method)
        if not isinstance(found, tuple) or len(found) != 2:
            raise StrategyError(
                f"{where}: release() returned {_short(found)}, allowed are two times: "
                "(release_us, contact_us)"
            )
        last_us = earliest_us + LATEST_RELEASE_US
        release_us = _number(where, "release() release_us", found[0], earliest_us, last_us)
        last_us += LATEST_CONTACT_US
        contact_us = _number(where, "release() contact_us", found[1], earliest_us, last_us)
        return ReleasePlan(round(release_us), round(contact_us))

    def contact(self, predictor: GearPredictor, now_us: int, earliest_us: int) -> int | None:
        """The user's contact, checked."""
        method, found = self._asked("contact", predictor, now_us, earliest_us)
        if found is None:
            return None
        first_us = earliest_us + predictor.delay_us
        where, last_us = _place_of(self._file.path, method), first_us + LATEST_CONTACT_US
        return round(_number(where, "contact()", found, first_us, last_us))

    def is_to_go_back(
        self, predictor: GearPredictor, now_us: int, contact_us: int, earliest_us: int
    ) -> bool:
        """Where the gap that was aimed at is missed by what is known now, and the user's next
        contact meets one."""
        if self._meets(predictor, contact_us):
            return False
        again_us = self.contact(predictor, now_us, earliest_us)
        return again_us is not None and self._meets(predictor, again_us)

    def _meets(self, predictor: GearPredictor, contact_us: int) -> bool:
        """Whether a contact is predicted to meet a gap."""
        phase, _ = predictor.phase_and_slip(contact_us)
        return abs(wrap_to_pitch(phase, self._dog.pitch_rad)) <= 0.5 * self._dog.backlash_rad

    def _asked(
        self, name: str, predictor: GearPredictor, now_us: int, earliest_us: int
    ) -> tuple[Any, Any]:
        path = self._file.path
        method = _guarded(path, type(self._strategy), getattr, self._strategy, name)
        return method, _guarded(path, method, method, predictor, now_us, earliest_us)


def read_strategy(name: str) -> StrategyFile:
    """Reads the file in FILE.py:CLASS and runs it. TableError where it cannot be read,
    StrategyError where it has no such class or the class lacks something."""
    source = read_source(name)
    made = _load(name, source)
    path, class_name = split_name(name)
    where = _place_of(path, made)
    for method in METHODS:
        if not callable(getattr(made, method, None)):
            raise StrategyError(f"{where}: class {class_name} has no method {method}()")
    aims = getattr(made, "aims", None)
    if not isinstance(aims, bool):
        raise StrategyError(
            f"{where}: class {class_name} has aims = {_short(aims)}, allowed is True or False"
        )
    return StrategyFile(name, sha256_of(source), aims, source)


@lru_cache(maxsize=64)
def _load(name: str, source: bytes) -> type:
    """The user's class; the file is run once a process."""
    path, class_name = split_name(name)
    module = types.ModuleType(f"own_strategy_{sha256_of(source)[:16]}")
    module.__file__ = path
    sys.modules[module.__name__] = module  # where dataclasses look names up
    try:
        code = compile(source, path, "exec")
    except (SyntaxError, ValueError) as error:
        line = getattr(error, "lineno", None) or 1
        raise StrategyError(f"{path}:{line}: {type(error).__name__}: {_short(error)}") from error
    _guarded(path, None, exec, code, module.__dict__)
    made = getattr(module, class_name, None)
    if not isinstance(made, type):
        raise StrategyError(f"{path}:1: there is no class {class_name} in it")
    return made


def _guarded(path: str, called: Any, call: Callable[..., Any], *arguments: Any) -> Any:
    """`call(*arguments)`; what it raises becomes a StrategyError. Where no line of the user's file
    was running, as when a method wants other arguments, the line is that of `called`."""
    try:
        return call(*arguments)
    except (Exception, SystemExit) as error:
        where, frame = None, error.__traceback__
        while frame is not None:
            if frame.tb_frame.f_code.co_filename == path:
                where = f"{path}:{frame.tb_lineno}"
            frame = frame.tb_next
        where = where or _place_of(path, called)
        raise StrategyError(f"{where}: {type(error).__name__}: {_short(error)}") from error


def _place_of(path: str, called: Any) -> str:
    """File and line of a function, or of a class by the first of its functions."""
    functions = [called, *vars(called).values()] if isinstance(called, type) else [called]
    for function in functions:
        code = getattr(function, "__code__", None)
        if isinstance(code, types.CodeType) and code.co_filename == path:
            return f"{path}:{code.co_firstlineno}"
    return f"{path}:1"


def _number(where: str, what: str, value: Any, low: float, high: float) -> float:
    """A finite number within its range. StrategyError names both."""
    try:
        number = math.nan if isinstance(value, (bool, str)) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not low <= number <= high:
        raise StrategyError(
            f"{where}: {what} is {_short(value)}, allowed is a number from {low:g} to {high:g}"
            if isinstance(low, float)
            else f"{where}: {what} is {_short(value)}, allowed is a time from {low} to {high} us"
        )
    return number


def _short(value: object) -> str:
    """One line of what may be anything, even an object that cannot be shown."""
    try:
        shown = str(value) if isinstance(value, BaseException) else repr(value)
    except Exception:  # noqa: BLE001  # the user's own __repr__
        shown = f"a {type(value).__name__}"
    return shown.splitlines()[0][:MESSAGE_LIMIT] if shown else ""
