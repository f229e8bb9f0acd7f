"""What pythonfmu3's wrapper (0.3.4), the library between an importer and our script, leaves to do.

It is C++, and two of its ways end in memory that is free already:

- Its interpreter state is a static of the library. At the end of the process that static is
  destroyed, and the library's own destructor, which comes later, releases it once more: it counts
  down in a block that is free already. Where numba has filled the heap, that block is
  in a list of free ones, and the process aborts ("corrupted double-linked list"). Unloading the
  library does not help, as it cannot be unloaded: it defines unique symbols (STB_GNU_UNIQUE).
- It releases instance, class and log of a script that has raised an error, and again when the
  importer frees the instance.
"""

from __future__ import annotations

import atexit
import ctypes
import os
import sys
import threading
from pathlib import Path
from typing import Any, Final

LIBRARIES: Final = "binaries/x86_64-linux/*.so"
_known: Final[set[Path]] = set()


def end_well(resources: str) -> None:
    """Where a Python has loaded the unit's library on Linux, the library releases its state
    before the process ends. An importer that is no Python ends the interpreter by that state: there
    it stays. resources: the unit's folder of that name."""
    hosted = threading.main_thread().native_id == os.getpid()
    if sys.platform != "linux" or not hosted:
        return
    for path in Path(resources).resolve().parent.glob(LIBRARIES):
        if path in _known:
            continue
        _known.add(path)
        try:
            library = ctypes.CDLL(str(path), mode=os.RTLD_NOW | os.RTLD_NOLOAD)
        except OSError:
            continue  # not loaded: the script was imported by something else
        atexit.register(_release, library)


def _release(library: ctypes.CDLL) -> None:
    """The wrapper's own function, by which it does so where it is unloaded."""
    release = getattr(library, "finalizePythonInterpreter", None)
    if release is not None:
        release()


def hold(*things: Any) -> None:
    """One reference more to each, for the second time that the wrapper releases it."""
    for thing in things:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(thing))
