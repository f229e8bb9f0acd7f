"""Nodes as child processes: their lines named, ended by the end of their standard input."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final

from meshpoint.bus.signals import apart

END_S: Final = 15.0
"""Wall seconds that a child may take to end; then it is killed."""
LAST_LINES: Final = 5

Show = Callable[[str, str], None]


@dataclass
class Child:
    """One child process."""

    name: str
    process: asyncio.subprocess.Process
    reader: asyncio.Task[None]
    said: deque[str] = field(default_factory=lambda: deque(maxlen=LAST_LINES))
    """Its last lines."""

    @property
    def code(self) -> int | None:
        """Its exit code; None while it runs."""
        return self.process.returncode


async def spawn(name: str, command: list[str], show: Show | None) -> Child:
    """Starts `python COMMAND`; every line it says goes to `show` under its name."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, *command, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, env=os.environ | {"PYTHONUNBUFFERED": "1"}, **apart(),
    )  # fmt: skip
    said: deque[str] = deque(maxlen=LAST_LINES)
    reader = asyncio.create_task(_read(name, process.stdout, said, show))
    return Child(name, process, reader, said)


async def _read(
    name: str, output: asyncio.StreamReader | None, said: deque[str], show: Show | None
) -> None:
    while output is not None:
        try:
            line = await output.readline()
        except ValueError:  # longer than asyncio keeps; it has dropped it
            continue
        if not line:
            return
        # A node's lines begin with its name, for terminals that it shares with others.
        text = line.decode(errors="replace").rstrip().removeprefix(f"{name}: ")
        said.append(text)
        if show is not None:
            show(name, text)


async def end_all(children: list[Child]) -> list[Child]:
    """Ends them one after the other; those that did not end well, which a killed one did not."""
    for child in children:
        if child.process.stdin is not None:
            with suppress(BrokenPipeError, ConnectionResetError):
                child.process.stdin.close()
        try:
            await asyncio.wait_for(child.process.wait(), END_S)
        except TimeoutError:
            with suppress(ProcessLookupError):
                child.process.kill()
            await child.process.wait()
        await child.reader
    return [child for child in children if child.code != 0]
