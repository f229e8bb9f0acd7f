"""Opening files that people name: regular files only, and no more of them than is allowed.

A pipe would be waited for, a device read for ever: neither is a file of settings or a log. All
reading goes through here; tools/rules/opening.py says so, and lists the exceptions.
"""

from __future__ import annotations

import os
import stat
from io import FileIO
from pathlib import Path
from typing import BinaryIO, Final, cast

# A pipe is not waited for between the look at it and its opening.
_FLAGS: Final = (
    os.O_RDONLY
    | getattr(os, "O_NONBLOCK", 0)
    | getattr(os, "O_CLOEXEC", 0)
    | getattr(os, "O_BINARY", 0)
)
_NEW_FLAGS: Final = (
    os.O_WRONLY
    | os.O_CREAT
    | os.O_TRUNC
    | getattr(os, "O_NOFOLLOW", 0)
    | getattr(os, "O_NONBLOCK", 0)
    | getattr(os, "O_CLOEXEC", 0)
    | getattr(os, "O_BINARY", 0)
)
_KINDS: Final = (
    (stat.S_ISDIR, "is a directory"),
    (stat.S_ISFIFO, "is a pipe"),
    (stat.S_ISSOCK, "is a socket"),
    (stat.S_ISCHR, "is a device"),
    (stat.S_ISBLK, "is a device"),
)


class UnreadableError(ValueError):
    """A file that cannot be read or is none; the message names it and says why.

    cause: the message without the file's name."""

    def __init__(self, path: Path, cause: str) -> None:
        super().__init__(f"{path}: {cause}")
        self.cause = cause


def open_regular(path: Path) -> BinaryIO:
    """The file, open for reading. UnreadableError where it is missing or no regular file."""
    try:
        _check_regular(path, path.stat().st_mode)
        file = cast(BinaryIO, os.fdopen(os.open(path, _FLAGS), "rb"))
    except (OSError, ValueError) as error:
        if isinstance(error, UnreadableError):
            raise
        # A ValueError: a name with a zero byte.
        cause = getattr(error, "strerror", None) or str(error)
        raise UnreadableError(path, f"cannot be read: {cause}") from error
    try:
        _check_regular(path, os.fstat(file.fileno()).st_mode)
    except UnreadableError:
        file.close()
        raise
    return file


def read_bounded(path: Path, limit_bytes: int) -> bytes:
    """The content of a regular file of at most `limit_bytes`. UnreadableError for any other."""
    with open_regular(path) as file:
        try:
            content = file.read(limit_bytes + 1)
        except OSError as error:
            raise UnreadableError(path, f"cannot be read: {error.strerror or error}") from error
        if len(content) > limit_bytes:
            found = max(os.fstat(file.fileno()).st_size, len(content))
            raise UnreadableError(path, f"{found} bytes, allowed are {limit_bytes}")
    return content


def read_text(path: Path, limit_bytes: int) -> str:
    """The same as UTF-8 text, with the line ends of any system."""
    try:
        text = read_bounded(path, limit_bytes).decode("utf-8")
    except UnicodeDecodeError as error:
        raise UnreadableError(path, f"not UTF-8 text: {error}") from error
    return text.replace("\r\n", "\n")


def create_regular(path: Path) -> FileIO:
    """A new, empty file, or one that was there emptied, to write to without a buffer; never what a
    link points to. OSError where it cannot be made, or is no regular file."""
    file = FileIO(os.open(path, _NEW_FLAGS, 0o666), "w")
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError("is no regular file")
    return file


def _check_regular(path: Path, mode: int) -> None:
    if stat.S_ISREG(mode):
        return
    found = next((words for is_kind, words in _KINDS if is_kind(mode)), "is of an unknown kind")
    raise UnreadableError(path, f"{found}, allowed is a regular file")
