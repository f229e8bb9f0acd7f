"""Who hears what the cache of compiled kernels does. Loads nothing: any command may."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final


def _say(line: str) -> None:
    sys.stderr.write(f"meshpoint: {line}\n")
    sys.stderr.flush()


class CacheWatch:
    """What a command may set to show it."""

    say: Callable[[str], None] = staticmethod(_say)
    """A line for people: kernels are kept elsewhere than usual, or are damaged."""
    compiling: Callable[[str], None] = staticmethod(lambda _title: None)
    """A kernel of this title, as `rig_sim.truck.kernels.advance`, is about to be compiled, which
    takes a second or many."""

    taken: Callable[[Any, Any, bytes], None] = staticmethod(
        lambda _kernel, _signature, _content: None
    )
    """A kernel that is in use from here on, whether it was compiled before or now: its
    `KernelCache`, signature and what a file of it holds."""

    def __init__(self) -> None:
        self._said: set[str] = set()

    def once(self, line: str) -> None:
        """Says a line once a process."""
        if line not in self._said:
            self._said.add(line)
            self.say(line)


WATCH: Final = CacheWatch()
MANY_OBJECTS: Final = 10_000
"""More are made where modules or kernels are loaded; to parse a line takes some hundreds."""


@contextmanager
def uncollected() -> Iterator[None]:
    """Loading and compiling within it leave the garbage collector out, which otherwise takes a
    seventh of the time: modules and numba make many objects and keep nearly all. Where they made
    many, what there is then is set aside for good."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            if gc.get_count()[0] > MANY_OBJECTS:
                gc.freeze()
            gc.enable()
