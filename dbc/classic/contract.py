"""What is in each frame of the classic profile, in terms of the signals of meshpoint.dbc.

A frame of our own has 8 bytes: AUTOSAR E2E profile 1 (variant 1C: CRC-8 in byte 0, a counter of
0..14 in the low half of byte 1) and 52 bits of content. So our messages are packed anew:

- edges: of layshaft and main shaft the rising ones alone, three a frame, with the low four bits of
  the newest one's running number. `SensorRead` opens each read with the sensor clock and the low
  eight bits of the numbers that the read goes up to;
- input and propeller shaft: their speeds, in the standard layout of J1939's ETC1;
- positions: two samples of each sleeve, 5 ms apart, in 0.01 mm;
- valve commands: the actions of all nine valves, and the activation time of the first one that has
  one; each further activation is a `ValveTime` before it;
- what comes seldom (outcomes, events of the rig, the bench's commands) and the controller's status:
  cut into parts of 52 bits, a signal never across two.

J1939 messages stay what they are; engine speed and engine request come every 20 ms. Not there, for
want of room: the falling edges, the estimates, the rig's encoder, faults ordered over the bus.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

from meshpoint.dbc.node import Node
from meshpoint.dbc.schema import SCHEMA
from meshpoint.dbc.specs import MessageSpec, Schema, SignalSpec

CONTENT_BIT: Final = 12
"""The first bit that is not the E2E header's."""
FRAME_BITS: Final = 64
FIRST_DATA_ID: Final = 0x4E00
SOURCES: Final = {
    Node.GEARBOX_IO: 0x80, Node.ENGINE: 0x00, Node.REFERENCE: 0x81,
    Node.TRANSMISSION_CONTROL: 0x03, Node.BENCH: 0xF9,
}  # fmt: skip
ORDER, INPUT, SLOW, PARTS = 0x0CFF_9000, 0x18FF_8000, 0x18FF_8000, 0x1CFF_A000
"""Priority and the first parameter group of valve orders, of sensors, and of parts."""
VALVES: Final = (
    "Brake", "SplitLow", "SplitHigh", "MainFirst", "MainSecond", "MainCrawl", "MainThird",
    "RangeLow", "RangeHigh",
)  # fmt: skip
STATUS_SIGNALS: Final = (
    "StepNumber", "StepTime", "State", "CurrentGear", "TargetGear", "Strategy", "Estimator",
    "ReferenceKnown", "ActiveFault", "ColdStart", "E2eErrors", "FormatErrors", "ForeignFrames",
    "GuardBlocks", "InvalidChannels", "StepLateness", "RunHashLow", "RunHashHigh",
)  # fmt: skip
"""What the controller's status says here. The checksums of what each step consumed have no room:
for a replay the controller keeps them beside its run header."""
STATUS_CYCLE_MS: Final = 200
COMMAND_CYCLE_MS: Final = 100
ENGINE_CYCLE_MS: Final = 20
SPEEDS_CYCLE_MS: Final = 50
AUX_CYCLE_MS: Final = 20
SLOW_CYCLE_MS: Final = 100
READ_CYCLE_MS: Final = 10
_OF_FD: Final = {message.name: message for message in SCHEMA.messages}


@dataclass(frozen=True)
class Parts:
    """A message of meshpoint.dbc in parts: their names, and which of its signals they have."""

    name: str
    parts: tuple[str, ...]
    signals: tuple[str, ...]


