"""The wire and its logs with other tools: frames read by python-can, decoded by cantools with the
DBC as it lies in the repository, and checked by autosar-e2e."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import can
import cantools.database
from acceptance_kit import DBC_FILE, US_WRAP, Outcome
from e2e import p05


class Frame(NamedTuple):
    """One frame as another tool sees it."""

    time_s: float
    can_id: int
    data: bytes
    is_extended: bool
    is_fd: bool


class Wire:
    """The DBC through cantools, and the end-to-end header through autosar-e2e."""

    def __init__(self, path: Path = DBC_FILE) -> None:
        database = cantools.database.load_file(str(path))
        self.messages = {message.frame_id: message for message in database.messages}
        self.ids = {message.name: message.frame_id for message in database.messages}

    def message(self, name: str) -> Any:
        return self.messages[self.ids[name]]

    def name(self, can_id: int) -> str | None:
        return self.messages[can_id].name if can_id in self.messages else None

    def sender(self, can_id: int) -> str:
        return str(self.messages[can_id].senders[0])

    def data_id(self, can_id: int) -> int | None:
        """The end-to-end data identifier, None for messages that carry none (J1939)."""
        attributes = self.messages[can_id].dbc.attributes
        if "E2EProfile" not in attributes or attributes["E2EProfile"].value in (0, "None"):
            return None
        return int(attributes["E2EDataId"].value)

    def decode(self, frame: Frame) -> dict[str, Any]:
        return dict(
            self.messages[frame.can_id].decode(frame.data, decode_choices=False, allow_excess=False)
        )

    def crc_holds(self, frame: Frame) -> bool:
        data_id = self.data_id(frame.can_id)
        assert data_id is not None
        return bool(p05.e2e_p05_check(frame.data, data_id))

    def protect(self, can_id: int, data: bytes) -> bytes:
        """The payload with its counter kept and its CRC made to fit."""
        data_id = self.data_id(can_id)
        if data_id is None:
            return data
        protected = bytearray(data)
        p05.e2e_p05_protect(protected, data_id, increment_counter=False)
        return bytes(protected)

    def encode(self, name: str, counter: int, **signals: float) -> bytes:
        """A payload of `name`, all signals zero but the given ones, valid end to end."""
        message = self.message(name)
        values = {signal.name: 0 for signal in message.signals} | signals
        if self.data_id(message.frame_id) is not None:
            values["Counter"] = counter % 256
        data = message.encode(values, strict=False)
        return self.protect(message.frame_id, data)


def us_between(early: int, late: int) -> int:
    """Signed difference of two times of the 32-bit sensor clock."""
    return (late - early + US_WRAP // 2) % US_WRAP - US_WRAP // 2


# --------------------------------------------------------------------------------------- logs

CANDUMP_LINE = re.compile(
    r"^\((?P<time>\d+\.\d{6})\) (?P<channel>\S+) (?P<id>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})"
    r"(?P<mark>##[0-9A-Fa-f]|#)(?P<data>(?:[0-9A-Fa-f]{2})*)(?P<direction> [RT])?$"
)


def read_log(path: Path) -> list[Frame]:
    """The log as python-can reads it."""
    with can.LogReader(str(path)) as reader:
        return [
            Frame(
                message.timestamp,
                message.arbitration_id,
                bytes(message.data),
                message.is_extended_id,
                message.is_fd,
            )
            for message in reader
        ]


class Recorded(NamedTuple):
    """One `simulate` run: its output, its log, and the log's frames."""

    outcome: Outcome
    log: Path
    frames: list[Frame]

    @property
    def report(self) -> dict[str, Any]:
        report: dict[str, Any] = self.outcome.json
        return report


class LogLine(NamedTuple):
    """One line of a candump log, taken apart so that it can be tampered with."""

    prefix: str
    can_id: int
    mark: str
    data: bytes
    suffix: str

    @classmethod
    def parse(cls, line: str) -> LogLine:
        match = CANDUMP_LINE.match(line)
        assert match, f"no candump line: {line!r}"
        return cls(
            line[: match.start("mark")],
            int(match["id"], 16),
            match["mark"],
            bytes.fromhex(match["data"]),
            line[match.end("data") :],
        )

    @property
    def text(self) -> str:
        return f"{self.prefix}{self.mark}{self.data.hex().upper()}{self.suffix}"

    @property
    def time_s(self) -> float:
        return float(self.prefix[1 : self.prefix.index(")")])


def read_lines(log: Path) -> list[LogLine]:
    return [LogLine.parse(line) for line in log.read_text().splitlines()]


def write_lines(log: Path, lines: Sequence[LogLine]) -> None:
    log.write_text("".join(line.text + "\n" for line in lines))


def copy_run(log: Path, to: Path) -> Path:
    """The log and everything saved beside it, copied to a folder of its own."""
    shutil.copytree(log.parent, to)
    return to / log.name


def verdict_of(outcome: Outcome) -> str:
    """What `replay --verify` said: identical, differs N, not verifiable, error."""
    text = (outcome.out + outcome.err).lower()
    assert "traceback" not in text, outcome.text
    if outcome.code == 2:
        return "error"
    differs = re.search(r"differs at step (\d+)", text)
    said = [
        *([f"differs {differs[1]}"] if differs else []),
        *(["not verifiable"] if "not verifiable" in text else []),
        *(["identical"] if "identical" in text else []),
    ]
    assert len(said) == 1, f"not one verdict but {said}\n{outcome.text}"
    return said[0]
