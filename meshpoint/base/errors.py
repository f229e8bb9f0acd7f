"""The errors of the command line itself."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Final

NO_ROOM: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""What a medium says, not the argument that named a file on it."""


class CommandError(Exception):
    """An argument that cannot be used; one line that says what was found and what is allowed."""


class RunError(Exception):
    """What ran has failed, by no fault of its arguments; one line says what, and what to do."""


def unwritten(path: str | Path, error: OSError) -> CommandError | RunError:
    """The error to raise for a file that cannot be written: of the argument where it names what
    cannot be a file, of the run where the disk is full or has failed."""
    kind = RunError if error.errno in NO_ROOM else CommandError
    return kind(f"{path}: cannot be written: {error.strerror or error}")
