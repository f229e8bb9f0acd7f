"""Compiled kernels come with the wheel, or are kept on disk, once for all copies of meshpoint that
a user has.

numba's own cache looks at the file of the cached function alone, so a change in a piece from
another file would go unseen, and one damaged index ends every command. Here the name of an entry
holds a digest of the function, of every piece and constant that it refers to, of its signature and
of what else decides on machine code (`MACHINE_CODE`). Where entries lie, and which are taken:
`meshpoint.kernels.folder`. What is not taken is compiled again, and said in one line.

Loads numba: only where kernels are compiled at all.
"""

# numba is typed only in part.
# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

import enum
import hashlib
import pickle
import sysconfig
import types
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numba
import numpy as np
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic
from numba.core.registry import cpu_target
from numba.core.serialize import dumps

from meshpoint.kernels.folder import (
    ENTRY,
    KernelFolder,
    UnusableEntryError,
    kernel_folders,
    shipped,
)
from meshpoint.kernels.target import LEVEL
from meshpoint.kernels.watch import WATCH

STABLE_MODULES: Final = frozenset({"math", "cmath", "operator", "numpy", "numba"})
"""Modules that change with their version alone."""
PLAIN: Final = (bool, int, float, complex, str, bytes, type(None), type(...), np.generic, np.dtype)

_config: Any = numba.core.config
MACHINE_CODE: Final = (
    numba.__version__, version("llvmlite"), np.__version__,
    sysconfig.get_config_var("EXT_SUFFIX"),
    LEVEL, _config.BOUNDSCHECK, _config.DEBUGINFO_DEFAULT,
    _config.LOOP_VECTORIZE, _config.SLP_VECTORIZE,
)  # fmt: skip
"""What decides on machine code beside the kernel and the processor: the compiler, numpy, whose
arrays it works on, the Python it is called from, and NUMBA_... variables."""


def machine() -> tuple[Any, ...]:
    """All that decides on machine code beside the kernel."""
    return (*cpu_target.target_context.codegen().magic_tuple(), *MACHINE_CODE)


def keep_compiled(kernel: Any) -> None:
    """Gives a dispatcher of numba this cache."""
    kernel._cache = KernelCache(kernel, kernel_folders())  # noqa: SLF001  # numba has no other way


