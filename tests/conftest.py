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
from collections.abc import Iterator
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


@pytest.fixture
def channel() -> Iterator[str]:
    """A bus of the test's own, for `-c`; a socket's path must be short."""
    with tempfile.TemporaryDirectory(prefix="mp-", ignore_cleanup_errors=True) as folder:
        yield f"unix:{folder}/bus.sock"


UNTIMED = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("explore", UNTIMED)
settings.register_profile("same", UNTIMED, derandomize=True, database=None)
settings.load_profile("same")

HERE = Path(__file__).parent
LONGEST_FIRST = ("campaign", "testbench", "closed_loop", "swarm", "fuzz", "studies", "bus")
"""Folders with long files: one that began last would keep one worker busy while the other is
done."""
OF_CHECK = {
    "api", "campaign", "captured", "closed_loop", "contract", "firmware", "fuzz", "planted",
    "silkit", "studies", "swarm", "testbench", "tools",
}  # fmt: skip
"""Folders whose tests are marked `check`, but for those of OF_TEST."""
OF_TEST = {
    "closed_loop/test_recorded_runs.py",
    "closed_loop/test_shifts.py",
    "closed_loop/test_faults.py",
    "closed_loop/test_guard_alone.py",
    "closed_loop/test_replay.py",
    "testbench/test_live.py",
}
"""Files of such folders that prove the product in `make test`: recorded runs, closed loops, nodes
on a live bus."""


def is_of_check(path: Path) -> bool:
    """Whether a file's tests are all marked `check` by its folder."""
    if HERE not in path.parents:
        return False
    name = path.relative_to(HERE).as_posix()
    return name.partition("/")[0] in OF_CHECK and name not in OF_TEST


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """A file of which nothing would be run is not imported: `make test` leaves out those of
    `check`, `make check` those that have no such test."""
    chosen = str(config.option.markexpr)
    if not collection_path.name.startswith("test_") or "check" not in chosen:
        return None
    if "not check" in chosen:
        return is_of_check(collection_path) or None
    if is_of_check(collection_path):
        return None
    return "mark.check" not in collection_path.read_text(encoding="utf-8") or None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks what belongs to `make check`, and begins with the longest."""

    def place(item: pytest.Item) -> int:
        folder = item.path.relative_to(HERE).parts[0] if HERE in item.path.parents else ""
        return LONGEST_FIRST.index(folder) if folder in LONGEST_FIRST else len(LONGEST_FIRST)

    for item in items:
        if is_of_check(item.path):
            item.add_marker("check")
    items.sort(key=place)


def pytest_collection_finish() -> None:
    """7,000 tests and their modules are there to stay: to look through them for garbage each 700
    objects took every eighth second of the suite."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000)
