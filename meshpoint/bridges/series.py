"""The frames of a bus as time series: what each signal was, and when it was sampled.

A message that says when it was sampled stands at that time, one that brings several samples is as
many rows, and an array of tooth edges is a row for each edge that is new. All else stands where its
frame came. Beside the messages stands `Compared`: what the controller estimated, and what was true
at the same instant, where a rig says so.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from meshpoint.bridges.left_out import LeftOut
from meshpoint.bridges.sample_clock import SampleClock, Ties
from meshpoint.dbc.fields import FieldSpec, make_enums
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS, Codec, make_codec
from meshpoint.dbc.link import read_alone
from meshpoint.dbc.schema import SCHEMA
from meshpoint.dbc.sensor_time import LOW, chained_us
from meshpoint.dbc.truck import TRUCK_SCHEMA
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.units import US

STAMPS: Final = (
    "sample_time_us", "read_time_us", "estimate_time_us", "event_time_us", "decision_time_us",
)  # fmt: skip
"""Fields that say when what else is in the message was so."""
BETWEEN_US: Final = {"SleevesMain": 1_000, "SleevesAux": 1_000, "ReferenceEncoder": 2_000}
"""Messages that bring several samples of a signal, newest first, and the time between two."""
EDGES, EDGE_INDEX = "timestamp_low_us", "newest_index"
UNIT_SYMBOLS: Final = {
    "_rad_s": "rad/s", "_m_s": "m/s", "_rad": "rad", "_pa": "Pa", "_us": "us", "_fraction": "1",
    "_m": "m", "_k": "K", "_j": "J",
}  # fmt: skip
"""By the end of a signal's name; the longer ends first."""
COMPARED: Final = "Compared"
VALUE_TABLES: Final = {**TRUCK_SCHEMA.value_tables, **SCHEMA.value_tables}
READABLE: Final[dict[str, Codec]] = {
    **CODECS,
    **{spec.name: make_codec(spec, make_enums(TRUCK_SCHEMA)) for spec in TRUCK_SCHEMA.messages},
}
"""The messages of the product's DBC and of the truck's other nodes, by name."""
NO_NAMES: Final[Mapping[int, str]] = MappingProxyType({})


class Signal(NamedTuple):
    """A column of a topic."""

    name: str
    """In SI units, which its end says (`_rad_s`)."""
    comment: str
    names: Mapping[int, str] = NO_NAMES
    """What its numbers mean, where it is a choice."""

    @property
    def unit(self) -> str:
        """Its unit's symbol; empty for a count or a choice."""
        return next((of for end, of in UNIT_SYMBOLS.items() if self.name.endswith(end)), "")


class Topic(NamedTuple):
    """What is sampled together: a message of the bus, or `Compared`."""

    comment: str
    signals: tuple[Signal, ...]


class Sample(NamedTuple):
    """A row of a topic."""

    topic: str
    time_s: float
    values: dict[str, float | None]


def _signal(field: FieldSpec) -> Signal:
    first = field.signals[0]
    name = EDGE_INDEX if field.name == EDGES else field.name
    return Signal(name, first.comment, VALUE_TABLES.get(first.value_table or "", {}))


def _topic(codec: Codec) -> Topic:
    fields = [field for field in codec.fields if field.name not in (*STAMPS, EDGE_INDEX)]
    return Topic(codec.spec.comment, tuple(map(_signal, fields)))


TOPICS: Final[dict[str, Topic]] = {
    **{name: _topic(codec) for name, codec in READABLE.items()},
    COMPARED: Topic(
        "Estimates of the controller beside what the rig says was true at the same instant.",
        (
            Signal("layshaft_speed_rad_s", "Layshaft speed as estimated."),
            Signal("layshaft_speed_sd_rad_s", "Its standard deviation."),
            Signal("layshaft_speed_true_rad_s", "As the reference encoder has it."),
            Signal("main_speed_rad_s", "Main shaft speed as estimated."),
            Signal("main_speed_sd_rad_s", "Its standard deviation."),
            Signal("main_speed_true_rad_s", "As the rig has it."),
            Signal("phase_rad", "Tooth from the middle of its gap, as estimated."),
            Signal("phase_sd_rad", "Its standard deviation."),
            Signal("phase_true_rad", "As the rig has it."),
        ),
    ),
}
"""All topics by name."""
BY_IDENTIFIER: Final = {codec.spec.can_id: (name, codec) for name, codec in READABLE.items()}


