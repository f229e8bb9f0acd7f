"""Standard error that outlives its reader, and standard output whose end is known for what it is.

What a node says is for people. That nobody reads it any more, or that it goes to a full disk, is no
reason to end: a node in mid-shift goes on. Results on standard output are what a command is run
for: there an error ends it.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO, cast

GONE = (errno.EPIPE, errno.ESHUTDOWN)


class OutputError(OSError):
    """Standard output cannot be written; `errno` says why."""

    @property
    def reader_has_gone(self) -> bool:
        """The reader has seen enough (`| head`)."""
        return self.errno in GONE


class _Around:
    """A text stream around another one."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """As the stream does."""
        try:
            return self._stream.write(text)
        except OSError as error:
            return self.failed(error, text)

    def writelines(self, lines: Iterable[str]) -> None:
        """As the stream does."""
        try:
            self._stream.writelines(lines)
        except OSError as error:
            self.failed(error, "")

    def flush(self) -> None:
        """As the stream does."""
        try:
            self._stream.flush()
        except OSError as error:
            self.failed(error, "")

    def failed(self, error: OSError, text: str) -> int:
        """What comes of a text that could not be written."""
        raise NotImplementedError

    def finish(self) -> None:
        """Writes what is buffered; what cannot be written is dropped, or Python would try it again
        when it ends, and change the exit code."""
        with suppress(OutputError):
            self.flush()
        try:
            self._stream.flush()
        except OSError:
            with suppress(OSError, ValueError):  # a stream without a descriptor
                _nothing_at(self._stream.fileno())


class LastingError(_Around):
    """Standard error of which no write fails."""

    found_no_room = False
    """Whether words were lost otherwise than by their reader's going away."""

    def failed(self, error: OSError, text: str) -> int:
        """Noted, no more."""
        self.found_no_room |= error.errno not in GONE
        return len(text)


class NamedOutput(_Around):
    """Standard output whose errors are distinguished from those of other pipes and files."""

    def failed(self, error: OSError, text: str) -> int:  # noqa: ARG002
        """Raises OutputError."""
        raise OutputError(error.errno, error.strerror) from error


@contextmanager
def lasting_error() -> Iterator[LastingError]:
    """Within the block `sys.stderr` can always be written to."""
    before = sys.stderr
    if before is None:  # closed by whoever started us: the next file opened would take its number
        _nothing_at(2)
        before = sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    lasting = LastingError(before)
    sys.stderr = cast(TextIO, lasting)
    try:
        yield lasting
    finally:
        sys.stderr = before
        lasting.finish()


@contextmanager
def named_output() -> Iterator[None]:
    """Within the block an error of `sys.stdout` is an OutputError; what is buffered is written at
    its end."""
    before = sys.stdout
    if before is None:
        _nothing_at(1)
        before = sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    named = NamedOutput(before)
    sys.stdout = cast(TextIO, named)
    try:
        yield
    finally:
        sys.stdout = before
        named.finish()


def _nothing_at(descriptor: int) -> None:
    nothing = os.open(os.devnull, os.O_RDWR)
    if nothing != descriptor:
        os.dup2(nothing, descriptor)
        os.close(nothing)
