"""How deep the stack of the board's image can become, from the compiler's call graph.

    python tests/firmware/stack_bound.py

gcc says of each function what it takes and whom it calls (`-fcallgraph-info=su`). Nothing calls
itself and nothing is called by address but the vectors, so that the longest way down is the bound:
main, on it the deepest interrupt (all of one priority, so that only one is there), on it the
fault handler; each of the two begins with a frame of 8 words, and with one more to align it
(ARMv7-M, exception entry; no floating point).
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

from meshpoint.firmware import build

ENTRY_BYTES: Final = 4 * (8 + 1)
INTERRUPTS: Final = ("on_tick", "on_can", "on_wake", "on_scan", "on_toggle")
NODE: Final = re.compile(r'^node: { title: "([^"]+)" label: "[^"]*\\n(\d+) bytes \((\w+)', re.M)
EDGE: Final = re.compile(r'^edge: { sourcename: "([^"]+)" targetname: "([^"]+)"', re.M)


class Way(NamedTuple):
    """The longest way down from a function."""

    stack_bytes: int
    functions: tuple[str, ...]


class CallGraph(NamedTuple):
    """What each function takes of the stack, and whom it calls."""

    stack_bytes: dict[str, int]
    callees: dict[str, set[str]]

    def deepest(self, root: str) -> Way:
        """From this function down. RecursionError: one calls itself."""

        @cache
        def below(name: str) -> Way:
            ways = [below(callee) for callee in sorted(self.callees.get(name, ()))]
            longest = max(ways, default=Way(0, ()))
            return Way(self.stack_bytes[name] + longest.stack_bytes, (name, *longest.functions))

        [title] = [name for name in self.stack_bytes if name.rpartition(":")[2] == root]
        return below(title)


def call_graph(folder: Path, image: str = "both") -> CallGraph:
    """Of the image's functions as gcc makes them. ValueError: one takes as much as it likes."""
    stack_bytes: dict[str, int] = {}
    callees: dict[str, set[str]] = {}
    target = (*build.CROSS_COMPILERS["gcc"][:2], *build.IMAGES[image], "-fcallgraph-info=su", "-c")
    with tempfile.TemporaryDirectory() as made:
        for source in (*folder.glob("*.c"), *(folder / "g474").glob("*.c")):
            command = [*build.cross_compiler("gcc"), *build.FLAGS, *target, str(source)]
            subprocess.run(command, cwd=made, check=True)
        for path in Path(made).glob("*.ci"):
            text = path.read_text()
            for name, size, kind in NODE.findall(text):
                if kind != "static":
                    raise ValueError(f"{name}: its part of the stack is {kind}")
                stack_bytes[name] = int(size)
            for caller, callee in EDGE.findall(text):
                callees.setdefault(caller, set()).add(callee)
    return CallGraph(stack_bytes, callees)


def bound(graph: CallGraph) -> dict[str, Way]:
    """Main, the deepest interrupt and the fault handler."""
    interrupt = max((graph.deepest(name) for name in INTERRUPTS), key=lambda way: way.stack_bytes)
    return {
        "main loop": graph.deepest("main"),
        "deepest interrupt": interrupt,
        "fault handler": graph.deepest("on_fault"),
    }


def total_bytes(ways: dict[str, Way]) -> int:
    """All three on each other."""
    return sum(way.stack_bytes for way in ways.values()) + 2 * ENTRY_BYTES


if __name__ == "__main__":
    found = bound(call_graph(build.source_folder()))
    for what, (size, functions) in found.items():
        names = (name.rpartition(":")[2] for name in functions)
        print(f"{what:18} {size:5} bytes  {' > '.join(names)}")
    print(f"{'on each other':18} {total_bytes(found):5} bytes, both exception frames with them")
