"""Compiled kernels are kept by what they depend on; no file that is wrong ends a run."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import sys
import types
from pathlib import Path
from typing import Any

import numba
import pytest

from meshpoint.kernels import cache as kernel_cache
from meshpoint.kernels import folder as kernel_folder
from meshpoint.kernels.cache import KernelCache, digest_of, keep_compiled
from meshpoint.kernels.folder import KernelFolder
from meshpoint.kernels.pieces import piece_of_kernels
from meshpoint.kernels.watch import CacheWatch

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled here")


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    lines: list[str] = []
    watch = CacheWatch()
    watch.say = lines.append
    monkeypatch.setattr(kernel_cache, "WATCH", watch)
    return lines


def doubled(*places: Path, factor: float = 2.0) -> Any:
    @numba.njit  # type: ignore[untyped-decorator,unused-ignore]
    def double(x: float) -> float:
        return factor * x

    double._cache = KernelCache(double, [KernelFolder(place) for place in places])
    return double


def hits(kernel: Any) -> int:
    return sum(kernel.stats.cache_hits.values())


def test_a_folder_that_cannot_be_written_is_passed_over(tmp_path: Path, said: list[str]) -> None:
    in_the_way, own = tmp_path / "file", tmp_path / "own"
    in_the_way.write_text("not a folder")
    assert doubled(in_the_way / "cache", own)(2.0) == 4.0
    assert len(list(own.iterdir())) == 1
    assert len(said) == 1 and str(own) in said[0]
    again = doubled(in_the_way / "cache", own)
    assert again(3.0) == 6.0
    assert hits(again) == 1 and len(said) == 1


def test_with_nowhere_to_keep_kernels_it_goes_on_and_says_so(
    tmp_path: Path, said: list[str]
) -> None:
    (tmp_path / "file").write_text("not a folder")
    kernel = doubled(tmp_path / "file" / "a", tmp_path / "file" / "b")
    assert kernel(2.0) == 4.0 and kernel(2) == 4.0
    assert len(said) == 1 and "NUMBA_CACHE_DIR" in said[0]


def test_a_read_only_folder_that_holds_the_kernels_is_enough(
    tmp_path: Path, said: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    doubled(tmp_path)(2.0)

    def refuse(*_arguments: Any) -> None:
        raise PermissionError(13, "read-only")

    monkeypatch.setattr(KernelFolder, "write", refuse)
    kernel = doubled(tmp_path)
    assert kernel(2.0) == 4.0
    assert hits(kernel) == 1 and said == []


def test_a_flipped_bit_is_found_before_the_code_is_run(tmp_path: Path, said: list[str]) -> None:
    doubled(tmp_path)(2.0)
    (entry,) = tmp_path.iterdir()
    raw = bytearray(entry.read_bytes())
    raw[len(raw) // 2] ^= 4
    entry.write_bytes(raw)
    kernel = doubled(tmp_path)
    assert kernel(2.0) == 4.0
    assert hits(kernel) == 0
    assert said == [f"compiled kernels in {tmp_path} are damaged and compiled again"]


def in_a_wheel(folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """What `ship` puts beside the code, of the kernel `doubled`; it is found there from now on."""
    watch = CacheWatch()
    wheel = KernelFolder(folder)
    watch.taken = lambda kernel, signature, content: wheel.write(
        kernel.portable(signature), content
    )
    monkeypatch.setattr(kernel_cache, "WATCH", watch)
    doubled(folder.parent / "builder")(2.0)
    monkeypatch.setattr(kernel_folder, "SHIPPED", folder)
    return list(folder.iterdir())


def test_what_came_with_the_wheel_is_taken_and_nothing_is_compiled_or_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: list[str]
) -> None:
    assert len(in_a_wheel(tmp_path / "wheel", monkeypatch)) == 1
    kernel = doubled(tmp_path / "own")
    assert kernel(2.0) == 4.0
    assert hits(kernel) == 1 and said == [] and not (tmp_path / "own").exists()


def test_a_python_that_has_not_been_seen_to_run_them_compiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    in_a_wheel(tmp_path / "wheel", monkeypatch)
    monkeypatch.setattr(kernel_cache, "SERVED", ((3, 10),))
    kernel = doubled(tmp_path / "own")
    assert kernel(2.0) == 4.0
    assert hits(kernel) == 0


def test_a_damaged_kernel_of_the_wheel_is_compiled_and_kept_by_the_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (shipped,) = in_a_wheel(tmp_path / "wheel", monkeypatch)
    shipped.write_bytes(shipped.read_bytes()[:-1])
    kernel = doubled(tmp_path / "own")
    assert kernel(2.0) == 4.0
    assert hits(kernel) == 0 and len(list((tmp_path / "own").iterdir())) == 1


@pytest.mark.parametrize(
    ("given", "allowed"),
    [({}, {"x86-64-v3", "None"}), ({"NUMBA_CPU_NAME": "generic"}, {"generic"})],
    ids=["by_itself", "as_asked"],
)
def test_kernels_are_for_a_kind_of_processor_not_for_the_one_at_hand(
    given: dict[str, str], allowed: set[str]
) -> None:
    """ "None": this machine has no such processor."""
    script = (
        "import meshpoint.kernels.target, numba\n"
        "print(numba.core.config.CPU_NAME, meshpoint.kernels.target.has_common())"
    )
    environment = {key: value for key, value in os.environ.items() if "NUMBA_CPU" not in key}
    found = subprocess.run(
        [sys.executable, "-c", script], env=environment | given, capture_output=True, text=True,
        check=True,
    ).stdout.split()  # fmt: skip
    assert found[0] in allowed
    if not given:
        assert (found[0] == "x86-64-v3") == (found[1] == "True")


def test_a_piece_of_kernels_can_be_called_from_python_too() -> None:
    """It has no door of its own for that: called all the same, it must not be jumped into."""

    def twice(x: float) -> float:
        return 2.0 * x

    piece = piece_of_kernels(twice)

    @numba.njit  # type: ignore[untyped-decorator,unused-ignore]
    def kernel(x: float) -> float:
        return piece(x) + 1.0

    assert kernel(1.0) == 3.0
    assert piece(1.0) == 2.0


def test_pieces_of_pieces_are_whole_in_a_kernel_and_in_what_is_kept_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Machine code is made of the kernel alone, and the kernel is loaded without its pieces: two
    signatures of a piece, one that another piece calls as well."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))

    def twice(x: float) -> float:
        return x + x

    def far(x: float) -> float:
        return math.hypot(piece(x), float(piece(2)))

    piece, beyond = piece_of_kernels(twice), piece_of_kernels(far, forceinline=True)

    def kernel(x: float) -> float:
        return float(beyond(x) + piece(x))

    for from_disk in (0, 1):
        made = numba.njit(kernel)
        keep_compiled(made)
        assert made(1.5) == 5.0 + 3.0
        assert hits(made) == from_disk
    assert {len(each.signatures) for each in (piece, beyond)} == {1, 2}
    for made in (piece, beyond):
        assert not any(callable(each.entry_point) for each in made.overloads.values())


def test_a_controller_in_a_run_has_its_kernels_once_each() -> None:
    """A kernel called with columns where it was made for rows is compiled once more, in a step."""
    script = """