class TimeSeries:
    """Takes frames in the order of the bus, each with its time in s."""

    def __init__(self, ties: Ties) -> None:
        self.left_out = LeftOut()
        self._clock = SampleClock(ties)
        self._indices: dict[str, int] = {}
        """The newest edge of each array."""
        self._compared = _Compared()

    def take(self, time_s: float, frame: Frame) -> Iterator[Sample]:
        """The samples of a frame, oldest first; none of a frame that is of nobody here, or damaged,
        which `left_out` counts."""
        sampled_s = self._clock.of_sensors(time_s, frame)
        name, codec = BY_IDENTIFIER.get(frame.can_id, ("", None))
        if codec is None:
            self.left_out.unknown(frame.can_id)
            return
        message = read_alone(codec, frame)
        if message is None:
            self.left_out.damaged(name)
            return
        values = message._asdict()
        stamp = next((values.pop(each) for each in STAMPS if each in values), None)
        at_s = self._at_s(time_s, stamp) if sampled_s is None else sampled_s
        yield from self._rows(name, at_s, stamp, values)
        found = self._compared.take(name, at_s, stamp, values)
        if found is not None:
            yield found

    def rest(self) -> Iterator[Sample]:
        """What is left when no frame comes any more."""
        yield from self._compared.rest()

    def _at_s(self, time_s: float, stamp: int | None) -> float:
        """When a frame was true that is none of the sensors'."""
        if stamp is None:
            return time_s
        at_s = self._clock.of_controller(time_s, stamp)
        if at_s is None:
            self.left_out.unplaced += 1
            return time_s
        return at_s

    def _rows(
        self, name: str, at_s: float, stamp: int | None, values: dict[str, Any]
    ) -> Iterator[Sample]:
        if EDGES in values and stamp is not None:
            yield from self._edges(name, at_s, stamp, values)
            return
        between_s = BETWEEN_US.get(name, 0) * US
        count = max((len(each) for each in values.values() if isinstance(each, tuple)), default=1)
        for k in reversed(range(count)):
            row = {key: _number(of, k) for key, of in values.items()}
            yield Sample(name, at_s - k * between_s, row)

    def _edges(
        self, name: str, at_s: float, read_us: int, values: dict[str, Any]
    ) -> Iterator[Sample]:
        """The edges that are new since the array before."""
        lows, newest = values.pop(EDGES), values.pop(EDGE_INDEX)
        # What came in before a standstill cannot be chained over it.
        held = min(values["valid_stamps"], 1) if values["long_interval"] else values["valid_stamps"]
        before = self._indices.get(name)
        self._indices[name] = newest
        new = held if before is None else min(held, (newest - before) & LOW)
        times_us = chained_us(read_us, lows[:new])
        row = {key: _number(of, 0) for key, of in values.items()}
        for k in reversed(range(new)):
            age_s = (read_us - times_us[k]) * US
            yield Sample(name, at_s - age_s, {EDGE_INDEX: (newest - k) & LOW, **row})


def _number(value: Any, k: int) -> float | None:
    of = value[k] if isinstance(value, tuple) else value
    return None if of is None else of if isinstance(of, float) else int(of)


class _Compared:
    """Keeps what was true until the estimate of the same instant comes; of several of one instant,
    as a controller makes that steps as soon as a read begins, the last."""

    def __init__(self) -> None:
        self._gear = ""
        """The gear that phases are of: the one asked for, else the one that is in."""
        self._true: dict[str, dict[str, Any]] = {}
        self._true_at: dict[str, int | None] = {}
        self._row_at: tuple[int | None, Sample] | None = None
        """The newest row, and its stamp."""

    def take(
        self, name: str, at_s: float, stamp: int | None, values: dict[str, Any]
    ) -> Sample | None:
        """A message; the row before where it is an estimate of another instant whose truth is
        known."""
        if name == "ControllerStatus":
            gear = DRIVE_GEARS.get(values["target_gear"])
            self._gear = gear.main.name.lower() if gear else ""
        elif name in ("ReferenceEncoder", "ReferencePhase"):
            self._true[name], self._true_at[name] = values, stamp
        elif name == "ControllerEstimates" and set(self._true_at.values()) == {stamp}:
            before = self._row_at
            self._row_at = stamp, Sample(COMPARED, at_s, self._row(values))
            return None if before is None or before[0] == stamp else before[1]
        return None

    def rest(self) -> Iterator[Sample]:
        """The newest row, which no other has followed."""
        if self._row_at is not None:
            yield self._row_at[1]

    def _row(self, said: dict[str, Any]) -> dict[str, float | None]:
        encoder, truth = self._true.get("ReferenceEncoder"), self._true.get("ReferencePhase")
        is_known = said["phase_known"] and truth is not None and bool(self._gear)

        def of(key: str, valid: bool) -> float | None:
            return float(said[key]) if valid else None

        lay, main = said["layshaft_valid"], said["main_valid"]
        return {
            "layshaft_speed_rad_s": of("layshaft_speed_rad_s", lay),
            "layshaft_speed_sd_rad_s": of("layshaft_speed_sd_rad_s", lay),
            "layshaft_speed_true_rad_s": None if encoder is None else encoder["speed_rad_s"][0],
            "main_speed_rad_s": of("main_speed_rad_s", main),
            "main_speed_sd_rad_s": of("main_speed_sd_rad_s", main),
            "main_speed_true_rad_s": None if truth is None else truth["main_speed_rad_s"],
            "phase_rad": of("phase_rad", is_known),
            "phase_sd_rad": of("phase_sd_rad", is_known),
            "phase_true_rad": (
                truth[f"phase_{self._gear}_rad"] if truth is not None and self._gear else None
            ),
        }
