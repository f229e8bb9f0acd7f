"""Bus time that waits for its nodes."""

import asyncio
import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from patience import HANG_S

from meshpoint.bus.core import Step
from meshpoint.bus.driver import run_node
from meshpoint.bus.local.plugin import MeshpointBus
from meshpoint.bus.pace import (
    BUS_SILENCE_US,
    HEARTBEAT_US,
    PACED_NODES,
    SLACK_US,
    PacedClock,
    PaceError,
    PaceFile,
    Pacemaker,
)
from meshpoint.dbc.frame import Frame

ELAPSED_US = st.floats(0.0, 400_000.0)
NOBODY = [None] * len(PACED_NODES)


def test_time_goes_with_the_wall_while_every_node_looks_in_time():
    pacemaker = Pacemaker(speed=1.0)
    now_us = 0
    for _ in range(1000):
        now_us = pacemaker.advance(500.0, [now_us + HEARTBEAT_US] * len(PACED_NODES))
    assert now_us == 500_000


@given(spans_us=st.lists(ELAPSED_US, min_size=1, max_size=100), promise_us=st.integers(0, 10_000))
def test_time_never_passes_a_promise_by_more_than_the_slack(spans_us, promise_us):
    pacemaker = Pacemaker(speed=1.0)
    waited_us = 0.0
    for span_us in spans_us:
        waited_us += min(span_us, 2_000.0)
        now_us = pacemaker.advance(span_us, [promise_us, None, None])
        if waited_us < 900_000.0:
            assert now_us <= promise_us + SLACK_US


@given(spans_us=st.lists(ELAPSED_US, min_size=2, max_size=100), speed=st.floats(0.01, 10.0))
def test_time_never_goes_back_and_never_leaps(spans_us, speed):
    pacemaker = Pacemaker(speed)
    times_us = [pacemaker.advance(span_us, NOBODY) for span_us in spans_us]
    assert times_us == sorted(times_us)
    assert all(b - a <= 2_000 * max(1.0, speed) + 1 for a, b in itertools.pairwise(times_us))


def test_time_waits_at_once_for_a_node_that_works(tmp_path):
    """A step that takes long began at its bus time: what it sends must not come later by as much as
    the node had promised before. Two nodes that worked at once let valve commands be late."""
    file = PaceFile.create(tmp_path / "pace")
    node, pacemaker = PacedClock(file, "controller"), Pacemaker(speed=1.0)
    node.here()
    for _ in range(3):
        file.set_now(pacemaker.advance(300.0, file.promises_us()))
    begun_us = node.now_us()
    node.begins(begun_us)
    for _ in range(500):
        file.set_now(pacemaker.advance(500.0, file.promises_us()))
    assert begun_us == 900
    assert node.now_us() == begun_us + SLACK_US
    node.here()
    for _ in range(10):
        file.set_now(pacemaker.advance(500.0, file.promises_us()))
    # What fell due in the millisecond that the step took was not looked at.
    assert node.now_us() == begun_us + SLACK_US + HEARTBEAT_US


def test_a_node_that_died_is_waited_for_a_second_and_then_no_more():
    pacemaker = Pacemaker(speed=1.0)
    for _ in range(900):
        assert pacemaker.advance(1_000.0, [2_000, None, None]) <= 2_000 + SLACK_US
    for _ in range(900):
        now_us = pacemaker.advance(1_000.0, [2_000, None, None])
    assert now_us > 700_000


@pytest.mark.parametrize(
    ("speed", "slower", "waits_s"),
    [(0.05, 1.0, 20.0), (0.5, 1.0, 2.0), (1.0, 1.0, 1.0), (4.0, 1.0, 1.0), (0.1, 60.0, 60.0)],
)
def test_a_slow_machine_is_given_as_much_longer(speed, slower, waits_s):
    """On an emulated processor, itself kept from running, one step may take ten seconds."""
    pacemaker = Pacemaker(speed, slower)
    tick_us = 1_000.0 / min(1.0, speed)
    for _ in range(round(0.99 * waits_s * 1e6 / tick_us)):
        stood_us = pacemaker.advance(tick_us, [2_000, None, None])
    assert stood_us <= 2_000 + SLACK_US * max(1.0, speed)
    for _ in range(round(0.5 * waits_s * 1e6 / tick_us)):
        now_us = pacemaker.advance(tick_us, [2_000, None, None])
    assert now_us > 300_000