import gc
from numba.core.registry import CPUDispatcher
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.run.warm_up import warm_up
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile
from meshpoint.campaigns.draw import draw, upshifts
from meshpoint.campaigns.loop import ClosedLoop

def made():
    return {each.py_func.__qualname__: len(each.overloads) for each in gc.get_objects()
            if type(each) is CPUDispatcher and each.py_func.__module__.startswith(
                "meshpoint.controller")}

warm_up()
before, sheet = made(), load_sheet("truck12")
loop = ClosedLoop(sheet, ControllerSettings(), Preset.TRUCK,
                  draw(7, sheet, Preset.TRUCK, upshifts(), 3, {}, Profile.TYPICAL))
for _ in range(3):
    loop.shift()
print([name for name, count in made().items() if count > before.get(name, 0)])
"""
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert found.stdout.strip() == "[]", found.stderr


KEPT_AND_NEW = """
import sys
from meshpoint.bench.compiling import prepare

prepare()
print("numba.np.linalg" in sys.modules)

import numba
import numpy as np

@numba.njit
def added(x):
    return np.sqrt(x).sum()

print(added(np.array([4.0, 9.0])))
"""


def test_kernels_that_are_kept_are_loaded_without_what_compiles() -> None:
    """numba's operations on arrays, and scipy's with them: a sixth of a start."""
    subprocess.run([sys.executable, "-m", "meshpoint.bench.compiling"], check=True)
    found = subprocess.run(
        [sys.executable, "-c", KEPT_AND_NEW], capture_output=True, text=True, check=True
    )
    assert found.stdout.split() == ["False", "5.0"], "loaded at a start, or missed by a new kernel"


SOURCE = """
import math
from numba import njit

