"""Another bus's messages as ours: `--dbc FILE --map TOML` (docs/replay.md).

    [[signal]]
    message = "ETC1"                # of the DBC
    signal = "OutputShaftSpeed"
    is = "speed.propeller"          # rpm; see MEANINGS
    factor = 1.0                    # value x factor + offset is in the unit of MEANINGS
    offset = 0.0

Edges, positions and pressures become the frames that the controller reads. Speeds do not: it counts
teeth, and a speed has none. They tell gears and shifts (`gear_track`).
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import cantools.database
from cantools.database.can import Database, Message

from meshpoint.base.errors import CommandError
from meshpoint.dbc.edges import EDGES
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import GearboxSensors, SleevesAux, SleevesMain
from meshpoint.dbc.node import Node
from meshpoint.dbc.sensor_time import wrap
from meshpoint.gearbox.reading import UnreadableError, read_bounded
from meshpoint.gearbox.wheels import SHAFTS, WHEEL_NAMES
from meshpoint.logs.captures import read_frame
from meshpoint.units import BAR, MM

LIMIT_BYTES: Final = 16 << 20
SLEEVES: Final = {
    "first_second": (SleevesMain, "sleeve_first_second_m", 1),
    "crawl_third": (SleevesMain, "sleeve_crawl_third_m", 2),
    "splitter": (SleevesAux, "sleeve_splitter_m", 1),
    "range": (SleevesAux, "sleeve_range_m", 2),
}
"""Message and field of each sleeve, and the bit of its sensor in `sensor_fault`."""
PRESSURES: Final = {"brake": "brake_pressure_pa", "supply": "supply_pressure_pa"}
MEANINGS: Final = {
    **{f"speed.{shaft}": "rpm" for shaft in SHAFTS},
    **{f"edge.{shaft}.{polarity}": "us" for shaft in WHEEL_NAMES for polarity in ("rise", "fall")},
    **{f"position.{sleeve}": "mm" for sleeve in SLEEVES},
    **{f"pressure.{name}": "bar" for name in PRESSURES},
}
"""What a signal may be, and its unit. edge: sensor time of the newest edge of a shaft's wheel."""
KEYS: Final = frozenset({"message", "signal", "is", "factor", "offset", "bits"})
SAMPLES: Final = 10
KEPT_EDGES: Final = 1_000
J1939_FIRST_BROADCAST: Final = 0xF000


@dataclass(frozen=True)
class Mapped:
    """One signal of another bus, and what it is here."""

    signal: str
    meaning: str
    factor: float
    offset: float
    bits: int
    """Of an edge's time: after how many bits it wraps."""


@dataclass
class _Edges:
    """Edge times of one shaft and polarity, on the log's own time."""

    times_us: list[int] = field(default_factory=list)
    raw: int | None = None
    dropped: int = 0
    """How many came before those that are kept."""

    def take(self, raw: int, bits: int, now_us: int) -> None:
        """The time of the newest edge as its sensor counts it; the same again is no edge."""
        if self.raw is None:
            self.times_us.append(now_us)
        elif raw != self.raw:
            self.times_us.append(self.times_us[-1] + ((raw - self.raw) % (1 << bits)))
        self.raw = raw
        if len(self.times_us) > 2 * KEPT_EDGES:
            self.dropped += len(self.times_us) - KEPT_EDGES
            del self.times_us[:-KEPT_EDGES]


class BusMap:
    """Reads frames of another bus, and makes the frames of ours that they tell."""

    def __init__(self, database: Database, by_message: dict[str, list[Mapped]]) -> None:
        self._exact: dict[tuple[int, bool], tuple[Message, list[Mapped]]] = {}
        self._by_pgn: dict[int, tuple[Message, list[Mapped]]] = {}
        for name, mapped in by_message.items():
            message = database.get_message_by_name(name)
            self._exact[message.frame_id, message.is_extended_frame] = message, mapped
            if message.is_extended_frame:
                self._by_pgn[pgn(message.frame_id)] = message, mapped
        self._transmitter = Transmitter(Node.GEARBOX_IO)
        self._edges: dict[str, _Edges] = {}
        self._values: dict[str, float] = {}
        self.meanings = {m.meaning for mapped in by_message.values() for m in mapped}
        self.used: dict[str, int] = dict.fromkeys(sorted(self.meanings), 0)
        """How many values there were of each meaning."""
        self.undecoded = 0
        """Frames of a mapped message that the DBC cannot decode."""
        self.speeds_rpm: list[tuple[str, float]] = []
        """Speeds that the last frame reported: shaft and rpm."""

    def take(self, now_us: int, frame: Frame) -> bool:
        """A frame of the log; whether it is a mapped one."""
        self.speeds_rpm = []
        found = self._exact.get((frame.can_id, frame.is_extended))
        if found is None and frame.is_extended:
            found = self._by_pgn.get(pgn(frame.can_id))
        if found is None:
            return False
        message, mapped = found
        try:
            values = message.decode(frame.data, decode_choices=False, allow_truncated=True)
        except Exception:  # noqa: BLE001  cantools leaks errors of many kinds on short frames
            values = None
        if not isinstance(values, dict):
            self.undecoded += 1
            return True
        for one in mapped:
            value = values.get(one.signal)
            if isinstance(value, (int, float)) and not _is_absent(message, one.signal, value):
                self._take(one, float(value), now_us)
        return True

    def _take(self, one: Mapped, value: float, now_us: int) -> None:
        value = value * one.factor + one.offset
        self.used[one.meaning] += 1
        kind, name = one.meaning.split(".", 1)
        if kind == "speed":
            self.speeds_rpm.append((name, value))
        elif kind == "edge":
            self._edges.setdefault(name, _Edges()).take(round(value), one.bits, now_us)
        else:
            self._values[one.meaning] = value

    def frames(self, now_us: int) -> list[Frame]:
        """Our sensor frames of this read, of what is mapped and has come."""
        made: list[Any] = []
        for wheel in WHEEL_NAMES:
            reported = {p: self._edges.get(f"{wheel}.{p}") for p in ("rise", "fall")}
            if not any(reported.values()):
                continue
            for polarity, edges in reported.items():
                message = getattr(EDGES[wheel], polarity)
                made.append(message(**_edge_values(edges or _Edges(), now_us)))
        positions = self._positions(now_us)
        made += positions
        if any(f"pressure.{name}" in self._values for name in PRESSURES):
            values = {
                key: self._values[f"pressure.{name}"] * BAR
                for name, key in PRESSURES.items()
                if f"pressure.{name}" in self._values
            }
            made.append(GearboxSensors(sample_time_us=wrap(now_us), **values))
        return [self._transmitter.encode(message) for message in made]

    def _positions(self, now_us: int) -> list[Any]:
        """Sleeve messages; a sleeve without a position has its sensor's fault bit."""
        made = []
        for kind in (SleevesMain, SleevesAux):
            values: dict[str, Any] = {}
            fault = 0
            for sleeve, (message, key, bit) in SLEEVES.items():
                if message is not kind:
                    continue
                position = self._values.get(f"position.{sleeve}")
                if position is None:
                    fault |= bit
                else:
                    values[key] = (position * MM,) * SAMPLES
            if values:
                made.append(kind(sample_time_us=wrap(now_us), sensor_fault=fault, **values))
        return made


