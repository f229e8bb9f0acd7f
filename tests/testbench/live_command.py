"""Commands as processes of their own, whose lines can be waited for."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
POLL_S = 0.05


class LiveCommand:
    """One command; it is waited for as long as it lives, whatever the machine does meanwhile."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "meshpoint", *arguments],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]),
                "PYTHONUNBUFFERED": "1",
            },
        )
        self._lines: list[str] = []
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.append(line)

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def said(self) -> str:
        return "".join(self._lines)

    def until(self, met: Callable[[], bool]) -> None:
        """Waits for a condition, as long as the command lives."""
        while not met():
            assert self._process.poll() is None, self.said
            time.sleep(POLL_S)

    def until_said(self, text: str) -> None:
        self.until(lambda: text in self.said)

    def signal(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    def press_ctrl_c(self) -> None:
        """As a terminal does: SIGINT for the command and all that it has started in its group."""
        os.killpg(self.pid, signal.SIGINT)

    def end(self) -> int:
        """Waits for its end; the exit code."""
        code = self._process.wait()
        self._reader.join()
        return code

    def kill(self) -> None:
        if self._process.poll() is None:
            self._process.kill()
        self.end()


@contextmanager
def live(folder: Path, *arguments: str) -> Iterator[LiveCommand]:
    """A command that does not outlive the block."""
    command = LiveCommand(folder, *arguments)
    try:
        yield command
    finally:
        command.kill()
