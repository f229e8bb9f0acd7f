"""An XCP master that we did not write, pyxcp, on the virtual bus: bus time passes while it waits
for an answer, and where a test lets it."""

from __future__ import annotations

import logging
import queue
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import pytest
from loop_bench import Loop
from pyxcp.config import create_application_from_config, set_application
from pyxcp.master import Master
from pyxcp.types import XcpResponseError

from meshpoint.base.version import product_version
from meshpoint.bench.virtual_time import VirtualTime
from meshpoint.bus.core import Core, Step
from meshpoint.bus.frames import frame_of, message_of
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.header import XcpAccess, new_header
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import XCP_COMMAND_ID, XCP_RESPONSE_ID
from meshpoint.gearbox import load_sheet
from meshpoint.replays.replay import LogReplay
from meshpoint.xcp.memory import PAGE_ADDRESS, PARAMETERS, ROW_BYTES
from meshpoint.xcp.node import XcpCore

# Its recorder asks for one, and would read pytest's command line.
set_application(create_application_from_config({}, logging.ERROR))
EXTENDED = 0x8000_0000
TICK_US, QUIET_TICKS = 10_000, 3


class Alone:
    """A controller that hears a master and nothing else."""

    def __init__(self, cable: Cable) -> None:
        self.header = new_header(
            product_version(), load_sheet("thesis"), ControllerSettings(), xcp=XcpAccess.WRITE
        )
        self.core = ControllerCore(self.header)
        self.frames: list[tuple[int, Frame]] = []
        nodes: list[Core] = [XcpCore(self.core, self.core), cable]
        self.time = VirtualTime(nodes, [726, 2_131], lambda *frame: self.frames.append(frame))

    def until(self, met: Callable[[], bool], limit_us: int) -> bool:
        return self.time.run(met, limit_us)


class Cable(can.BusABC):
    """The master's bus and a node of the virtual one."""

    def __init__(self) -> None:
        super().__init__(channel="virtual")
        self.loop: Loop | Alone
        self.next_step_us = 0
        self._to_send: queue.SimpleQueue[Frame] = queue.SimpleQueue()
        self._heard: queue.SimpleQueue[can.Message] = queue.SimpleQueue()
        self._turn, self._sending = threading.RLock(), threading.Lock()
        self._waits = threading.Event()
        """The master has sent something; cleared when nothing has come for some ticks."""
        self._quiet = 0

    # the master's side

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        with self._sending:
            self._to_send.put(frame_of(msg))
            self._quiet = 0
            self._waits.set()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self._heard.empty() and self._waits.wait(timeout):
            self.pass_time(TICK_US)
            with self._sending:
                self._quiet += 1
                if self._quiet > QUIET_TICKS:
                    self._waits.clear()
        try:
            heard = self._heard.get_nowait()
        except queue.Empty:
            return None, False
        self._quiet = 0
        return heard, False

    def pass_time(self, time_us: int) -> None:
        """Bus time."""
        with self._turn:
            self.loop.until(lambda: False, self.loop.time.now_us + time_us)

    def until(self, met: Callable[[], bool], limit_us: int = 5_000_000) -> None:
        """Bus time until something is so."""
        with self._turn:
            assert self.loop.until(met, self.loop.time.now_us + limit_us)

    # the node's side

    def receive(self, frame: Frame) -> None:
        if frame.can_id == XCP_RESPONSE_ID:
            self._heard.put(message_of(frame))

    def step(self, now_us: int) -> Step:
        self.next_step_us = now_us + 1_000
        frames = []
        while not self._to_send.empty():
            frames.append(self._to_send.get_nowait())
        return Step(frames, [])

    def shutdown(self, now_us: int) -> Step:
        return Step([], [])


@contextmanager
def master(
    *, fd: bool = True, policy: Any = None, alone: bool = False, **loop: Any
) -> Iterator[tuple[Master, Any, Cable]]:
    """pyxcp beside the controller of a loop with these properties; `alone`: without a gearbox, for
    many commands in little time. policy: what takes its DAQ packets."""
    cable = Cable()
    if alone:
        cable.loop = Alone(cable)
    else:
        cable.loop = Loop(guests=[cable], **({"xcp": XcpAccess.WRITE} | loop))
    of_can = {
        "can_id_master": XCP_COMMAND_ID | EXTENDED,
        "can_id_slave": XCP_RESPONSE_ID | EXTENDED,
        "fd": fd,
    }
    settings = {"Transport": {"CAN": of_can}, "General": {"disable_error_handling": True}}
    config = create_application_from_config(settings, logging.ERROR)
    config.transport.timeout = 30.0
    with Master("can", config, policy, transport_layer_interface=cable) as one:
        yield one, cable.loop, cable


AIM = "window.aim_slip_rpm"


def address_of(name: str) -> int:
    (row,) = (i for i, each in enumerate(PARAMETERS) if each.name == name)
    return PAGE_ADDRESS + ROW_BYTES * row


def read(one: Any, name: str) -> float:
    (value,) = struct.unpack("<f", one.shortUpload(ROW_BYTES, address_of(name)))
    return float(value)


def write(one: Any, name: str, value: float) -> None:
    one.setMta(address_of(name))
    one.download(struct.pack("<f", value))


def refusal(call: Any, *given: Any) -> str:
    """The error that a command is answered with."""
    with pytest.raises(XcpResponseError) as error:
        call(*given)
    return str(error.value.args[0])


def settings_of(run: Any) -> ControllerSettings:
    """Those that the next decision of a shift goes by."""
    settings: ControllerSettings = run.core.sequence.settings
    return settings


def verdict(run: Any, folder: Path) -> Any:
    run.header.save(folder)
    (session,) = LogReplay(folder, verify=True).run([frame for _, frame in run.frames])
    return session
