"""What a node keeps beside its log, in files of lines: what a replay needs and no log can hold.

Cores hand lines over; the driver writes them when a step's frames are sent. A line that cannot be
written is counted, and of each file it is said once: record keeping never ends a node.
"""

from __future__ import annotations

from contextlib import suppress
from io import FileIO
from pathlib import Path

from meshpoint.gearbox.reading import create_regular


class Records:
    """The files of one run in one folder."""

    def __init__(self, folder: Path) -> None:
        """folder: of the run header."""
        self.lost_lines = 0
        """Lines that could not be written so far."""
        self._folder = folder
        self._waiting: dict[str, list[str]] = {}
        self._ended: list[str] = []
        self._files: dict[str, FileIO | None] = {}  # None: given up

    def put(self, name: str, line: str) -> None:
        """A line of the file of this name, without its end. Nothing is written here."""
        self._waiting.setdefault(name, []).append(line)

    def end(self, name: str) -> None:
        """No more lines come for the file."""
        self._ended.append(name)

    def write(self) -> list[str]:
        """Writes what has been handed over; returns what went wrong. Never raises OSError."""
        if not self._waiting and not self._ended:
            return []
        said = [
            f"record {self._folder / name}: cannot be written: {error.strerror or error}; "
            "replay --verify ends there, the node goes on"
            for name, lines in self._waiting.items()
            if (error := self._append(name, lines)) is not None
        ]
        self._waiting = {}
        for name in self._ended:
            self._close(self._files.pop(name, None))
        self._ended = []
        return said

    def close(self) -> list[str]:
        """Writes what is left and closes all files."""
        said = self.write()
        while self._files:
            self._close(self._files.popitem()[1])
        return said

    def _append(self, name: str, lines: list[str]) -> OSError | None:
        """What kept the file from being written, where it had not been given up before."""
        left = "".join(f"{line}\n" for line in lines).encode("ascii")
        try:
            if name not in self._files:
                self._files[name] = None
                self._files[name] = create_regular(self._folder / name)
            file = self._files[name]
            if file is None:
                self.lost_lines += len(lines)
                return None
            # Not buffered, so that nothing is left to be written when it is closed.
            while left:
                left = left[file.write(left) :]
        except OSError as error:
            self.lost_lines += len(lines)
            self._close(self._files[name])
            self._files[name] = None
            return error
        return None

    @staticmethod
    def _close(file: FileIO | None) -> None:
        if file is not None:
            with suppress(OSError):
                file.close()
