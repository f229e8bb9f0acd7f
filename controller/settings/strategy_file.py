"""A user's own strategy as text: a Python file and the name of a class in it.

The text is read once, where the user names the file, and goes with the settings from there: into
worker processes, and into the run header as a hash. A header never carries the text, so no code
that a log brings along is ever run.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from meshpoint.dbc.messages import Strategy
from meshpoint.gearbox.reading import UnreadableError, read_bounded
from meshpoint.gearbox.tables import TableError

SOURCE_LIMIT_BYTES: Final = 1024 * 1024
FORM: Final = "FILE.py:CLASS"
UNAIMED, AIMED = Strategy.SPEED_WINDOW, Strategy.TARGET_PHASE
"""The DBC's value table has no entry for a user's own: the bus says which of ours it is like, one
that aims or one that does not, and the run header says which file it was."""


class StrategyError(Exception):
    """What is wrong with a user's strategy: file, line, and what happened there."""


@dataclass(frozen=True)
class StrategyFile:
    """A strategy named as FILE.py:CLASS, with the hash of the file it was read from."""

    name: str
    """As the user gave it."""
    sha256: str
    aims: bool
    """What the class says of itself."""
    source: bytes | None = field(default=None, repr=False, compare=False)
    """The file's content; None where it is known from a run header alone."""

    @property
    def path(self) -> str:
        """The file."""
        return split_name(self.name)[0]

    @property
    def class_name(self) -> str:
        """The class in it."""
        return split_name(self.name)[1]

    @property
    def wire(self) -> Strategy:
        """Its value on the bus."""
        return AIMED if self.aims else UNAIMED


def is_file_name(name: str) -> bool:
    """Whether a strategy's name is of the form FILE.py:CLASS."""
    path, class_name = split_name(name)
    return path.endswith(".py") and class_name.isidentifier()


def split_name(name: str) -> tuple[str, str]:
    """File and class; a drive letter's colon belongs to the file."""
    path, _, class_name = name.rpartition(":")
    return path, class_name


def read_source(name: str) -> bytes:
    """The content of the file in FILE.py:CLASS. TableError where it cannot be read."""
    try:
        return read_bounded(Path(split_name(name)[0]), SOURCE_LIMIT_BYTES)
    except UnreadableError as error:
        raise TableError(str(error)) from error


def sha256_of(source: bytes) -> str:
    """The hash by which a run header knows a file."""
    return hashlib.sha256(source).hexdigest()
