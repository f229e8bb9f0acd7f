"""Where compiled kernels lie: in the wheel, and in a folder of the user's own, bounded in size.

What is read in that folder is run as machine code, so nothing is taken that another user could have
written: folder and file belong to this user or to root and cannot be written by anybody else,
neither is a symbolic link, and a digest at the end of each file says that it is whole. On Windows,
which has no such owners, the user's folder is trusted as it is.
"""

from __future__ import annotations

import hashlib
import os
import stat
import sys
import tempfile
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

LIMIT_BYTES: Final = 128 * 2**20
"""Of all files of a folder together: the least recently used go first."""
SHIPPED: Final = Path(__file__).with_name("compiled")
"""Kernels that a wheel brings; no such folder in a clone."""
USE_NOTED_S: Final = 24 * 3600
"""A file's time says when it was last used, to this."""
DIGEST_BYTES: Final = 32
ENTRY: Final = ".nbc"
MARK: Final = ".compiled"
HALF_WRITTEN: Final = ".tmp"
LEFT_BEHIND_S: Final = 3600
"""A half-written file of this age is nobody's any more."""

HAS_OWNERS: Final = hasattr(os, "geteuid")
_READ: Final = (
    os.O_RDONLY
    | getattr(os, "O_NOFOLLOW", 0)
    | getattr(os, "O_NONBLOCK", 0)  # a named pipe does not hold up who opens it
    | getattr(os, "O_BINARY", 0)
)
_MAKE: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)


class UnusableEntryError(Exception):
    """A file is there and not taken; the text says what it is, as in "they are ..."."""


def has_shipped() -> bool:
    """Whether a wheel brought kernels."""
    return SHIPPED.is_dir()


def shipped(name: str) -> bytes | None:
    """What the wheel brought under this name; None where it brought nothing, or not the whole. No
    owner is asked for: who could write the file could write the code beside it."""
    try:
        return _whole((SHIPPED / name).read_bytes())
    except OSError:
        return None


def kernel_folders() -> tuple[KernelFolder, ...]:
    """Where kernels may be kept, the best first: NUMBA_CACHE_DIR where that is set, else
    `meshpoint/kernels` in the user's cache folder; where that cannot be used, the temporary folder.
    """
    given, own = os.environ.get("NUMBA_CACHE_DIR"), "meshpoint-kernels"
    if HAS_OWNERS:
        own += f"-{os.geteuid()}"
    cache = None if given else user_cache()
    best = Path(given) if given else cache and cache / "meshpoint" / "kernels"
    paths = (best, Path(tempfile.gettempdir()) / own)
    return tuple(KernelFolder(path) for path in paths if path)


def user_cache() -> Path | None:
    """XDG_CACHE_HOME where that is an absolute path, else the platform's own: `~/.cache`, on macOS
    `~/Library/Caches`, on Windows `%LOCALAPPDATA%`. None for a user without a home."""
    given = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if given.is_absolute():
        return given
    local = os.environ.get("LOCALAPPDATA")
    if sys.platform == "win32" and local:
        return Path(local)
    folder = {"win32": "AppData/Local", "darwin": "Library/Caches"}.get(sys.platform, ".cache")
    try:
        return Path.home() / folder
    except RuntimeError:
        return None


