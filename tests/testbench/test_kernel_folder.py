"""Compiled kernels are run as machine code: they come from a folder that nobody else can write,
which all copies of meshpoint that a user has share, and which does not grow without end."""

from __future__ import annotations

import os
import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numba
import pytest

from meshpoint.kernels.cache import keep_compiled
from meshpoint.kernels.folder import KernelFolder, UnusableEntryError, kernel_folders, user_cache
from meshpoint.kernels.watch import WATCH

ROOT = Path(__file__).parents[2]
NOBODY = 65534
with_owners = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="Windows has no such owners")
compiling = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled here")
as_root = (
    pytest.mark.device,
    pytest.mark.skipif(
        getattr(os, "geteuid", lambda: 1)() != 0, reason="only root can give a file to another user"
    ),
)


def kept(folder: Path) -> KernelFolder:
    """The folder with one entry in it."""
    made = KernelFolder(folder)
    made.write("one.nbc", b"content")
    return made


# ---------------------------------------------------------- once on a machine ----

ONE_KERNEL = """
from meshpoint.kernels.watch import WATCH
compiled = []
WATCH.compiling = compiled.append
from meshpoint.rig_sim.shared import angle_kernels
print(angle_kernels.wrapped(0.75, 1.0), len(compiled), angle_kernels.__file__)
"""


@compiling
def test_a_second_copy_of_meshpoint_compiles_nothing(tmp_path: Path) -> None:
    found = []
    for name in ("first", "second"):
        copy = tmp_path / name / "meshpoint"
        left_out = shutil.ignore_patterns("__pycache__", "testbench")
        shutil.copytree(ROOT / "meshpoint", copy, ignore=left_out)
        shutil.copytree(ROOT / "rig_sim", copy / "rig_sim", ignore=left_out)
        environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
        environment |= {"PYTHONPATH": str(copy.parent), "TMPDIR": str(tmp_path)}
        environment.pop("NUMBA_CACHE_DIR", None)
        done = subprocess.run(
            [sys.executable, "-P", "-c", ONE_KERNEL],
            env=environment, capture_output=True, text=True, check=True,
        )  # fmt: skip
        value, compiled, file = done.stdout.split()
        assert Path(file).is_relative_to(copy)
        found.append((value, int(compiled)))
    assert found == [("-0.25", 1), ("-0.25", 0)]


def test_they_are_in_the_users_cache_folder(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert kernel_folders()[0].path == tmp_path / "meshpoint" / "kernels"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "given"))
    assert kernel_folders()[0].path == tmp_path / "given"