def test_a_file_that_is_no_pace_file_is_refused_by_name(tmp_path):
    (tmp_path / "other").write_bytes(b"not a pace file")
    with pytest.raises(ValueError, match=r"other: 15 bytes, a pace file has 40"):
        PaceFile(tmp_path / "other")


def test_a_node_that_waits_for_the_pace_file_never_opens_half_of_one(tmp_path):
    """It was there, of 0 bytes, before it was written: a node started beside the pacemaker ended
    with an error now and then."""
    path = tmp_path / "pace"
    faults, ending = [], threading.Event()

    def waits() -> None:
        while not ending.is_set():
            try:
                PaceFile(path)
            except FileNotFoundError:
                continue
            except PaceError as error:
                faults.append(str(error))
                return

    node = threading.Thread(target=waits)
    node.start()
    try:
        for _ in range(500):
            PaceFile.create(path)
            path.unlink()
    finally:
        ending.set()
        node.join()
    assert faults == []
    assert list(tmp_path.iterdir()) == []


def test_a_pace_file_is_never_written_through_a_planted_link(tmp_path):
    """Its folder may be anybody's: what a link beside it points to stays as it is."""
    target, path = tmp_path / "precious", tmp_path / "pace"
    target.write_text("as it was")
    (tmp_path / f"pace.{os.getpid()}").symlink_to(target)
    path.symlink_to(target)
    assert PaceFile.create(path).now_us == 0
    assert target.read_text() == "as it was"
    assert not path.is_symlink()


LOOKS = """
import sys, time
from pathlib import Path
from meshpoint.bus.pace import PacedClock, PaceFile
clock = PacedClock(PaceFile(Path(sys.argv[1])), "rig")
print("ready", flush=True)
while True:
    clock.begins(clock.now_us())
    clock.here()
    time.sleep(0.001)
"""


@pytest.mark.parametrize("content", [b"", b"1234", bytes(40)])
def test_a_pace_file_that_is_cut_off_ends_its_processes_with_an_error(content, tmp_path):
    """A signal ended them, and nothing was said."""
    path = tmp_path / "pace"
    PaceFile.create(path)
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    keeper, node = (
        subprocess.Popen([sys.executable, *words, str(path)], text=True, **pipes)
        for words in (("-m", "meshpoint.bus.pace"), ("-c", LOOKS))
    )
    file = PaceFile(path)
    assert node.stdout.readline() == "ready\n"
    while file.now_us == 0:
        time.sleep(0.01)
    path.write_bytes(content)
    _, said = node.communicate(timeout=60)
    assert node.returncode == 1
    assert "PaceError" in said
    assert str(path) in said
    assert keeper.stderr.readline().startswith(f"pace: {path}: ")
    keeper.communicate(timeout=60)
    assert keeper.returncode == 1


def rig_on(file, core, stop, open_bus=None):
    node = run_node(
        core, open_bus or _SilentBus, PacedClock(file, "rig"), on_event=print, stop=stop, name="rig"
    )
    return asyncio.create_task(node)


def test_a_node_whose_bus_time_is_gone_still_says_its_last(tmp_path):
    """At the last time that there was: its valves are to be switched off."""
    path = tmp_path / "pace"
    file = PaceFile.create(path)
    file.set_now(5_000_000)
    core = _Ticker()
    ended_us = []
    core.shutdown = lambda now_us: ended_us.append(now_us) or Step([], [])

    async def run():
        node = rig_on(file, core, asyncio.Event())
        while not core.next_step_us:
            await asyncio.sleep(0.01)
        path.write_bytes(b"")
        await node

    with pytest.raises(PaceError, match="pace: 0 bytes"):
        asyncio.run(asyncio.wait_for(run(), 60))
    assert ended_us == [5_000_000]


class _Ticker:
    """A core with a step every 10 ms, one of which takes long."""

    def __init__(self):
        self.next_step_us = 0
        self.late_us = []
        self.stalled = False

    def receive(self, frame):
        pass

    def step(self, now_us):
        if self.next_step_us:
            self.late_us.append(now_us - self.next_step_us)
        if len(self.late_us) == 20 and not self.stalled:
            self.stalled = True
            time.sleep(0.3)
        self.next_step_us = now_us + 10_000
        return Step([], [])

    def shutdown(self, now_us):
        return Step([], [])