class KernelFolder:
    """Files by name. It is looked at again at each use, because it may change meanwhile."""

    def __init__(self, path: Path, limit_bytes: int = LIMIT_BYTES) -> None:
        """limit_bytes: of all files together."""
        self.path = path
        self._limit_bytes = limit_bytes

    def read(self, name: str) -> bytes | None:
        """What was written under this name, or None where nothing is.

        OSError: the folder is not taken, and why. UnusableEntryError: the file is not."""
        try:
            with self._opened() as folder, _opened_file(self._at(name), folder) as (file, raw):
                self._note_use(name, file)
        except (FileNotFoundError, NotADirectoryError):
            return None
        content = _whole(raw)
        if content is None:
            raise UnusableEntryError("damaged")
        return content

    def write(self, name: str, content: bytes) -> None:
        """Writes it beside and renames it: a file is there whole or not at all, whoever else writes
        it meanwhile. OSError where the folder is not taken or cannot be written."""
        self.path.mkdir(mode=0o755, parents=True, exist_ok=True)
        beside = self._at(f"{name}.{uuid.uuid4().hex}{HALF_WRITTEN}")
        with self._opened() as folder:
            try:
                file = os.open(beside, _MAKE, 0o644, dir_fd=folder)
                with os.fdopen(file, "wb") as out:
                    out.write(content + hashlib.sha256(content).digest())
                os.replace(beside, self._at(name), src_dir_fd=folder, dst_dir_fd=folder)
            except OSError:
                with suppress(OSError):
                    os.unlink(beside, dir_fd=folder)
                raise
            self._trim(folder)

    def remove(self, name: str) -> None:
        """Takes a file away, where that is possible."""
        with suppress(OSError), self._opened() as folder:
            os.unlink(self._at(name), dir_fd=folder)

    @contextmanager
    def _opened(self) -> Iterator[int | None]:
        """The folder's descriptor, None on Windows: what is opened in it is what was looked at."""
        if not HAS_OWNERS:
            yield None
            return
        if self.path.is_symlink():
            raise PermissionError("it is a symbolic link")
        folder = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        try:
            reason = _not_ours(os.fstat(folder))
            if reason:
                raise PermissionError(reason)
            yield folder
        finally:
            os.close(folder)

    def _at(self, name: str) -> str:
        """The file, within the opened folder or without one."""
        return name if HAS_OWNERS else str(self.path / name)

    def _note_use(self, name: str, file: int) -> None:
        now_s = time.time()
        if now_s - os.fstat(file).st_mtime > USE_NOTED_S:
            with suppress(OSError):
                os.utime(file if os.utime in os.supports_fd else self.path / name)

    def _trim(self, folder: int | None) -> None:
        """The least recently used files go until the others are within the limit; then marks too,
        which say that all are there."""
        left_behind_s = time.time() - LEFT_BEHIND_S
        found = []
        with os.scandir(self.path if folder is None else folder) as files:
            for file in files:
                if file.name.endswith((ENTRY, MARK, HALF_WRITTEN)):
                    with suppress(FileNotFoundError):  # another process was faster
                        status = file.stat(follow_symlinks=False)
                        found.append((status.st_mtime, status.st_size, file.name))
        found = [
            each for each in found if each[0] < left_behind_s or not each[2].endswith(HALF_WRITTEN)
        ]
        excess = sum(size for _, size, _ in found) - self._limit_bytes
        if excess <= 0:
            return
        for _, size, name in sorted(found):
            if excess > 0 or name.endswith(MARK):
                with suppress(OSError):
                    os.unlink(self._at(name), dir_fd=folder)
                excess -= size


def _whole(raw: bytes) -> bytes | None:
    """What a file holds before its digest; None where that is another."""
    content, digest = raw[:-DIGEST_BYTES], raw[-DIGEST_BYTES:]
    return content if hashlib.sha256(content).digest() == digest else None


@contextmanager
def _opened_file(path: str, folder: int | None) -> Iterator[tuple[int, bytes]]:
    """A file's descriptor and all that is in it. UnusableEntryError where another user could have
    written it."""
    try:
        file = os.open(path, _READ, dir_fd=folder)
    except FileNotFoundError:
        raise
    except OSError as error:  # a symbolic link, or one that may not be read
        raise UnusableEntryError(f"not to be opened ({error.strerror})") from error
    with os.fdopen(file, "rb") as opened:
        status = os.fstat(file)
        if not stat.S_ISREG(status.st_mode) or status.st_size > LIMIT_BYTES:
            raise UnusableEntryError("no files of kernels")
        if HAS_OWNERS and _not_ours(status):
            raise UnusableEntryError(f"not to be trusted ({_not_ours(status)})")
        yield file, opened.read()


def _not_ours(status: os.stat_result) -> str:
    """Why somebody else could have written it; empty where nobody could."""
    if status.st_uid not in (0, os.geteuid()):
        return f"it belongs to another user, uid {status.st_uid}"
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return "other users may write it; chmod go-w would do"
    return ""