@pytest.mark.parametrize(
    ("platform", "folder"),
    [
        ("linux", ".cache"),
        ("darwin", "Library/Caches"),
        ("win32", "AppData/Local"),
    ],
)
def test_each_platform_has_its_own_cache_folder(
    platform: str, folder: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in ("XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    monkeypatch.setattr(sys, "platform", platform)
    assert user_cache() == tmp_path / folder


def test_a_relative_cache_folder_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """The XDG specification: paths in these variables must be absolute, others are ignored."""
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert user_cache() != Path("relative")


@with_owners
def test_a_user_without_a_home_keeps_them_in_the_temporary_folder(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in ("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("os.getuid", lambda: 999_999)  # which no user has
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    [folder] = kernel_folders()
    assert folder.path.parent == tmp_path


# ------------------------------------------------- what others could have written ----


def writable_folder(folder: Path) -> None:
    folder.chmod(0o777)


def group_writable_folder(folder: Path) -> None:
    folder.chmod(0o775)


def folder_of_another(folder: Path) -> None:
    os.chown(folder, NOBODY, NOBODY)


def linked_folder(folder: Path) -> None:
    elsewhere = folder.with_name("elsewhere")
    folder.rename(elsewhere)
    folder.symlink_to(elsewhere)


def writable_file(folder: Path) -> None:
    for file in folder.iterdir():
        file.chmod(0o666)


def file_of_another(folder: Path) -> None:
    for file in folder.iterdir():
        os.chown(file, NOBODY, NOBODY)


def linked_file(folder: Path) -> None:
    for file in list(folder.iterdir()):
        elsewhere = folder.with_name(file.name)
        file.rename(elsewhere)
        file.symlink_to(elsewhere)


Exposure = Callable[[Path], None]
FOLDERS = [
    writable_folder,
    group_writable_folder,
    linked_folder,
    pytest.param(folder_of_another, marks=as_root),
]
FILES = [writable_file, linked_file, pytest.param(file_of_another, marks=as_root)]


class Planted:
    """Unpickled, it makes a folder."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.trace),)


@with_owners
@compiling
@pytest.mark.parametrize("expose", [*FOLDERS, *FILES])
def test_what_others_could_have_planted_is_compiled_again_and_said(
    expose: Exposure, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, trace, lines = tmp_path / "kernels", tmp_path / "trace", list[str]()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(WATCH, "once", lambda line: line in lines or lines.append(line))

    def double() -> Any:
        made = numba.njit(lambda x: 2.0 * x)
        keep_compiled(made)
        assert made(2.0) == 4.0
        return sum(made.stats.cache_hits.values())

    assert double() == 0 and double() == 1 and lines == []
    for entry in list(folder.iterdir()):
        KernelFolder(folder).write(entry.name, pickle.dumps(Planted(trace)))
    expose(folder)
    assert double() == 0, "compiled, not taken from there"
    assert double() == 1, "and kept"
    assert not trace.exists()
    assert len(lines) == 1 and str(folder) in lines[0]


@with_owners
@pytest.mark.parametrize("expose", FOLDERS)
def test_a_folder_of_others_is_neither_read_nor_written(expose: Exposure, tmp_path: Path) -> None:
    folder = kept(tmp_path / "kernels")
    assert folder.read("one.nbc") == b"content"
    expose(folder.path)
    with pytest.raises(PermissionError):
        folder.read("one.nbc")
    with pytest.raises(PermissionError):
        folder.write("two.nbc", b"content")
    assert [path.name for path in folder.path.resolve().iterdir()] == ["one.nbc"]


@with_owners
@pytest.mark.parametrize("expose", FILES)
def test_a_file_of_others_is_not_taken(expose: Exposure, tmp_path: Path) -> None:
    folder = kept(tmp_path / "kernels")
    expose(folder.path)
    with pytest.raises(UnusableEntryError):
        folder.read("one.nbc")
    folder.write("one.nbc", b"mine")
    assert folder.read("one.nbc") == b"mine"


@with_owners
def test_a_pipe_in_a_files_place_holds_nobody_up(tmp_path: Path) -> None:
    folder = kept(tmp_path / "kernels")
    os.mkfifo(folder.path / "two.nbc")
    with pytest.raises(UnusableEntryError):
        folder.read("two.nbc")


@with_owners
@pytest.mark.parametrize("mask", [0o000, 0o002, 0o077])
def test_what_is_written_is_taken_whatever_the_users_mask(mask: int, tmp_path: Path) -> None:
    before = os.umask(mask)
    try:
        folder = kept(tmp_path / "cache" / "kernels")
    finally:
        os.umask(before)
    assert folder.read("one.nbc") == b"content"


# ------------------------------------------------------------------- bounded ----


def test_the_least_recently_used_go_when_the_folder_is_full(tmp_path: Path) -> None:
    folder = KernelFolder(tmp_path / "kernels", limit_bytes=3500)
    days = {"a": 4, "b": 3, "c": 2}
    for name, age in days.items():
        folder.write(f"{name}.nbc", bytes(1000))
        then_s = folder.path.stat().st_mtime - age * 86400
        os.utime(folder.path / f"{name}.nbc", (then_s, then_s))
    (folder.path / "other.txt").write_bytes(bytes(5000))
    assert folder.read("a.nbc") == bytes(1000), "which is a use"
    folder.write("d.nbc", bytes(1000))
    names = sorted(path.name for path in folder.path.iterdir())
    assert names == ["a.nbc", "c.nbc", "d.nbc", "other.txt"]


def test_a_mark_that_all_are_there_goes_with_the_first_of_them(tmp_path: Path) -> None:
    folder = KernelFolder(tmp_path / "kernels", limit_bytes=1500)
    folder.write("a.nbc", bytes(1000))
    folder.write("rig.compiled", b"")
    assert folder.read("rig.compiled") == b""
    folder.write("b.nbc", bytes(1000))
    assert [path.name for path in folder.path.iterdir()] == ["b.nbc"]


def test_several_writing_and_reading_at_once_see_whole_files_alone(tmp_path: Path) -> None:
    contents = [bytes([number]) * 200_000 for number in range(8)]

    def work(number: int) -> set[bytes | None]:
        folder = KernelFolder(tmp_path / "kernels", limit_bytes=700_000)
        seen = set()
        for turn in range(30):
            folder.write(f"{turn % 5}.nbc", contents[number])
            seen.add(folder.read(f"{turn % 5}.nbc"))
        return seen

    with ThreadPoolExecutor(8) as pool:
        seen = set().union(*pool.map(work, range(8)))
    assert seen <= {None, *contents} and len(seen) > 1
    assert not list((tmp_path / "kernels").glob("*.tmp"))