def _edge_values(edges: _Edges, now_us: int) -> dict[str, Any]:
    """The fields of an edge frame; edges that are still ahead of the read wait."""
    frame = read_frame(edges.times_us, now_us)
    number = frame.newest_index + edges.dropped - 1 if frame.valid_stamps else 0
    return frame._asdict() | {"newest_index": number & 0xFFFF}


def _is_absent(message: Message, name: str, value: float) -> bool:
    """Whether a J1939 signal says `not available` or `error`: its highest values, from two bits
    on."""
    signal = message.get_signal_by_name(name)
    if not message.is_extended_frame or signal.length < 2 or signal.is_signed:
        return False
    raw = round((value - signal.offset) / signal.scale)
    top = (1 << signal.length) - 1
    reserved = 1 << max(signal.length - 8, 0)
    least = top - 2 * reserved + 1 if signal.length >= 8 else top - 1
    return raw >= least


def pgn(can_id: int) -> int:
    """J1939-21: the parameter group of a 29-bit identifier, whoever sends it to whom."""
    group = (can_id >> 8) & 0x3FFFF
    return group if group & 0xFF00 >= J1939_FIRST_BROADCAST else group & 0x3FF00


def load_map(dbc: Path, path: Path) -> BusMap:
    """The map of a TOML file onto a DBC. CommandError names file, entry, and what is allowed."""
    try:
        text = read_bounded(dbc, LIMIT_BYTES).decode("cp1252")
        table = tomllib.loads(read_bounded(path, LIMIT_BYTES).decode("utf-8"))
    except (UnreadableError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        where = "" if isinstance(error, UnreadableError) else f"{path}: "
        raise CommandError(f"{where}{error}") from error
    try:
        database = cantools.database.load_string(text, "dbc", strict=False)
    except Exception as error:  # the parser leaks errors of many kinds
        raise CommandError(f"{dbc}: not a DBC file: {error}") from error
    if not isinstance(database, Database):
        raise CommandError(f"{dbc}: not a DBC file")
    entries = table.get("signal")
    if set(table) != {"signal"} or not isinstance(entries, list) or not entries:
        raise CommandError(f"{path}: allowed is a list of [[signal]]")
    by_message: dict[str, list[Mapped]] = {}
    for number, entry in enumerate(entries, 1):
        where = f"{path}: [[signal]] {number}"
        mapped = _mapped(database, entry, where)
        by_message.setdefault(entry["message"], []).append(mapped)
    return BusMap(database, by_message)


def _mapped(database: Database, entry: dict[str, Any], where: str) -> Mapped:
    unknown = set(entry) - KEYS
    if unknown or not {"message", "signal", "is"} <= set(entry):
        found = ", ".join(sorted(unknown)) or "a key is missing"
        allowed = "message, signal and is; factor, offset and bits"
        raise CommandError(f"{where}: {found}: allowed are {allowed}")
    if entry["is"] not in MEANINGS:
        allowed = ", ".join(MEANINGS)
        raise CommandError(f"{where}: is = {entry['is']!r}, allowed are {allowed}")
    try:
        message = database.get_message_by_name(entry["message"])
        message.get_signal_by_name(entry["signal"])
    except KeyError as error:
        raise CommandError(f"{where}: the DBC has no {error.args[0]}") from error
    numbers = {key: entry.get(key, default) for key, default in (("factor", 1.0), ("offset", 0.0))}
    bits = entry.get("bits", 32)
    if not all(isinstance(v, (int, float)) for v in numbers.values()) or bits not in range(8, 65):
        raise CommandError(f"{where}: factor and offset are numbers, bits are 8 to 64")
    return Mapped(entry["signal"], entry["is"], numbers["factor"], numbers["offset"], bits)
