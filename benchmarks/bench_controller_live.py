"""The controller as a process on the local bus, beside a process that only echoes a frame.

    answer  from the last edge frame of a read at a listener to the valve command that follows it:
            hub, listener, the controller's wait for the rest of the read and its step are in it
    least   the least of these; a command already on its way as the frame came counts too, so it is
            not the time of a step that is due
    echo    from a frame that the listener sends to the same frame sent back by python-can's own
            recv() and send(), through the same hub, amid the same traffic
    core    processor time of the controller's process over wall time, in gear
    memory  its resident set; where asammdf is installed (extra `mf4`), python-can imports it, and
            that alone takes some 85 MB

Windows of the controller and of the echo take turns. Other work on the machine shows in all of
them: the median of the windows is printed, and the ratio of the two.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import can

from benchmarks.bench_rig_live import (
    START_LIMIT_S,
    processor_s,
    python_process,
    quantile,
    rig_process,
)
from meshpoint.bus.local.register import register_interface
from meshpoint.dbc.edges import EDGE_IDS
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ValveCommand

EDGES = frozenset(EDGE_IDS)
COMMAND = CODECS[ValveCommand.__name__].spec.can_id
PING, PONG = 0x18FFEE01, 0x18FFEE02
PING_EVERY_S = 0.01
WARM_S = 5.0
ECHO = f"""
import can, sys
from meshpoint.bus.local.register import register_interface
register_interface()
filters = [{{"can_id": {PING}, "can_mask": 0x1FFFFFFF, "extended": True}}]
bus = can.Bus(sys.argv[1], "meshpoint", ignore_config=True, can_filters=filters)
with bus:
    for message in bus:
        if message.arbitration_id == {PING}:
            bus.send(can.Message(arbitration_id={PONG}, data=message.data, is_extended_id=True))
"""


class Window(NamedTuple):
    """What one window of time showed, ms and per cent."""

    answer_p50_ms: float
    answer_p99_ms: float
    answer_least_ms: float
    core_percent: float
    echo_p50_ms: float
    echo_p99_ms: float


def heard(bus: can.BusABC, can_id: int) -> None:
    """Waits for a frame of this identifier."""
    end = time.monotonic() + START_LIMIT_S
    while time.monotonic() < end:
        message = bus.recv(1.0)
        if message is not None and message.arbitration_id == can_id:
            return
    raise TimeoutError(f"no frame {can_id:X} within {START_LIMIT_S} s")


def answers_ms(bus: can.BusABC, seconds: float) -> list[float]:
    """From the last edge frame to each valve command."""
    found: list[float] = []
    edge_s: float | None = None
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        message = bus.recv(0.1)
        now = time.perf_counter()
        if message is None:
            continue
        if message.arbitration_id in EDGES:
            edge_s = now
        elif message.arbitration_id == COMMAND and edge_s is not None:
            found.append((now - edge_s) * 1e3)
            edge_s = None
    return found


def echoes_ms(bus: can.BusABC, seconds: float) -> list[float]:
    """From each frame sent to its echo."""
    found: list[float] = []
    ping = can.Message(arbitration_id=PING, data=bytes(8), is_extended_id=True)
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        sent_s = time.perf_counter()
        bus.send(ping)
        while True:
            message = bus.recv(1.0)
            if message is None or message.arbitration_id == PONG:
                break
        found.append((time.perf_counter() - sent_s) * 1e3)
        while time.perf_counter() < sent_s + PING_EVERY_S:
            bus.recv(0.001)
    return found


def window(bus: can.BusABC, pid: int, seconds: float) -> Window:
    """The controller for a while, then the echo for as long."""
    before_s, begin = processor_s(pid), time.perf_counter()
    answers = answers_ms(bus, seconds)
    share = (processor_s(pid) - before_s) / (time.perf_counter() - begin)
    echoes = echoes_ms(bus, seconds)
    return Window(
        statistics.median(answers), quantile(answers, 0.99), min(answers), 100.0 * share,
        statistics.median(echoes), quantile(echoes, 0.99),
    )  # fmt: skip


def resident_mb(pid: int) -> float:
    """The resident set of a process."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    return int(status.partition("VmRSS:")[2].split()[0]) / 1024.0


def measured(windows: int, seconds: float) -> dict[str, float]:
    """The medians of the windows."""
    register_interface()
    with tempfile.TemporaryDirectory(prefix="meshpoint-") as folder:
        channel = f"unix:{folder}/bus.sock"
        words = ("controller", "--gearbox", "thesis", "-q", "-c", channel)
        controller = ("-m", "meshpoint", *words)
        with (
            can.Bus(interface="meshpoint", channel=channel, ignore_config=True) as bus,
            rig_process(channel),
            python_process(*controller) as process,
            python_process("-c", ECHO, channel),
        ):
            heard(bus, COMMAND)
            answers_ms(bus, WARM_S)
            echoes_ms(bus, WARM_S)
            found = [window(bus, process.pid, seconds) for _ in range(windows)]
            memory_mb = resident_mb(process.pid)
    columns = zip(*found, strict=True)
    medians = {
        name: round(statistics.median(column), 3)
        for name, column in zip(Window._fields, columns, strict=True)
    }
    ratio = statistics.median(each.answer_p99_ms / each.echo_p99_ms for each in found)
    return medians | {"p99_ratio": round(ratio, 2), "memory_mb": round(memory_mb, 1)}


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--windows", type=int, default=6)
    parser.add_argument("--seconds", type=float, default=5.0, help="of each window")
    namespace = parser.parse_args(argv)
    figures = measured(namespace.windows, namespace.seconds)
    if namespace.json:
        print(json.dumps(figures))
    else:
        print(
            f"controller process, in gear: last edge frame to valve command "
            f"{figures['answer_least_ms']} ms at least, {figures['answer_p50_ms']} ms median, "
            f"{figures['answer_p99_ms']} ms p99; python-can echo {figures['echo_p50_ms']} ms "
            f"median, {figures['echo_p99_ms']} ms p99: ratio of p99 {figures['p99_ratio']}; "
            f"{figures['core_percent']} % of a core, {figures['memory_mb']} MB"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
