"""Compiles the kernels before a run needs them: once, on up to three cores at a time, in sight.

The nodes of a run, and the workers of a campaign, then load what is on disk instead of each
compiling the same for itself.
"""

from __future__ import annotations

import functools
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from time import perf_counter
from typing import IO, Final

from meshpoint.kernels.folder import KernelFolder
from meshpoint.kernels.watch import WATCH

SAID, BEGUN, TAKEN = "! ", "+ ", "= "
"""Begin a line of a part's process: a message, a kernel that it compiles, one that it has."""
SENSING, ESTIMATION, RIG, THESIS = "sensing", "estimation", "rig", "thesis"
"""Parts of the kernels that are compiled beside each other: 17, 28 and 18 s of processor time, and
a few; `thesis` is the rig of that preset."""
KERNELS: Final = {SENSING: 10, ESTIMATION: 22, RIG: 9, THESIS: 10}
"""How many each has; `angle_kernels`, which both rigs have, once."""
SHIP: Final = "ship"
"""The argument before a folder of a wheel, which all kernels of both sides are put into."""
EVERY_S: Final = 5.0
"""Between two lines where they do not overwrite each other."""
BAR: Final = 20
WIDTH: Final = 79

FIRST_LINE: Final = "compiling kernels, once on this machine: a minute's work, on up to three cores"


class Progress:
    """Lines on standard error while kernels are compiled; none where all are on disk."""

    def __init__(
        self, out: IO[str] | None = None, rewrites: bool | None = None, total: int | None = None
    ) -> None:
        """rewrites: one line over and over (default: on a terminal), else now and then a line.
        total: how many kernels are looked for, where that is known."""
        self._out = sys.stderr if out is None else out
        self._begun_s = self._said_s = perf_counter()
        self._rewrites = self._out.isatty() if rewrites is None else rewrites
        self._total = total
        self._taken: set[str] = set()
        self._now: dict[str, None] = {}
        """Titles of those that are being compiled, in their order."""
        self._lock = threading.Lock()
        self.compiled = 0
        """How many kernels were not on disk."""

    def count(self, title: str) -> None:
        """This kernel is about to be compiled."""
        with self._lock:
            self.compiled += 1
            self._now[title] = None
            if self.compiled == 1:
                self._say(FIRST_LINE + why_compiled())
                self._out.write("\n" if self._rewrites else "")
            elif self._rewrites or perf_counter() - self._said_s > EVERY_S:
                self._say(self._line())

    def take(self, title: str) -> None:
        """This kernel is there."""
        with self._lock:
            self._taken.add(title)
            self._now.pop(title, None)

    def close(self) -> None:
        """All are there."""
        if self.compiled:
            self._now.clear()
            self._say(self._line() + ", done")
            if self._rewrites:
                self._out.write("\n")

    def _line(self) -> str:
        done = f"{self.compiled}"
        if self._total is not None:
            share = min(1.0, len(self._taken) / self._total)
            bar = "#" * round(share * BAR)
            done = f"[{bar:.<{BAR}}] {len(self._taken)} of {self._total}"
        now = ", ".join(title.rpartition(".")[2] for title in self._now)
        line = f"compiling kernels {done}, {perf_counter() - self._begun_s:.0f} s"
        return f"{line}: {now}"[:WIDTH] if now else line

    def _say(self, line: str) -> None:
        self._said_s = perf_counter()
        self._out.write(f"\r\033[K{line}" if self._rewrites else line + "\n")
        self._out.flush()


def why_compiled() -> str:
    """Why the kernels that came with a wheel are of no use here, as the end of a sentence; empty
    where none came."""
    from meshpoint.kernels.cache import SERVED, takes_shipped
    from meshpoint.kernels.folder import has_shipped

    if not has_shipped():
        return ""
    if not takes_shipped():
        first, last = (f"{major}.{minor}" for major, minor in (SERVED[0], SERVED[-1]))
        return f"\n(those that meshpoint comes with are for Python {first} to {last})"
    return (
        "\n(those that meshpoint comes with are for the numba and numpy that "
        "python -m meshpoint.constraints\nnames, and for x86-64 processors with AVX2 and FMA)"
    )


