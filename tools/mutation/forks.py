"""What is run in a process of its own, with limits."""

from __future__ import annotations

import json
import os
import resource
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

MORE_BYTES: Final = 3 << 30
"""So much more memory than its parent has may a process take."""
FAILED: Final = 1


def used_s() -> float:
    """Processor time of this process and of those it has waited for."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def limit(cpu_s: float) -> None:
    """Of this process, from here on: so much processor time, and memory."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    until = int(used.ru_utime + used.ru_stime + cpu_s) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (until, until + 5))
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * resource.getpagesize() + MORE_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def in_a_fork(run: Callable[[], dict[str, Any]], wall_s: float | None = None) -> Any:
    """What `run` returns in a process of its own; None if that has ended otherwise."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        status = FAILED
        try:
            os.close(reader)
            os.setpgid(0, 0)
            nothing = os.open(os.devnull, os.O_RDWR)
            for number in (0, 1, 2):
                os.dup2(nothing, number)
            text = json.dumps(run()).encode()
            with os.fdopen(writer, "wb") as pipe:
                pipe.write(text)
            status = 0
        finally:
            os._exit(status)
    os.close(writer)
    text = _read(reader, child, wall_s)
    _, status = os.waitpid(child, 0)
    return json.loads(text) if status == 0 and text else None


def _used_by(process: int) -> float:
    """Processor time of a process so far."""
    fields = Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _read(reader: int, child: int, wall_s: float | None) -> bytes:
    import select

    text, until_s = b"", None if wall_s is None else time.monotonic() + wall_s
    used_s = 0.0
    while True:
        left_s = None if until_s is None else max(0.0, until_s - time.monotonic())
        if not select.select([reader], [], [], left_s)[0]:
            before_s, used_s = used_s, _used_by(child)
            if wall_s is not None and used_s > before_s:
                until_s = time.monotonic() + wall_s  # it is the machine that is busy
                continue
            os.killpg(child, signal.SIGKILL)
            break
        part = os.read(reader, 1 << 16)
        if not part:
            break
        text += part
    os.close(reader)
    return text
