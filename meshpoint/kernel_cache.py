"""Where compiled kernels are kept: one file each, named by all that its machine code depends on.

numba's own cache looks at the file of the cached function alone, so a change in a piece from
another file would go unseen, and one damaged index ends every command. Here the name of an entry
holds a digest of the function, of every piece and constant that it refers to, of its signature, of
numba, of LLVM's level and of the processor; the file ends with a digest of its content. What is
damaged is compiled again, and a folder that cannot be written is passed over for the user's own;
each is said in one line.

Loads numba: only where kernels are compiled at all.
"""

# numba is typed only in part.
# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

import enum
import hashlib
import os
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numba
import numpy as np
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    _CacheLocator,
)
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic

from meshpoint.kernel_level import LEVEL
from meshpoint.kernel_watch import WATCH

DIGEST_BYTES: Final = 32
STABLE_MODULES: Final = frozenset({"math", "cmath", "operator", "numpy", "numba"})
"""Modules that change with their version alone."""
numba_config: Any = numba.core.config
PLAIN: Final = (bool, int, float, complex, str, bytes, type(None), type(...), np.generic, np.dtype)


def keep_compiled(kernel: Any, beside: Path) -> None:
    """Gives a dispatcher of numba this cache; `beside` is the folder of its package."""
    kernel._cache = KernelCache(kernel, folders(beside))  # noqa: SLF001  # numba has no other way


def folders(beside: Path) -> tuple[Path, ...]:
    """Where kernels may be kept, the best first: in NUMBA_CACHE_DIR where that is set, else beside
    the sources, else in the user's cache folder."""
    given = numba_config.CACHE_DIR
    if given:
        return (Path(given) / beside.name,)
    cache = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    home = Path(cache or "~/.cache").expanduser()
    return beside / "__pycache__", home / "meshpoint" / beside.name


class KernelCache(FunctionCache):
    """What numba asks for compiled code and hands it to."""

    def __init__(self, kernel: Any, places: tuple[Path, ...]) -> None:
        function = kernel.py_func
        module = function.__module__.rsplit(".", 1)[-1]
        self._py_func = function
        self._options = kernel.targetoptions
        self._package = function.__module__.removeprefix("meshpoint.").split(".")[0]
        self._title = f"{module}.{function.__name__}"
        self._impl = _Result(function)
        self._files = [_Files(place, self._title) for place in places]
        self._name, self._cache_path = repr(function), str(places[0])
        self._digest: str | None = None
        self.enable()

    def flush(self) -> None:
        """Nothing is kept that could be out of date."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What was compiled before, or None: numba then compiles it."""
        target_context.refresh()
        if not self._enabled:
            return None
        key = self._index_key(sig, target_context.codegen())
        for files in self._files:
            data = files.load(key)
            if data is not None:
                return self._impl.rebuild(target_context, data)
        WATCH.compiling(self._package)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keeps it in the first folder that takes it."""
        if not self._enabled or not self._impl.check_cachable(data):
            return
        key, reduced = self._index_key(sig, data.codegen), self._impl.reduce(data)
        refused = ""
        for files in self._files:
            try:
                files.save(key, reduced)
            except OSError as error:
                refused = refused or f"{files.of_all}: {error.strerror or error}"
                continue
            if refused:
                WATCH.once(f"compiled kernels are kept in {files.of_all} ({refused})")
            return
        WATCH.once(
            f"compiled kernels cannot be kept, every start compiles them again ({refused}); "
            "NUMBA_CACHE_DIR may name a folder that can be written"
        )

    def _index_key(self, sig: Any, codegen: Any) -> str:
        if self._digest is None:
            # Not before the first call: then everything that the function refers to exists.
            self._digest = digest_of(self._py_func)
        about = (
            self._digest, repr(sig), sorted(self._options.items()), codegen.magic_tuple(),
            numba.__version__, sys.version_info[:2], LEVEL,
        )  # fmt: skip
        return hashlib.sha256(repr(about).encode()).hexdigest()[:24]


class _Place(_CacheLocator):
    """Numba wants to be told a place; `KernelCache` knows its own."""

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


class _Files(IndexDataCacheFile):
    """The files of one kernel in one folder, without an index. Numba's data has its end in itself,
    so that the digest behind it does not disturb."""

    def __init__(self, folder: Path, title: str) -> None:
        super().__init__(str(folder), title, "")
        self.folder = folder
        # The folder above those of the packages: messages name it, the same for every kernel.
        self.of_all = folder.parent.parent if folder.name == "__pycache__" else folder.parent
        self._title = title

    def load(self, key: str) -> Any:
        """The entry, or None where there is none, it cannot be read, or it is damaged."""
        path = self.folder / self._name(key)
        try:
            raw = path.read_bytes()
        except OSError:
            return None
        if hashlib.sha256(raw[:-DIGEST_BYTES]).digest() != raw[-DIGEST_BYTES:]:
            WATCH.once(f"compiled kernels in {self.of_all} are damaged and compiled again")
            return None
        return self._load_data(path.name)

    def save(self, key: str, data: Any) -> None:
        """Writes it beside and renames it: an entry is there whole or not at all."""
        self.folder.mkdir(parents=True, exist_ok=True)
        self._save_data(self._name(key), data)

    def _name(self, key: str) -> str:
        return f"{self._title}-{key}.nbc"

    def _dump(self, obj: Any) -> bytes:
        raw: bytes = super()._dump(obj)
        return raw + hashlib.sha256(raw).digest()


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
