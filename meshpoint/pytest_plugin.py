"""The pytest plugin: a fixture `bench`, on the backend that the command line chooses.

    @pytest.mark.meshpoint(as_built="clean")
    def test_ten_meets_the_gap(bench):
        bench.learn(10)
        assert bench.shift(10).contact == "gap"

docs/pytest.md has all of it. The product is loaded with the first bench: a test run that asks for
none is not made slower.
"""

from __future__ import annotations

import re
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import pytest

if TYPE_CHECKING:
    from meshpoint import Bench, LiveBench

    AnyBench = Bench | LiveBench

BACKENDS: Final = ("virtual", "processes", "vcan", "adapter")
MARKER: Final = (
    "meshpoint(shared=False, **arguments): arguments of the test's `bench`, as of meshpoint.Bench; "
    "shared: tests with the same arguments use one bench, one after the other"
)
FAILURES: Final = "meshpoint-failures"


def pytest_addoption(parser: pytest.Parser) -> None:
    """The command line's choices."""
    from meshpoint.bus import given_numbers

    group = parser.getgroup("meshpoint", "the bench of meshpoint")
    group.addoption(
        "--meshpoint-backend", choices=BACKENDS, default=BACKENDS[0],
        help="virtual: virtual time, in this process (default); processes: two processes on a bus "
        "of their own; vcan: on vcan0; adapter: on the CAN interface that is named",
    )  # fmt: skip
    group.addoption(
        "--meshpoint-interface", metavar="NAME", help="python-can's interface, for adapter"
    )
    group.addoption("--meshpoint-channel", metavar="NAME", help="its channel (vcan: default vcan0)")
    group.addoption(
        "--meshpoint-start", metavar="NODES", default="rig,controller",
        help="for vcan and adapter: the nodes to start, the others are on the bus already: rig, "
        "controller, rig,controller (default) or none",
    )  # fmt: skip
    group.addoption("--meshpoint-settings", metavar="FILE", help="the controller's settings, TOML")
    group.addoption(
        "--meshpoint-in-process", action="store_true",
        help="for all but virtual: the nodes run in this process",
    )  # fmt: skip
    group.addoption(
        "--meshpoint-speed", type=given_numbers.speed, default=1.0, metavar="X",
        help="for all but virtual: this many times as fast as the wall clock (default: 1)",
    )  # fmt: skip
    group.addoption(
        "--meshpoint-out", type=Path, default=Path(FAILURES), metavar="DIR",
        help=f"where a failed test leaves log and report (default: {FAILURES})",
    )  # fmt: skip


def pytest_configure(config: pytest.Config) -> None:
    """Registers the marker."""
    config.addinivalue_line("markers", MARKER)


class Benches:
    """Makes benches, and keeps those that tests share."""

    def __init__(self, config: pytest.Config, folder: Path) -> None:
        self._config = config
        self._folder = folder
        self._made = 0
        self._shared: tuple[str, AnyBench] | None = None

    @property
    def is_virtual(self) -> bool:
        """Whether a bench of a test's own costs little."""
        return bool(self._config.getoption("--meshpoint-backend") == BACKENDS[0])

    def shared(self, arguments: dict[str, Any]) -> AnyBench:
        """The bench of the test before, where it has the same arguments; else a new one."""
        key = repr(sorted(arguments.items()))
        if self._shared is not None and self._shared[0] == key:
            return self._shared[1]
        self.close()
        bench = self.make(arguments)
        self._shared = key, bench
        return bench

    def make(self, arguments: dict[str, Any]) -> AnyBench:
        """A new bench, recorded."""
        import meshpoint

        self._made += 1
        log = self._folder / f"bench-{self._made}" / "run.log"
        settings = self._config.getoption("--meshpoint-settings")
        if settings is not None:
            arguments = {"settings": settings} | arguments
        if self.is_virtual:
            return meshpoint.Bench(**arguments, log=log)
        return meshpoint.LiveBench(**(self._live() | arguments), log=log)

    def _live(self) -> dict[str, Any]:
        option = self._config.getoption
        given: dict[str, Any] = {
            "speed": option("--meshpoint-speed"),
            "in_process": option("--meshpoint-in-process"),
        }
        backend, channel = option("--meshpoint-backend"), option("--meshpoint-channel")
        if backend == "processes":
            return given
        interface = "socketcan" if backend == "vcan" else option("--meshpoint-interface")
        if interface is None:
            raise pytest.UsageError(
                "--meshpoint-backend adapter needs --meshpoint-interface, and mostly "
                "--meshpoint-channel (`meshpoint help bus`)"
            )
        if backend == "vcan":
            channel = channel or "vcan0"
        nodes = option("--meshpoint-start")
        start = () if nodes == "none" else tuple(nodes.split(","))
        return given | {"interface": interface, "channel": channel, "start": start}

    def close(self) -> None:
        """Ends the bench that tests share."""
        if self._shared is not None:
            bench, self._shared = self._shared[1], None
            bench.close()


@pytest.fixture(scope="session")
def meshpoint_benches(
    pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Benches]:
    """The benches of this run."""
    benches = Benches(pytestconfig, tmp_path_factory.mktemp("meshpoint"))
    yield benches
    benches.close()


@pytest.fixture
def bench(request: pytest.FixtureRequest, meshpoint_benches: Benches) -> Iterator[AnyBench]:
    """Controller and rig on one CAN bus: `meshpoint.Bench`, or `meshpoint.LiveBench` on every
    backend but virtual.

    In virtual time each test has a bench of its own. The other backends keep theirs for all tests
    with the same arguments, as hardware is kept, and so do virtual ones with
    `@pytest.mark.meshpoint(shared=True)`: shifts of earlier tests stand in `bench.shifts` then, and
    what was learned stays known."""
    arguments: dict[str, Any] = {}
    for marker in reversed(list(request.node.iter_markers("meshpoint"))):
        arguments |= marker.kwargs
    shared = arguments.pop("shared", False) or not meshpoint_benches.is_virtual
    if shared:
        yield meshpoint_benches.shared(arguments)
        return
    with meshpoint_benches.make(arguments) as made:
        yield made


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """A failed test leaves its log, a report, and the commands that repeat it."""
    report = yield
    bench: Any = getattr(item, "funcargs", {}).get("bench")
    if call.when == "call" and report.failed and hasattr(bench, "save_log"):
        folder = item.config.getoption("--meshpoint-out") / _folder_name(item.nodeid)
        try:
            lines = _leave(bench, folder)
        except Exception as error:  # noqa: BLE001 (the test's own failure is what counts)
            lines = [f"log and report could not be left in {folder}: {error}"]
        report.sections.append(("meshpoint", "\n".join(lines)))
    return report


def _leave(bench: AnyBench, folder: Path) -> list[str]:
    import meshpoint
    from meshpoint.results.output import counted

    log = bench.save_log(folder)
    lines = [
        f"at {bench.now_s:.3f} s of bus time, after {counted(len(bench.shifts))}",
        f"log     {log}",
    ]
    if bench.shifts:
        page = meshpoint.Log(log).report(folder / "report.html", gearbox=bench.sheet)
        lines.append(f"report  {page}")
    lines += [
        f"replay  meshpoint replay {log} --verify",
        f"        meshpoint tell {log}",
    ]
    return lines


def _folder_name(nodeid: str) -> str:
    """A test's name as a folder's, without what some file system does not take."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", nodeid.replace("::", "."))[-150:].strip("_.")
