"""The rig as a process on the local bus: start-up, lateness of its 10 ms frames, processor time.

    start-up  from the start of `python -m meshpoint rig` to its first frame at a listener
    lateness  of every GearboxSensors frame at the listener, against the sample time it carries; the
              earliest frame of a window counts as on time. Hub and listener are in it
    core      processor time of the rig's process over wall time

Other work on the machine shows in all three: the quietest window counts, and how the machine kept
time is printed beside it: how late the listener itself woke from sleeps of 10 ms just before. Under
`chrt -f 10` the rig, the hub and the listener go before other work, as a rig on a bench would.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import NamedTuple

import can

from meshpoint.bus.local.register import register_interface
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import GearboxSensors

SENSORS = CODECS[GearboxSensors.__name__].spec.can_id
CLOCK_MODULUS = 1 << 32
READ_US = 10_000
START_LIMIT_S = 60.0
WARM_S = 1.0


class Window(NamedTuple):
    """What one window of time showed."""

    p99_late_ms: float
    worst_late_ms: float
    core_percent: float
    frames: int


def processor_s(pid: int) -> float:
    """Processor time a process has had so far."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def quantile(values: Sequence[float], share: float) -> float:
    """The value that this share of all does not exceed."""
    return sorted(values)[min(int(share * len(values)), len(values) - 1)]


@contextmanager
def python_process(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process of this Python with these arguments; ended at the end."""
    command = [sys.executable, *arguments]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL) as process:  # noqa: S603 (our own)
        try:
            yield process
        finally:
            process.terminate()


def rig_process(channel: str) -> AbstractContextManager[subprocess.Popen[bytes]]:
    """A rig, truck preset, sheet thesis, on this channel; ended at the end."""
    rig = ("rig", "--preset", "truck", "--gearbox", "thesis", "-q", "-c", channel)
    return python_process("-m", "meshpoint", *rig)


def start_up_s(bus: can.BusABC, channel: str) -> tuple[float, float]:
    """Starts a rig and ends it as soon as it is heard: wall time and processor time."""
    begin = time.perf_counter()
    with rig_process(channel) as process:
        if bus.recv(START_LIMIT_S) is None:
            raise TimeoutError(f"no frame from the rig within {START_LIMIT_S} s")
        elapsed_s, core_s = time.perf_counter() - begin, processor_s(process.pid)
    while bus.recv(0.2) is not None:
        pass
    return elapsed_s, core_s


def watch(bus: can.BusABC, pid: int, seconds: float) -> Window:
    """Listens for a while."""
    before_s, begin = processor_s(pid), time.perf_counter()
    ahead_us: list[float] = []
    first_clock: int | None = None
    while (now := time.perf_counter()) < begin + seconds:
        message = bus.recv(0.1)
        if message is None or message.arbitration_id != SENSORS:
            continue
        arrived_us = (time.perf_counter() - begin) * 1e6
        clock = int.from_bytes(message.data[3:7], "little")
        first_clock = clock if first_clock is None else first_clock
        ahead_us.append(arrived_us - (clock - first_clock) % CLOCK_MODULUS)
    on_time = min(ahead_us)
    late_ms = [(value - on_time) / 1e3 for value in ahead_us]
    share = (processor_s(pid) - before_s) / (now - begin)
    return Window(quantile(late_ms, 0.99), max(late_ms), 100.0 * share, len(late_ms))


def own_lateness_ms() -> float:
    """p99 of how late this process wakes from 200 sleeps of 10 ms."""
    late = []
    for _ in range(200):
        due = time.perf_counter() + READ_US / 1e6
        time.sleep(READ_US / 1e6)
        late.append((time.perf_counter() - due) * 1e3)
    return quantile(late, 0.99)


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--starts", type=int, default=5)
    parser.add_argument("--windows", type=int, default=6)
    parser.add_argument("--seconds", type=float, default=5.0, help="of each window")
    namespace = parser.parse_args(argv)
    register_interface()
    with tempfile.TemporaryDirectory(prefix="meshpoint-") as folder:
        channel = f"unix:{folder}/bus.sock"
        with can.Bus(interface="meshpoint", channel=channel, ignore_config=True) as bus:
            starts_s = [start_up_s(bus, channel) for _ in range(namespace.starts)]
            machine_ms = own_lateness_ms()
            with rig_process(channel) as process:
                bus.recv(START_LIMIT_S)
                watch(bus, process.pid, WARM_S)
                windows = [
                    watch(bus, process.pid, namespace.seconds) for _ in range(namespace.windows)
                ]
    best = min(windows)
    figures = {
        "start_up_s": round(min(starts_s)[0], 2),
        "start_ups_s": [round(wall_s, 2) for wall_s, _ in starts_s],
        "start_up_core_s": round(min(core_s for _, core_s in starts_s), 2),
        "p99_late_ms": round(best.p99_late_ms, 3),
        "worst_late_ms": round(best.worst_late_ms, 3),
        "core_percent": round(min(window.core_percent for window in windows), 1),
        "frames_a_window": best.frames,
        "p99_late_ms_of_windows": [round(window.p99_late_ms, 2) for window in windows],
        "core_percent_of_windows": [round(window.core_percent, 1) for window in windows],
        "machine_p99_late_ms": round(machine_ms, 3),
    }
    if namespace.json:
        print(json.dumps(figures))
    else:
        print(
            f"rig process: first frame after {figures['start_up_s']} s (of "
            f"{figures['start_ups_s']}; {figures['start_up_core_s']} s of a core); "
            f"in the quietest of {len(windows)} windows p99 "
            f"{figures['p99_late_ms']} ms late (of {figures['p99_late_ms_of_windows']}), "
            f"{figures['core_percent']} % of a core (of {figures['core_percent_of_windows']}); "
            f"a process that only sleeps 10 ms woke {figures['machine_p99_late_ms']} ms late (p99)"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
