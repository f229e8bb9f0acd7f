"""Digests by which compiled kernels are named: of a function and all that it refers to.

Loads numba: only where kernels are compiled at all.
"""

# numba is typed only in part.
# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

import enum
import functools
import hashlib
import importlib
import types
from pathlib import Path
from typing import Any, Final

import numba
import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic

STABLE_MODULES: Final = frozenset({"math", "cmath", "operator", "numpy", "numba"})
"""Modules that change with their version alone."""
PLAIN: Final = (bool, int, float, complex, str, bytes, type(None), type(...), np.generic, np.dtype)
PACKAGE: Final = __name__.split(".")[0]
SHARED: Final = (f"{PACKAGE}.gearbox", f"{PACKAGE}.kernels", f"{PACKAGE}.units")
"""What kernels of both sides are written in beside their own package."""


def digest_of(function: Any) -> str:
    """A digest that changes with the function's code and with everything it refers to: pieces and
    what they refer to, constants, closures. TypeError for what cannot be followed."""
    return _Digest().of(function)


def digest_by_source(function: Any) -> str:
    """One that every Python makes of the same files: for what is written in this package their
    content stands for the code. It changes with any file of the kernel's side."""
    if not function.__module__.startswith(f"{PACKAGE}."):
        return digest_of(function)
    side = ".".join(function.__module__.split(".")[:2])
    return _Digest((side, *SHARED)).of(function, sources_of(side))


@functools.cache
def sources_of(side: str) -> str:
    """A digest of all files that kernels of this package are written in."""
    hashed = hashlib.sha256()
    for name in (side, *SHARED):
        found = importlib.import_module(name)
        package = Path(str(found.__file__))
        files = package.parent.rglob("*.py") if hasattr(found, "__path__") else [package]
        for path in sorted(files):
            hashed.update(path.name.encode() + path.read_bytes())
    return hashed.hexdigest()


class _Digest:
    """What goes into one."""

    def __init__(self, by_source: tuple[str, ...] = ()) -> None:
        """by_source: packages whose functions are known by their files."""
        self._by_source = frozenset(by_source)
        self._hashed = hashlib.sha256()
        self._seen: set[types.FunctionType] = set()

    def of(self, function: Any, sources: str = "") -> str:
        """Of a function and these sources."""
        self._put(sources)
        self._feed(function)
        return self._hashed.hexdigest()

    def _put(self, text: str) -> None:
        self._hashed.update(text.encode())

    def _feed(self, value: Any) -> None:
        if isinstance(value, PLAIN):
            self._put(f"{type(value).__name__} {value!r};")
            return
        self._put(f"{type(value).__name__} ")
        if isinstance(value, Dispatcher):
            self._put(repr(sorted(value.targetoptions.items())))
            self._feed(value.py_func)
        elif isinstance(value, _Intrinsic):
            self._feed(value._defn)  # noqa: SLF001  # numba has no other way
        elif isinstance(value, types.FunctionType):
            if value not in self._seen:
                self._seen.add(value)
                self._feed_function(value)
        elif isinstance(value, types.CodeType):
            self._hashed.update(value.co_code)
            self._feed((value.co_consts, value.co_names, value.co_varnames))
        elif isinstance(value, (tuple, list)):
            self._put(f"{len(value)} ")
            for each in value:
                self._feed(each)
        elif isinstance(value, np.ndarray):
            self._put(f"{value.dtype} {value.shape} ")
            self._hashed.update(value.tobytes())
        elif isinstance(value, types.ModuleType):
            self._feed_module(value)
        else:
            self._put(f"{_named(value)};")

    def _feed_function(self, function: types.FunctionType) -> None:
        if _is_foreign(function):
            self._put(f"{function.__module__}.{function.__qualname__};")
            return
        # What is kept of a kernel imports the modules of its pieces by their names.
        self._put(f"{function.__module__} ")
        if not self._is_by_source(function.__module__):
            self._feed(function.__code__)
        self._feed(function.__defaults__ or ())
        for cell in function.__closure__ or ():
            self._feed(cell.cell_contents)
        for name in sorted(_names(function.__code__)):
            if name in function.__globals__:
                self._put(f"{name}=")
                self._feed(function.__globals__[name])

    def _is_by_source(self, module: str) -> bool:
        return ".".join(module.split(".")[:2]) in self._by_source

    def _feed_module(self, module: types.ModuleType) -> None:
        """A foreign module by its name; one of ours with its whole source."""
        self._put(f"{module.__name__};")
        source = getattr(module, "__file__", None)
        if module.__name__.split(".")[0] not in STABLE_MODULES and source is not None:
            self._hashed.update(Path(source).read_bytes())


def _named(value: Any) -> str:
    """What is known by its name: a class, a type of numba's, a function of a foreign module."""
    if isinstance(value, numba.types.Type | np.ufunc):
        return repr(value)
    if isinstance(value, type):
        fields = list(value) if issubclass(value, enum.Enum) else getattr(value, "_fields", ())
        return f"{value.__module__}.{value.__qualname__} {fields!r}"
    if isinstance(value, types.BuiltinFunctionType) or _is_foreign(value):
        return str(value.__qualname__)
    raise TypeError(f"a kernel refers to {value!r}, whose changes nobody would see")


def _is_foreign(value: Any) -> bool:
    return getattr(value, "__module__", "").split(".")[0] in STABLE_MODULES and hasattr(
        value, "__qualname__"
    )


def _names(code: types.CodeType) -> set[str]:
    inner = (_names(each) for each in code.co_consts if isinstance(each, types.CodeType))
    return set(code.co_names).union(*inner)
