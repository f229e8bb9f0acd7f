"""Compiled kernels come with the wheel, or are kept on disk, once for all copies of meshpoint that
a user has.

numba's own cache looks at the file of the cached function alone, so a change in a piece from
another file would go unseen, and one damaged index ends every command. Here the name of an entry
holds a digest of the function, of every piece and constant that it refers to, of its signature and
of what else decides on machine code (`MACHINE_CODE`). In a wheel, whose files nobody edits while
they are run, the digest is of the source, and one entry serves several Pythons (`ABI`, `SERVED`).
Where entries lie, and which are taken: `meshpoint.kernels.folder`. What is not taken is compiled
again, and said in one line.

Loads numba: only where kernels are compiled at all.
"""

# numba is typed only in part.
# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

import hashlib
import pickle
import sys
import sysconfig
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any, Final

import numba
import numpy as np
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator
from numba.core.registry import cpu_target
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

from meshpoint.kernels.digest import digest_by_source, digest_of
from meshpoint.kernels.folder import (
    ENTRY,
    KernelFolder,
    UnusableEntryError,
    has_shipped,
    kernel_folders,
    shipped,
)
from meshpoint.kernels.target import LEVEL
from meshpoint.kernels.watch import WATCH

_config: Any = numba.core.config
_COMPILER: Final = (
    LEVEL, _config.BOUNDSCHECK, _config.DEBUGINFO_DEFAULT,
    _config.LOOP_VECTORIZE, _config.SLP_VECTORIZE,
)  # fmt: skip
MACHINE_CODE: Final = (
    numba.__version__, version("llvmlite"), np.__version__,
    sysconfig.get_config_var("EXT_SUFFIX"), *_COMPILER,
)  # fmt: skip
"""What decides on machine code beside the kernel and the processor: the compiler, numpy, whose
arrays it works on, the Python it is called from, and NUMBA_... variables."""
ABI: Final = (
    numba.__version__, version("llvmlite"), np.__version__.split(".")[:2],
    sys.implementation.name, sysconfig.get_config_var("Py_GIL_DISABLED") or 0,
    hasattr(sys, "gettotalrefcount"), *_COMPILER,
)  # fmt: skip
"""What a wheel's machine code is bound to instead: of Python it calls functions of the stable ABI
alone, and numba looks at the first two numbers of numpy's version, no further."""
SERVED: Final = ((3, 11), (3, 12), (3, 13))
"""Pythons that have been seen to run one wheel's kernels (`tools/test-pythons`); others compile."""


def machine(code: tuple[Any, ...] = MACHINE_CODE) -> tuple[Any, ...]:
    """All that decides on machine code beside the kernel."""
    return (*cpu_target.target_context.codegen().magic_tuple(), *code)


def takes_shipped() -> bool:
    """Whether there are kernels of a wheel, and this Python may run them."""
    return sys.version_info[:2] in SERVED and has_shipped()


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
        self.title = f"{path}.{function.__name__}"
        self._impl = _Result(function)
        self._folders = folders
        self._name, self._cache_path = repr(function), str(folders[0].path)
        self._digest: str | None = None
        self._by_source: str | None = None
        self.enable()

    def flush(self) -> None:
        """Nothing is kept that could be out of date."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What was compiled before, or None: numba then compiles it."""
        # All that kept code needs of it. Only a compiler needs numba's operations on arrays, which
        # bring scipy's: numba itself loads them before it compiles.
        rtsys.initialize(target_context)
        if not self._enabled:
            return None
        entry = self._entry(sig)
        content = (shipped(self.portable(sig)) if takes_shipped() else None) or self._kept(entry)
        if content is None:
            WATCH.compiling(self.title)
            return None
        WATCH.taken(self, sig, content)
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
        WATCH.taken(self, sig, content)
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

    def portable(self, sig: Any) -> str:
        """The name of the file in a wheel."""
        if self._by_source is None:
            self._by_source = digest_by_source(self._py_func)
        return self._file(self._by_source, sig, machine(ABI))

    def _entry(self, sig: Any) -> str:
        """The name of the file on this machine."""
        if self._digest is None:
            # Not before the first call: then everything that the function refers to exists.
            self._digest = digest_of(self._py_func)
        return self._file(self._digest, sig, machine())

    def _file(self, digest: str, sig: Any, machine: tuple[Any, ...]) -> str:
        about = (digest, repr(sig), sorted(self._options.items()), machine)
        return f"{self.title}-{hashlib.sha256(repr(about).encode()).hexdigest()[:24]}{ENTRY}"


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
