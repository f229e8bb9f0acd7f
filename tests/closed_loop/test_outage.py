"""A link outage leaves a hole in the log: verified up to it and after it, never as a whole."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import can
import pytest
from loop_bench import SHEET, Loop, Tapped

sys.path.insert(0, str(Path(__file__).parents[1] / "bus"))

from fake_time import FakeTimeLoop, QuietBus, run_in_fake_time

from meshpoint.base.version import product_version
from meshpoint.bus.clock import Clock
from meshpoint.bus.core import Step
from meshpoint.bus.frames import frame_of
from meshpoint.bus.outage_record import AFTER_STEPS, BEFORE_STEPS, OutageRecord, load_outages
from meshpoint.bus.records import Records
from meshpoint.controller.core.core import OWN_ADDRESS, ControllerCore
from meshpoint.controller.run import node
from meshpoint.controller.settings.header import new_header
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.replays.replay import LogReplay
from meshpoint.replays.session import Session, Verification

AWAY_US = (900_000, 1_260_000)
NOTICED_US = 60_000
"""So long frames are lost without the driver's knowing: they got stuck on their way."""
END_US = 2_700_000
SENT = 203
"""Frames until a cable is pulled."""
LAST_FRAMES = 2
"""A controller that ends sends valves off and clutch open, without a status."""


class AwayFromTheBus:
    """The driver of a controller: from a time on frames go nowhere, then they are known to be
    discarded; it hears nothing meanwhile."""

    def __init__(self, loop: Loop, core: ControllerCore, folder: Path) -> None:
        self._loop = loop
        self.discarded = 0
        run_hash = loop.header.run_hash
        self.records = Records(folder)
        self.kept = OutageRecord(core, self.records, run_hash, lambda: self.discarded)

    @property
    def is_away(self) -> bool:
        return AWAY_US[0] <= self._loop.time.now_us < AWAY_US[1]

    @property
    def next_step_us(self) -> int:
        return self.kept.next_step_us

    def receive(self, frame: Frame) -> None:
        if not self.is_away:
            self.kept.receive(frame)

    def step(self, now_us: int) -> Step:
        frames, events = self.kept.step(now_us)
        events = [*events, *self.records.write()]
        if not self.is_away:
            return Step(frames, events)
        if now_us >= AWAY_US[0] + NOTICED_US:
            self.discarded += len(frames)
        return Step([], events)

    def shutdown(self, now_us: int) -> Step:
        step = self.kept.shutdown(now_us)
        self.records.close()
        return step


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("outage")


@pytest.fixture(scope="module")
def run(folder: Path) -> Loop:
    """A shift, then the outage with a request that it does not hear, then another shift."""
    loop = Loop([(300_000, 10), (1_000_000, 8), (1_500_000, 12)])
    core = loop.core
    away = AwayFromTheBus(loop, core, folder)
    loop.nodes[0] = loop.controller = Tapped(away)
    loop.run(END_US)
    away.shutdown(END_US)
    loop.header.save(folder)
    return loop


def log_of(run: Loop) -> list[Frame]:
    return [frame for _, frame in run.frames]


def verify(folder: Path, log: list[Frame]) -> Session:
    (session,) = LogReplay(folder, verify=True).run(log)
    return session


def test_a_log_is_verified_before_and_after_an_outage_and_never_as_a_whole(
    run: Loop, folder: Path
) -> None:
    session = verify(folder, log_of(run))
    assert session.verdict is Verification.IN_PARTS, str(session)
    (hole,) = session.holes
    assert AWAY_US[0] <= hole.from_us < hole.to_us < AWAY_US[1]
    last = run.status.step_number
    assert session.steps == last + 1
    assert session.compared_steps == last + 1 - (hole.last - hole.first + 1)
    assert f"steps {hole.first} to {hole.last} (0.3" in str(session)
    assert "outage" in str(session)
    assert any("shift 10 -> 12: engaged" in line for line in run.events)


@pytest.mark.parametrize("share", [0.3, 0.9])
def test_one_bit_before_or_after_the_hole_is_a_difference(
    share: float, run: Loop, folder: Path
) -> None:
    log = log_of(run)
    own = [i for i, frame in enumerate(log) if frame.can_id & 0xFF == OWN_ADDRESS]
    at = own[int(share * len(own))]
    data = bytearray(log[at].data)
    data[-1] ^= 0x10
    changed = [*log[:at], log[at]._replace(data=bytes(data)), *log[at + 1 :]]
    session = verify(folder, changed)
    assert session.verdict not in (Verification.IDENTICAL, Verification.IN_PARTS)
    assert len(session.holes) == (share > 0.5)


def test_without_the_record_nothing_after_the_hole_is_verified(
    run: Loop, folder: Path, tmp_path: Path
) -> None:
    run.header.save(tmp_path)
    session = verify(tmp_path, log_of(run))
    assert session.verdict is Verification.NOT_VERIFIABLE
    assert "is missing" in session.reason
    (record,) = folder.glob("outage-*")
    lines = record.read_text().splitlines(keepends=True)
    (tmp_path / record.name).write_text("".join(lines[: len(lines) // 2]))
    again = verify(tmp_path, log_of(run))
    assert again.verdict is Verification.NOT_VERIFIABLE
    assert "no record of an outage" in again.reason


def test_a_record_has_what_came_before_and_after_and_no_run_without_outage_has_one(
    run: Loop, folder: Path
) -> None:
    steps = load_outages(folder, run.header.run_hash)
    session = verify(folder, log_of(run))
    (hole,) = session.holes
    assert sorted(steps) == list(range(min(steps), max(steps) + 1))
    assert min(steps) == max(0, hole.first + NOTICED_US // 10_000 + 1 - BEFORE_STEPS)
    assert abs(max(steps) - hole.last - AFTER_STEPS) <= 1
    assert load_outages(folder, run.header.run_hash ^ 1) == {}


def test_a_live_controller_that_loses_its_bus_keeps_a_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(node, "settle", lambda: None)
    header = new_header(product_version(), SHEET, ControllerSettings())
    header.save(tmp_path)
    buses: list[QuietBus] = []
    lines: list[str] = []
    stop = asyncio.Event()

    class Cable(QuietBus):
        """The first one is pulled out in the middle of a step; the second ends the run."""

        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            if len(self.sent) == SENT and not stop.is_set():
                if self is not buses[0]:
                    stop.set()
                else:
                    raise can.CanOperationError("cable pulled")
            super().send(msg, timeout)

    def open_bus() -> can.BusABC:
        buses.append(Cable())
        return buses[-1]

    async def run(loop: FakeTimeLoop) -> None:
        clock = Clock(source_ns=loop.time_ns)
        await node.run_controller(
            header, open_bus, clock, on_event=lines.append, stop=stop, record=tmp_path
        )

    run_in_fake_time(run)
    first, second = buses
    assert any("outage: what its steps were made of goes to outage-" in line for line in lines)
    log = [frame_of(message) for message in (*first.sent, *second.sent[:-LAST_FRAMES])]
    session = verify(tmp_path, log)
    assert session.verdict is Verification.IN_PARTS, str(session)
    assert session.holes[0].to_us - session.holes[0].from_us > 0.4e6