SCALE = 2.0
TABLE = (1, 2)

@njit
def piece(x):
    return x * SCALE

def of(offset):
    @njit
    def kernel(x):
        return piece(x) + math.exp(TABLE[0]) + offset
    return kernel

kernel = of(1.0)
"""


def digest(source: str, module_name: str = "made") -> str:
    module = types.ModuleType(module_name)
    exec(source, module.__dict__)
    return digest_of(module.kernel.py_func)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("SCALE = 2.0", "SCALE = 2.5"),
        ("TABLE = (1, 2)", "TABLE = (1, 3)"),
        ("return x * SCALE", "return SCALE - x"),
        ("math.exp", "math.log"),
        ("of(1.0)", "of(1.5)"),
        ("@njit\ndef piece", "@njit(fastmath=True)\ndef piece"),
    ],
)
def test_every_change_behind_a_kernel_is_another_entry(before: str, after: str) -> None:
    assert before in SOURCE
    assert digest(SOURCE.replace(before, after)) != digest(SOURCE)


def test_a_piece_that_moved_to_another_file_is_another_entry() -> None:
    """Machine code names the modules of its pieces, and they are imported when it is loaded."""
    assert digest(SOURCE, "renamed") != digest(SOURCE)


def test_what_a_kernel_does_not_use_is_no_other_entry() -> None:
    assert digest(SOURCE) == digest("# moved\n\n" + SOURCE + "\nOTHER = 3\n")


BY_SOURCE = """
import sys
sys.path.insert(0, sys.argv[1])
from meshpoint.rig_sim.shared.angle_kernels import settled, wrapped
from meshpoint.kernels.digest import digest_by_source
print(digest_by_source(wrapped), digest_by_source(settled))
"""


def test_a_wheels_kernel_is_one_of_its_source_whatever_python_makes_of_it(tmp_path: Path) -> None:
    """The compiler's bytecode is another in each Python, and with -OO: no docstrings."""
    copy = tmp_path / "meshpoint"
    for part in ("meshpoint", "rig_sim"):
        shutil.copytree(ROOT / part, copy if part == "meshpoint" else copy / part,
                        ignore=shutil.ignore_patterns("__pycache__", "testbench"))  # fmt: skip

    def digests(*options: str) -> list[str]:
        command = [sys.executable, *options, "-P", "-c", BY_SOURCE, str(tmp_path)]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()

    before = digests()
    assert len(set(before)) == 2
    assert digests("-OO") == before
    with (copy / "rig_sim" / "shared" / "sensor_clock.py").open("a", encoding="utf-8") as file:
        file.write("# another source\n")
    assert not set(digests()) & set(before)


def test_what_cannot_be_followed_is_refused() -> None:
    module = types.ModuleType("made")
    exec("THING = object()\ndef kernel():\n    return THING\n", module.__dict__)
    with pytest.raises(TypeError, match="whose changes nobody would see"):
        digest_of(module.kernel)


def test_the_digest_is_the_same_in_every_process() -> None:
    script = (
        "from meshpoint.controller.estimate.crossing_kernels import crossing_filter\n"
        "from meshpoint.rig_sim.truck.kernels import advance\n"
        "from meshpoint.kernels.cache import digest_of\n"
        "print(digest_of(crossing_filter), digest_of(advance))"
    )
    before = "import meshpoint.controller.run.warm_up, meshpoint.rig_sim.presets\n"
    seen = [
        subprocess.run(
            [sys.executable, "-c", text],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True, text=True, check=True,
        ).stdout
        for text, seed in ((script, "1"), (before + script, "2"))
    ]  # fmt: skip
    assert seen[0] == seen[1] and len(seen[0]) == 2 * 65