def _signal(name: str, bits: int, comment: str, like: str = "", scale: float = 0.0) -> SignalSpec:
    """A signal of this many bits. `like`: Message.Signal of meshpoint.dbc, whose unit, table and
    range it has; scale: of its own, from the same zero."""
    if not like:
        top = (1 << bits) - 1
        return SignalSpec(name, 0, bits, False, 1.0, 0.0, "", 0, top, 0, None, comment)
    message, _, signal = like.partition(".")
    fd = next(s for s in _OF_FD[message].signals if s.name == signal)
    wide = replace(fd, name=name, start_bit=0, bits=bits, comment=comment)
    if not scale:
        return replace(wide, raw_max=min(fd.raw_max, wide.type_max))
    low, high = (fd.scale * raw / scale for raw in (fd.raw_min, fd.raw_max))
    start = round(fd.raw_start * fd.scale / scale)
    return replace(
        wide,
        scale=scale,
        raw_min=max(wide.type_min, round(low)),
        raw_max=min(wide.type_max, round(high)),
        raw_start=start,
    )


def _placed(signals: Iterable[SignalSpec], from_bit: int) -> tuple[SignalSpec, ...]:
    placed = []
    for signal in signals:
        placed.append(replace(signal, start_bit=from_bit))
        from_bit += signal.bits
    if from_bit > FRAME_BITS:
        raise ValueError(f"{placed[0].name} ...: {from_bit} bits in a frame of {FRAME_BITS}")
    return tuple(placed)


def _header() -> tuple[SignalSpec, ...]:
    return (
        replace(_signal("Crc", 8, "AUTOSAR E2E profile 1 CRC-8 (SAE J1850) over the data ID, low "
                "byte first, and bytes 1..7"), start_bit=0),
        replace(_signal("Counter", 4, "AUTOSAR E2E profile 1 alive counter, 0..14, one more with "
                "every frame of this identifier"), start_bit=8, raw_max=14),
    )  # fmt: skip


def _own(
    name: str, can_id: int, sender: Node, receivers: frozenset[Node], cycle_ms: int,
    signals: Iterable[SignalSpec], comment: str,
) -> MessageSpec:  # fmt: skip
    """A protected frame of our own; can_id without the source address."""
    data_id = FIRST_DATA_ID + (can_id >> 8 & 0xFF)
    placed = (*_header(), *_placed(signals, CONTENT_BIT))
    return MessageSpec(
        name, can_id | SOURCES[sender], 8, False, sender, receivers, 1000 * cycle_ms, data_id,
        placed, comment, is_short=True,
    )  # fmt: skip


_CONTROL: Final = frozenset({Node.TRANSMISSION_CONTROL})
_RIG: Final = frozenset({Node.GEARBOX_IO, Node.BENCH})


def _read() -> MessageSpec:
    rise = "EdgesLayshaftRise"
    return _own(
        "SensorRead", INPUT, Node.GEARBOX_IO, _CONTROL, READ_CYCLE_MS,
        (
            _signal("ReadTime", 32, "Sensor clock at this read, to which all frames up to the next "
                    "one belong; wraps every 71.6 minutes", f"{rise}.ReadTime"),
            _signal("LayshaftIndex", 8, "Low 8 bits of the running number of the newest layshaft "
                    "edge that is sent with this read"),
            _signal("MainIndex", 8, "The same of the main shaft"),
            *(
                _signal(f"{shaft}{what}", 1, comment, f"{rise}.{what}")
                for what, comment in (
                    ("Stopped", "No edge for over 65535 us before the read"),
                    ("SensorFault", "The sensor supply or signal is out of range"),
                )
                for shaft in ("Layshaft", "Main")
            ),
        ),
        "Begins a read of the sensors: its time, and up to which edge it goes",
    )  # fmt: skip


def _edges(name: str, number: int, shaft: str) -> MessageSpec:
    stamps = (
        _signal(f"TimestampLow{k:02}", 16, f"Low 16 bits of the sensor clock at the edge {k} "
                "before the newest of this frame", "EdgesLayshaftRise.TimestampLow00")
        for k in range(3)
    )  # fmt: skip
    index = _signal(
        "NewestIndex", 4, "Low 4 bits of the running number of this frame's newest edge"
    )
    return _own(
        name, INPUT + (number << 8), Node.GEARBOX_IO, _CONTROL, 0, (index, *stamps),
        f"{shaft} Hall sensor: three rising edges, newest first. A read sends as many as it takes; "
        "where ten or more edges are new, one or two of them wait for the next read",
    )  # fmt: skip


