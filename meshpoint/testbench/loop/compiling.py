"""Compiles the kernels before a run needs them: once, both sides at a time, in sight.

The nodes of a run, and the workers of a campaign, then load what is on disk instead of each
compiling the same for itself.
"""

from __future__ import annotations

import subprocess
import sys
import threading
from collections import Counter
from pathlib import Path
from time import perf_counter
from typing import IO, Final

from meshpoint.kernels.folder import KernelFolder
from meshpoint.kernels.watch import WATCH

SAID: Final = "! "
"""Begins a line of the rig's side that is no kernel's package but a message."""
RIG: Final = "rig"
"""The argument that asks for the rig's kernels alone, one line for each."""
THESIS: Final = "thesis"
"""The argument that asks for those of the preset `thesis` too."""
SHIP: Final = "ship"
"""The argument before a folder of a wheel, which all kernels of both sides are put into."""
EVERY_S: Final = 5.0
"""Between two lines where they do not overwrite each other."""

FIRST_LINE: Final = "compiling kernels, once on this machine: a minute, beside other work several"


class Progress:
    """Lines on standard error while kernels are compiled; none where all are on disk."""

    def __init__(self, out: IO[str] | None = None, rewrites: bool | None = None) -> None:
        """rewrites: one line over and over (default: on a terminal), else now and then a line."""
        self._out = sys.stderr if out is None else out
        self._begun_s = self._said_s = perf_counter()
        self._rewrites = self._out.isatty() if rewrites is None else rewrites
        self._counts: Counter[str] = Counter()
        self._lock = threading.Lock()

    @property
    def compiled(self) -> int:
        """How many kernels were not on disk."""
        return self._counts.total()

    def count(self, package: str) -> None:
        """A kernel of this package is about to be compiled."""
        with self._lock:
            self._counts[package] += 1
            now_s = perf_counter()
            if self.compiled == 1:
                self._say(FIRST_LINE)
            elif self._rewrites or now_s - self._said_s > EVERY_S:
                self._say(self._line(now_s))

    def close(self) -> None:
        """All are there."""
        if self.compiled:
            self._say(self._line(perf_counter()) + ", done")
            if self._rewrites:
                self._out.write("\n")

    def _line(self, now_s: float) -> str:
        each = ", ".join(f"{package} {count}" for package, count in sorted(self._counts.items()))
        return f"compiling kernels: {each}, {now_s - self._begun_s:.0f} s"

    def _say(self, line: str) -> None:
        self._said_s = perf_counter()
        self._out.write(f"\r\033[K{line}" if self._rewrites else line + "\n")
        self._out.flush()


def prepare(thesis: bool = False, baselines: bool = True) -> int:
    """Loads the controller's kernels here and has the rig's compiled beside, where they are not on
    disk; shows how far it is. Returns how many had to be compiled.

    thesis: also the rig's of the preset `thesis`; baselines: also the controller's of the
    estimators `thesis` and `window`, which a run scores beside the one in use."""
    from meshpoint.kernels.jit import DISABLED

    if DISABLED:
        return 0
    from meshpoint.testbench.loop.compiled_mark import CompiledMark

    progress = Progress()
    mark = CompiledMark(THESIS if thesis else RIG)
    if mark.is_there():
        _warm_up(progress, baselines)
    elif _both_sides(progress, thesis, baselines) == 0:
        mark.set()
    progress.close()
    return progress.compiled


def _warm_up(progress: Progress, baselines: bool) -> None:
    """The controller's kernels, loaded here or compiled."""
    before = WATCH.compiling
    WATCH.compiling = progress.count
    try:
        from meshpoint.controller.warm_up import warm_up

        warm_up(baselines)
    finally:
        WATCH.compiling = before


def _both_sides(progress: Progress, thesis: bool, baselines: bool) -> int:
    """The controller's kernels here, and beside it the rig's in a process of its own, whose exit
    code is returned."""
    command = [sys.executable, "-m", "meshpoint.testbench.loop.compiling", RIG]
    command += [THESIS] if thesis else []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as rig:  # noqa: S603 (ours)
        reader = threading.Thread(target=_follow, args=(rig.stdout, progress))
        reader.start()
        try:
            _warm_up(progress, baselines)
        except BaseException:
            rig.kill()
            raise
        finally:
            reader.join()
    return rig.returncode


def _follow(lines: IO[str] | None, progress: Progress) -> None:
    for line in lines or ():
        if line.startswith(SAID):
            WATCH.once(line.removeprefix(SAID).strip())
        else:
            progress.count(line.strip())


def main() -> int:
    """`python -m meshpoint.testbench.loop.compiling`: compiles all kernels of both sides."""
    arguments = sys.argv[1:]
    if arguments[:1] == [SHIP]:
        _ship(Path(arguments[1]))
    elif RIG in arguments:
        _tell_lines()
        _load_rig(THESIS in arguments)
    else:
        prepare(thesis=True)
    return 0


def _ship(path: Path) -> None:
    """Puts the kernels into a folder: those on disk, and what has to be compiled."""
    from meshpoint.controller.warm_up import warm_up
    from meshpoint.testbench.loop.compiled_mark import CompiledMark

    folder = KernelFolder(path)
    WATCH.taken = lambda kernel, signature, content: folder.write(
        kernel.portable(signature), content
    )
    warm_up(baselines=True)
    _load_rig(thesis=True)
    for kernels in (RIG, THESIS):
        CompiledMark(kernels).ship(folder)


def _tell_lines() -> None:
    """One line for each kernel. What the cache has to say goes the same way, so that both sides say
    it once."""

    def tell(package: str) -> None:
        sys.stdout.write(package + "\n")
        sys.stdout.flush()

    WATCH.compiling = tell
    WATCH.say = lambda line: tell(SAID + line)


def _load_rig(thesis: bool) -> None:
    """The rig's kernels, loaded here or compiled; those by which the truck's true future is looked
    up too."""
    from meshpoint.gearbox import load_sheet
    from meshpoint.rig_sim.presets import warm_up
    from meshpoint.rig_sim.settings import Preset

    for preset in (Preset.TRUCK, Preset.THESIS) if thesis else (Preset.TRUCK,):
        warm_up(load_sheet("truck12"), preset)


if __name__ == "__main__":
    raise SystemExit(main())