def prepare(thesis: bool = False, baselines: bool = True) -> int:
    """Loads the controller's kernels here and has all compiled beside, where they are not on disk;
    shows how far it is. Returns how many had to be compiled.

    thesis: also the rig's of the preset `thesis`; baselines: also the controller's of the
    estimators `thesis` and `window`, which a run scores beside the one in use."""
    from meshpoint.kernels.jit import DISABLED

    if DISABLED:
        return 0
    from meshpoint.bench.compiled_mark import CompiledMark

    parts = (SENSING, ESTIMATION, RIG, *([THESIS] if thesis else []))
    progress = Progress(total=sum(KERNELS[part] for part in parts))
    mark = CompiledMark(THESIS if thesis else RIG)
    if not mark.is_there() and _apart(parts, progress):
        mark.set()
    _warm_up(progress, baselines)
    progress.close()
    return progress.compiled


prepare_once = functools.cache(prepare)
"""At the first run in a process."""


def _warm_up(progress: Progress, baselines: bool) -> None:
    """The controller's kernels, loaded here or compiled."""
    before = WATCH.compiling
    WATCH.compiling = progress.count
    try:
        from meshpoint.controller.run.warm_up import warm_up

        warm_up(baselines)
    finally:
        WATCH.compiling = before


def _apart(parts: tuple[str, ...], progress: Progress) -> bool:
    """Each of these in a process of its own; whether all came to their end."""
    with ExitStack() as stack:
        running = []
        for part in parts:
            command = [sys.executable, "-m", "meshpoint.bench.compiling", part]
            one = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)  # noqa: S603 (ours)
            stack.enter_context(one)
            stack.callback(one.kill)
            running.append(one)
        readers = [threading.Thread(target=_follow, args=(one.stdout, progress)) for one in running]
        for reader in readers:
            reader.start()
        for reader in readers:
            reader.join()
        codes = [one.wait() for one in running]
    return not any(codes)


def _follow(lines: IO[str] | None, progress: Progress) -> None:
    for line in lines or ():
        sign, said = line[: len(SAID)], line[len(SAID) :].strip()
        if sign == SAID:
            WATCH.once(said)
        elif sign == BEGUN:
            progress.count(said)
        elif sign == TAKEN:
            progress.take(said)


def main() -> int:
    """`python -m meshpoint.bench.compiling`: compiles all kernels of both sides."""
    arguments = sys.argv[1:]
    if arguments[:1] == [SHIP]:
        _ship(Path(arguments[1]))
    elif arguments:
        _tell_lines()
        _load(arguments[0])
    else:
        prepare(thesis=True)
    return 0


def _ship(path: Path) -> None:
    """Puts the kernels into a folder: those on disk, and what has to be compiled."""
    from meshpoint.bench.compiled_mark import CompiledMark

    folder = KernelFolder(path)
    WATCH.taken = lambda kernel, signature, content: folder.write(
        kernel.portable(signature), content
    )
    for part in KERNELS:
        _load(part)
    for kernels in (RIG, THESIS):
        CompiledMark(kernels).ship(folder)


def _tell_lines() -> None:
    """Lines for `_follow`. What the cache has to say goes the same way, so that all parts say it
    once."""

    def tell(line: str) -> None:
        sys.stdout.write(line + "\n")
        sys.stdout.flush()

    WATCH.compiling = lambda title: tell(BEGUN + title)
    WATCH.taken = lambda kernel, _signature, _content: tell(TAKEN + kernel.title)
    WATCH.say = lambda line: tell(SAID + line)


def _load(part: str) -> None:
    """A part of the kernels, loaded here or compiled; with the rig's those by which the truck's
    true future is looked up."""
    from meshpoint.controller.run.warm_up import warm_up_estimation, warm_up_sensing
    from meshpoint.gearbox import load_sheet
    from meshpoint.rig_sim.presets import warm_up
    from meshpoint.rig_sim.settings import Preset

    loaders: dict[str, Callable[[], None]] = {
        SENSING: warm_up_sensing,
        ESTIMATION: lambda: warm_up_estimation(baselines=True),
        RIG: lambda: warm_up(load_sheet("truck12"), Preset.TRUCK),
        THESIS: lambda: warm_up(load_sheet("truck12"), Preset.THESIS),
    }
    loaders[part]()


if __name__ == "__main__":
    raise SystemExit(main())
