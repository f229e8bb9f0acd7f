"""What holds for all tests: hypothesis draws the same examples in every run, and judges what is
computed, not how fast a busy machine computes it.

Look for new examples with `pytest --hypothesis-profile=explore`.

And what lies on this machine changes nothing: no settings of this user, no local bus of other runs.
Compiled kernels alone are shared, whose names say what is in them.

Makes `patience` importable, by which live tests wait.
"""

import atexit
import gc
import os
import shutil
import signal
import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from meshpoint.bus.light_can import load_can
from meshpoint.kernels.folder import user_cache

OF_THIS_USER = ("CAN_", "COLUMNS", "LINES", "FORCE_COLOR", "NO_COLOR", "MESHPOINT_SINCE")
"""Beginnings of variables by which a shell changes what commands do or how they say it."""
for variable in [name for name in os.environ if name.startswith(OF_THIS_USER)]:
    del os.environ[variable]
own = tempfile.mkdtemp(prefix="mp-")  # short: a socket's path has a hundred characters
atexit.register(shutil.rmtree, own, ignore_errors=True)
os.environ.setdefault("XDG_CACHE_HOME", str(user_cache()))
os.environ |= {"HOME": own, "XDG_CONFIG_HOME": own, "XDG_RUNTIME_DIR": own}

load_can()  # as every command does, before a test file loads python-can with all that it can use

sys.path.insert(0, str(Path(__file__).parent))

# A shell starts what runs in the background with Ctrl-C ignored, and so would be every command that
# a test starts and interrupts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

UNTIMED = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("explore", UNTIMED)
settings.register_profile("same", UNTIMED, derandomize=True, database=None)
settings.load_profile("same")

LONGEST_FIRST = ("campaign", "testbench", "closed_loop", "swarm", "fuzz", "studies", "bus")
"""Folders with long files: one that began last would keep one worker busy while the other is
done."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begins with the longest."""
    here = Path(__file__).parent

    def place(item: pytest.Item) -> int:
        folder = item.path.relative_to(here).parts[0] if here in item.path.parents else ""
        return LONGEST_FIRST.index(folder) if folder in LONGEST_FIRST else len(LONGEST_FIRST)

    items.sort(key=place)


def pytest_collection_finish() -> None:
    """7,000 tests and their modules are there to stay: to look through them for garbage each 700
    objects took every eighth second of the suite."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000)