def test_a_process_that_was_stopped_is_not_late_on_paced_time(tmp_path):
    path = tmp_path / "pace"
    file = PaceFile.create(path)
    core = _Ticker()

    async def run():
        stop = asyncio.Event()
        node = rig_on(file, core, stop)
        while len(core.late_us) < 40:
            await asyncio.sleep(0.01)
        stop.set()
        await node

    # A busy machine may keep this process from running for longer than nodes are waited for.
    patient = (
        "import sys, meshpoint.bus.pace as pace\n"
        "pace.GIVEN_UP_S = 600.0\n"
        "raise SystemExit(pace.main(sys.argv[1:]))"
    )
    with subprocess.Popen(
        [sys.executable, "-c", patient, str(path)], stdin=subprocess.PIPE
    ) as pacemaker:
        asyncio.run(asyncio.wait_for(run(), HANG_S))
        pacemaker.stdin.close()
    assert pacemaker.returncode == 0
    assert max(core.late_us) <= HEARTBEAT_US + SLACK_US
    assert file.promises_us()[PACED_NODES.index("rig")] is None


def _SilentBus():
    import can

    return can.Bus(interface="virtual", channel="pace-test")


def test_time_waits_for_frames_on_their_way_and_gives_a_silent_bus_up(tmp_path):
    file = PaceFile.create(tmp_path / "pace")
    clock, pacemaker = PacedClock(file, "controller"), Pacemaker(speed=1.0)

    def run(milliseconds):
        for _ in range(milliseconds):
            clock.begins(clock.now_us())
            clock.here()
            file.set_now(pacemaker.advance(1_000.0, file.promises_us()))

    run(50)
    assert file.now_us == 50_000, "nobody has been heard yet"
    clock.heard()
    run(500)
    waited_us = file.now_us - 50_000
    assert BUS_SILENCE_US <= waited_us <= BUS_SILENCE_US + HEARTBEAT_US + 2 * SLACK_US
    clock.heard()
    run(10)
    assert file.now_us - 50_000 >= waited_us + 9_000, "time goes on with the frame"
    run(2_500)
    assert file.now_us > 1_000_000, "nobody speaks any more"


class _Speaker(_Ticker):
    """A core that sends a frame in each step."""

    stalled = True

    def step(self, now_us):
        super().step(now_us)
        return Step([Frame(0x123, bytes(64), True, False)], [])


@pytest.mark.skipif(sys.platform != "linux", reason="how much waits, Linux alone tells")
def test_time_waits_for_a_hub_that_has_not_passed_frames_on(hub, tmp_path):
    file = PaceFile.create(tmp_path / "pace")
    pacemaker, core = Pacemaker(speed=1.0), _Speaker()
    channel, process = hub

    async def turns(node, until):
        """The node and the pacemaker by turns, each of which is a millisecond."""
        for _ in range(100_000):
            if until():
                return
            file.set_now(pacemaker.advance(1_000.0, file.promises_us()))
            await asyncio.sleep(0.001)
            if node.done():
                node.result()
        raise AssertionError

    async def run():
        stop = asyncio.Event()
        node = rig_on(file, core, stop, lambda: MeshpointBus(channel, start_hub=False))
        await turns(node, lambda: len(core.late_us) >= 5)
        process.send_signal(signal.SIGSTOP)
        stopped_us, turn = file.now_us, itertools.count()
        await turns(node, lambda: next(turn) > 200)
        # What it sent last may have been passed on, but not what it sends next.
        assert file.now_us - stopped_us <= 10_000 + HEARTBEAT_US + SLACK_US
        process.send_signal(signal.SIGCONT)
        await turns(node, lambda: file.now_us - stopped_us > 100_000)
        stop.set()
        await node

    asyncio.run(asyncio.wait_for(run(), HANG_S))


def test_a_pace_file_is_closed_with_the_last_that_uses_it(tmp_path: Path) -> None:
    """Each run of a demo opens one: none may stay open behind it, and none is warned of."""
    file = PaceFile.create(tmp_path / "pace")
    descriptor = file._descriptor
    clock = PacedClock(file, "rig")
    del file
    os.fstat(descriptor)
    del clock
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(descriptor)