def _pressures() -> MessageSpec:
    flags = [f"{valve}{what}" for what in ("Energised", "Pending") for valve in VALVES]
    return _own(
        "GearboxState", INPUT + 0x300, Node.GEARBOX_IO, _CONTROL | {Node.BENCH}, READ_CYCLE_MS,
        (
            _signal("Read", 4, "Counter of the SensorRead that this belongs to"),
            _signal("BrakePressure", 12, "Absolute pressure in the brake cylinder",
                    "GearboxSensors.BrakePressure", 0.0032),
            _signal("ClutchPosition", 10, "0 open, 100 closed", "GearboxSensors.ClutchPosition",
                    0.1),
            *(_signal(name, 1, _comment("ValveStatus", name), f"ValveStatus.{name}")
              for name in flags),
            _signal("RefusedCount", 4, "Activations refused, modulo 16"),
            _signal("ExpiredCount", 4, "Expiries, modulo 16"),
        ),
        "Brake pressure, clutch, and what the valve drivers do; comes behind a read's edges",
    )  # fmt: skip


def _comment(message: str, signal: str) -> str:
    return next(s.comment for s in _OF_FD[message].signals if s.name == signal)


def _sleeves(name: str, number: int, fd: str, sleeves: tuple[str, str], ms: int) -> MessageSpec:
    like = f"{fd}.{sleeves[0]}00"
    samples = [
        _signal(f"{sleeve}{k:02}", 12, f"Sleeve position {5 * k} ms before the read", like, 0.01)
        for sleeve in sleeves
        for k in (0, 1)
    ]
    return _own(
        name, INPUT + (number << 8), Node.GEARBOX_IO, _CONTROL, ms,
        (
            _signal("Read", 2, "Low 2 bits of the counter of the SensorRead it belongs to"),
            _signal("SensorFault", 2, _comment(fd, "SensorFault"), f"{fd}.SensorFault"),
            *samples,
        ),
        _OF_FD[fd].comment,
    )  # fmt: skip


def _slow() -> MessageSpec:
    sensors = "GearboxSensors"
    return _own(
        "SlowSensors", INPUT + 0x600, Node.GEARBOX_IO, _CONTROL, SLOW_CYCLE_MS,
        (
            _signal("SupplyPressure", 16, _comment(sensors, "SupplyPressure"),
                    f"{sensors}.SupplyPressure"),
            _signal("OilTemperature", 16, _comment(sensors, "OilTemperature"),
                    f"{sensors}.OilTemperature"),
        ),
        "What changes slowly",
    )  # fmt: skip


def _orders() -> tuple[MessageSpec, ...]:
    time = _signal(
        "Time", 32, "Sensor clock at which the activation takes effect", "ValveCommand.BrakeTime"
    )
    valve_time = _own(
        "ValveTime", ORDER, Node.TRANSMISSION_CONTROL, _RIG, 0,
        (
            _signal("Order", 4, "Counter of the ValveOrders that follows and that this belongs to"),
            _signal("Valve", 4, "Number of the valve, in the order of ValveOrders from 0"),
            time,
        ),
        "Activation time of one more valve; comes before its ValveOrders",
    )  # fmt: skip
    actions = [
        _signal(f"{v}Action", 2, _comment("ValveCommand", f"{v}Action"), f"ValveCommand.{v}Action")
        for v in VALVES
    ]
    clutch = _signal("Clutch", 2, "0 not commanded, 1 open, 2 close")
    first = replace(
        time,
        name="FirstTime",
        comment="Activation time of the first valve whose action is OffAt or OnAt",
    )
    orders = _own(
        "ValveOrders", ORDER + 0x100, Node.TRANSMISSION_CONTROL, _RIG, READ_CYCLE_MS,
        (*actions, clutch, first), "Commands of all valves and of the clutch",
    )  # fmt: skip
    return valve_time, orders