class KernelCache(FunctionCache):
    """What numba asks for compiled code and hands it to."""

    def __init__(self, kernel: Any, folders: Sequence[KernelFolder]) -> None:
        function = kernel.py_func
        path = function.__module__.removeprefix("meshpoint.")
        self._py_func = function
        self._options = kernel.targetoptions
        self._package = path.split(".")[0]
        self._title = f"{path}.{function.__name__}"
        self._impl = _Result(function)
        self._folders = folders
        self._name, self._cache_path = repr(function), str(folders[0].path)
        self._digest: str | None = None
        self.enable()

    def flush(self) -> None:
        """Nothing is kept that could be out of date."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What was compiled before, or None: numba then compiles it."""
        target_context.refresh()
        if not self._enabled:
            return None
        entry = self._entry(sig)
        content = shipped(entry) or self._kept(entry)
        if content is None:
            WATCH.compiling(self._package)
            return None
        WATCH.taken(entry, content)
        # Ours: neither the wheel nor KernelFolder holds what another user could have written.
        return self._impl.rebuild(target_context, pickle.loads(content))  # noqa: S301

    def _kept(self, entry: str) -> bytes | None:
        """What was compiled on this machine."""
        refused = ""
        for folder in self._folders:
            try:
                content = folder.read(entry)
            except OSError as error:
                refused = refused or _refusal(folder, error)
                continue
            except UnusableEntryError as reason:
                WATCH.once(f"compiled kernels in {folder.path} are {reason} and compiled again")
                folder.remove(entry)
                continue
            if content is not None:
                _say_where(folder, refused)
                return content
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keeps it in the first folder that takes it."""
        if not self._enabled or not self._impl.check_cachable(data):
            return
        entry, content = self._entry(sig), dumps(self._impl.reduce(data))
        WATCH.taken(entry, content)
        refused = ""
        for folder in self._folders:
            try:
                folder.write(entry, content)
            except OSError as error:
                refused = refused or _refusal(folder, error)
                continue
            _say_where(folder, refused)
            return
        WATCH.once(
            f"compiled kernels cannot be kept, every start compiles them again ({refused}); "
            "NUMBA_CACHE_DIR may name a folder that can be written"
        )

    def _entry(self, sig: Any) -> str:
        """The name of the file."""
        if self._digest is None:
            # Not before the first call: then everything that the function refers to exists.
            self._digest = digest_of(self._py_func)
        about = (self._digest, repr(sig), sorted(self._options.items()), machine())
        return f"{self._title}-{hashlib.sha256(repr(about).encode()).hexdigest()[:24]}{ENTRY}"


def _refusal(folder: KernelFolder, error: OSError) -> str:
    return f"{folder.path}: {error.strerror or error}"


def _say_where(folder: KernelFolder, refused: str) -> None:
    """Once in a process, where kernels are not kept where they should be."""
    if refused:
        WATCH.once(f"compiled kernels are kept in {folder.path} ({refused})")


class _Place(_CacheLocator):
    """Numba wants to be given a place; `KernelCache` knows its own."""

    def get_cache_path(self) -> str:
        return ""

    def get_source_stamp(self) -> str:
        return ""

    def get_disambiguator(self) -> str:
        return ""

    _py_file: str

    @classmethod
    def from_function(cls, _py_func: Any, py_file: str) -> _Place:
        place = cls()
        place._py_file = py_file
        return place


class _Result(CompileResultCacheImpl):
    """How a compiled function becomes bytes, and back: as numba does it."""

    _locator_classes: list[Any] = [_Place]  # noqa: RUF012 (numba's own)


def digest_of(function: Any) -> str:
    """A digest that changes with the function's code and with everything it refers to: pieces and
    what they refer to, constants, closures. TypeError for what cannot be followed."""
    hashed = hashlib.sha256()
    _feed(hashed.update, function, set())
    return hashed.hexdigest()


def _feed(put: Callable[[bytes], None], value: Any, seen: set[types.FunctionType]) -> None:
    if isinstance(value, PLAIN):
        put(f"{type(value).__name__} {value!r};".encode())
        return
    put(f"{type(value).__name__} ".encode())
    if isinstance(value, Dispatcher):
        put(repr(sorted(value.targetoptions.items())).encode())
        _feed(put, value.py_func, seen)
    elif isinstance(value, _Intrinsic):
        _feed(put, value._defn, seen)  # noqa: SLF001  # numba has no other way
    elif isinstance(value, types.FunctionType):
        if value not in seen:
            seen.add(value)
            _feed_function(put, value, seen)
    elif isinstance(value, types.CodeType):
        put(value.co_code)
        _feed(put, (value.co_consts, value.co_names, value.co_varnames), seen)
    elif isinstance(value, (tuple, list)):
        put(f"{len(value)} ".encode())
        for each in value:
            _feed(put, each, seen)
    elif isinstance(value, np.ndarray):
        put(f"{value.dtype} {value.shape} ".encode() + value.tobytes())
    elif isinstance(value, types.ModuleType):
        _feed_module(put, value)
    else:
        put(f"{_named(value)};".encode())


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


def _feed_function(
    put: Callable[[bytes], None], function: types.FunctionType, seen: set[types.FunctionType]
) -> None:
    if _is_foreign(function):
        put(f"{function.__module__}.{function.__qualname__};".encode())
        return
    _feed(put, function.__code__, seen)
    _feed(put, function.__defaults__ or (), seen)
    for cell in function.__closure__ or ():
        _feed(put, cell.cell_contents, seen)
    for name in sorted(_names(function.__code__)):
        if name in function.__globals__:
            put(f"{name}=".encode())
            _feed(put, function.__globals__[name], seen)


def _names(code: types.CodeType) -> set[str]:
    inner = (_names(each) for each in code.co_consts if isinstance(each, types.CodeType))
    return set(code.co_names).union(*inner)


def _feed_module(put: Callable[[bytes], None], module: types.ModuleType) -> None:
    """A foreign module by its name; one of ours with its whole source."""
    put(f"{module.__name__};".encode())
    source = getattr(module, "__file__", None)
    if module.__name__.split(".")[0] not in STABLE_MODULES and source is not None:
        put(Path(source).read_bytes())
