"""Workers end with the process that has started them, however that ends."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from meshpoint.campaigns.workers import worker_pool

PROGRAM = """
import sys, time
from meshpoint.campaigns.workers import worker_pool
if __name__ == "__main__":
    try:
        with worker_pool(2) as pool:
            work = [pool.submit(time.sleep, seconds) for seconds in (0.0, 0.0, 0.1, 1.5, 1.5)]
            work[2].result()
            print(*pool._processes, flush=True)
            time.sleep(600.0)
    except KeyboardInterrupt:
        sys.exit(130)
"""
MOST_S = 60.0


def is_there(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


@pytest.mark.skipif(not Path("/proc").exists(), reason="looks at /proc")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_parent_that_is_ended_leaves_no_worker(number: signal.Signals, tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    with subprocess.Popen([sys.executable, str(program)], stdout=subprocess.PIPE, text=True) as it:
        assert it.stdout is not None
        workers = [int(word) for word in it.stdout.readline().split()]
        assert len(workers) == 2
        assert all(map(is_there, workers))
        it.send_signal(number)
        until_s = time.monotonic() + MOST_S
        while any(map(is_there, workers)) and time.monotonic() < until_s:
            time.sleep(0.02)
        assert not any(map(is_there, workers))
        assert it.wait(MOST_S) in (130, -number)


@pytest.mark.skipif(sys.platform == "win32", reason="has no mask of signals")
def test_a_worker_never_hears_ctrl_c_not_even_as_it_starts() -> None:
    with worker_pool(1) as pool:
        blocked = pool.submit(signal.pthread_sigmask, signal.SIG_BLOCK, []).result()
    assert signal.SIGINT in blocked
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])