def _speeds() -> MessageSpec:
    """ETC1 from the sensor side, with what a shaft's speed sensor knows."""
    etc1 = _OF_FD["ETC1"]
    return replace(
        etc1,
        can_id=etc1.can_id & ~0xFF | SOURCES[Node.GEARBOX_IO],
        sender=Node.GEARBOX_IO,
        receivers=_CONTROL,
        cycle_time_us=1000 * SPEEDS_CYCLE_MS,
        comment="J1939 electronic transmission controller 1, from the sensors: speeds of input and "
        "propeller shaft",
    )


def _j1939() -> tuple[MessageSpec, ...]:
    slower = {"EEC1": ENGINE_CYCLE_MS, "TSC1": ENGINE_CYCLE_MS}
    found = []
    for name in ("EEC1", "TSC1", "ETC2", "TC1"):
        fd = _OF_FD[name]
        cycle_us = 1000 * slower[name] if name in slower else fd.cycle_time_us
        found.append(replace(fd, cycle_time_us=cycle_us))
    return tuple(found)


IN_PARTS: Final = {
    "ControllerStatus": STATUS_CYCLE_MS,
    "ShiftPrediction": 0,
    "ShiftOutcome": 0,
    "ReferenceEngagement": 0,
    "BenchCommand": COMMAND_CYCLE_MS,
}
"""The messages that come in parts, and how often, in ms."""


def _cut(fd: MessageSpec) -> list[list[SignalSpec]]:
    wanted = STATUS_SIGNALS if fd.name == "ControllerStatus" else None
    rows: list[list[SignalSpec]] = [[]]
    room = FRAME_BITS - CONTENT_BIT
    for signal in fd.signals[2:]:
        if wanted is not None and signal.name not in wanted:
            continue
        bits = min(signal.bits, room)  # of step times of 64 bits, the first 143 years
        if sum(s.bits for s in rows[-1]) + bits > room:
            rows.append([])
        top = min(signal.raw_max, (1 << bits) - 1)
        rows[-1].append(replace(signal, bits=bits, raw_max=top))
    return rows


def _parts() -> tuple[tuple[Parts, ...], tuple[MessageSpec, ...]]:
    number, kinds, messages = 0, [], []
    for name, cycle_ms in IN_PARTS.items():
        fd = _OF_FD[name]
        rows = _cut(fd)
        names = tuple(f"{name}{k + 1}" for k in range(len(rows)))
        for part, (part_name, row) in enumerate(zip(names, rows, strict=True)):
            messages.append(_own(
                part_name, PARTS + (number << 8), fd.sender, fd.receivers, cycle_ms, row,
                f"Part {part + 1} of {len(rows)}, all with one counter: {fd.comment}",
            ))  # fmt: skip
            number += 1
        kinds.append(Parts(name, names, tuple(s.name for row in rows for s in row)))
    return tuple(kinds), tuple(messages)


PARTED, _PART_MESSAGES = _parts()
"""The messages of meshpoint.dbc that come in parts."""

CONTRACT: Final = Schema(
    (
        *_orders(),
        _read(),
        _edges("EdgesLayshaft", 1, "Layshaft"),
        _edges("EdgesMain", 2, "Main shaft"),
        _pressures(),
        _sleeves("SleevesMainShort", 4, "SleevesMain", ("SleeveFirstSecond", "SleeveCrawlThird"),
                 READ_CYCLE_MS),
        _sleeves("SleevesAuxShort", 5, "SleevesAux", ("SleeveSplitter", "SleeveRange"),
                 AUX_CYCLE_MS),
        _slow(),
        _speeds(),
        *_j1939(),
        *_PART_MESSAGES,
    ),
    SCHEMA.value_tables,
)  # fmt: skip
"""The classic profile."""
