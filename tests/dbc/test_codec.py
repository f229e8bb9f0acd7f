"""The codec against cantools, byte for byte and value for value, for every message of the DBC."""

import math
import re
from typing import Any

import pytest
from cantools.database.can import Database
from cantools.database.can import Message as Parsed
from cantools.database.can import Signal as ParsedSignal
from e2e.p05 import e2e_p05_protect
from hypothesis import given, settings
from hypothesis import strategies as st
from read_dbc import database

from meshpoint.dbc import DBC_PATH, Frame, Node
from meshpoint.dbc.link import EncodeError, FrameVerdict, Receiver, Transmitter
from meshpoint.dbc.messages import (
    MESSAGE_TYPES,
    TC1,
    ClutchAction,
    ClutchCommand,
    EdgesMainRise,
    GearboxSensors,
    ValveAction,
    ValveCommand,
)

_DATABASE = database(DBC_PATH)
assert isinstance(_DATABASE, Database)
MESSAGES: list[Parsed] = _DATABASE.messages
HEADER = {"Crc", "Counter"}

# The same conversions as the product's, written down once more from the definitions of the units.
TO_SI = {
    "rpm": ("_rad_s", lambda rpm: rpm * 2.0 * math.pi / 60.0),
    "deg": ("_rad", math.radians),
    "bar": ("_pa", lambda bar: bar * 100_000.0),
    "mm": ("_m", lambda mm: mm / 1000.0),
    "km/h": ("_m_s", lambda kmh: kmh / 3.6),
    "J": ("_j", lambda joule: joule),
    "degC": ("_k", lambda celsius: celsius + 273.15),
    "%": ("_fraction", lambda percent: percent / 100.0),
    "us": ("_us", lambda us: us),
    "": ("", lambda number: number),
}
each_message = pytest.mark.parametrize("parsed", MESSAGES, ids=lambda parsed: parsed.name)


def data_id(parsed: Parsed) -> int | None:
    assert parsed.dbc is not None
    attribute = parsed.dbc.attributes.get("E2EDataId")
    return None if attribute is None else int(attribute.value)


def protected(data: bytes, parsed: Parsed) -> bytes:
    """The payload with a CRC where the DBC asks for one, by the AUTOSAR library."""
    identifier = data_id(parsed)
    if identifier is None:
        return data
    buffer = bytearray(data)
    e2e_p05_protect(buffer, identifier, increment_counter=False)
    return bytes(buffer)


def frame_of(parsed: Parsed, data: bytes) -> Frame:
    return Frame(parsed.frame_id, data, parsed.is_fd)


def own_signals(parsed: Parsed) -> list[ParsedSignal]:
    return [signal for signal in parsed.signals if signal.name not in HEADER]


def is_in_range(signal: ParsedSignal, value: float) -> bool:
    assert signal.minimum is not None
    assert signal.maximum is not None
    slack = 1e-6 * signal.scale
    return signal.minimum - slack <= value <= signal.maximum + slack


def field_value(message: Any, signal: ParsedSignal) -> Any:
    """The field that a signal should be in, by the naming rule."""
    suffix, _ = TO_SI[signal.unit or ""]
    match = re.fullmatch(r"(.*\D)(\d\d)", signal.name)
    name = match[1] if match else signal.name
    name = re.sub(r"(?<=[a-z0-9])([A-Z])", r"_\1", name).lower() + suffix
    value = getattr(message, name)
    return value[int(match[2])] if match else value


def raw_limits(signal: ParsedSignal, is_wide: bool) -> tuple[int, int]:
    """As wide as the bits, or the DBC's range."""
    low = -(1 << signal.length - 1) if signal.is_signed else 0
    high = low + (1 << signal.length) - 1
    if is_wide:
        return low, high
    assert signal.minimum is not None
    assert signal.maximum is not None
    ends = [(end - signal.offset) / signal.scale for end in (signal.minimum, signal.maximum)]
    return max(low, round(ends[0])), min(high, round(ends[1]))


@st.composite
def raw_values(draw: st.DrawFn, parsed: Parsed, is_wide: bool = False) -> dict[str, int]:
    """Raw values of all signals: all at one end of their range, or anywhere in it."""
    where = draw(st.sampled_from(["anywhere", "lowest", "highest"]))
    bits = int.from_bytes(draw(st.binary(min_size=parsed.length, max_size=parsed.length)), "little")
    raws = {}
    for signal in parsed.signals:
        low, high = raw_limits(signal, is_wide)
        anywhere = low + (bits >> signal.start) % (high - low + 1)
        raws[signal.name] = {"anywhere": anywhere, "lowest": low, "highest": high}[where]
    return raws


@each_message
@settings(max_examples=12)
@given(drawn=st.data())
def test_decodes_what_cantools_decodes(parsed: Parsed, drawn: st.DataObject) -> None:
    raws = drawn.draw(raw_values(parsed, is_wide=drawn.draw(st.booleans())))
    is_padded = drawn.draw(st.booleans(), label="unused bits set")
    data = protected(parsed.encode(raws, scaling=False, padding=is_padded, strict=False), parsed)
    expected: Any = parsed.decode(data, decode_choices=False)
    is_j1939 = data_id(parsed) is None

    verdict, message = Receiver(*Node).receive(frame_of(parsed, data))

    are_in_range = all(is_in_range(s, expected[s.name]) for s in own_signals(parsed))
    if not (is_j1939 or are_in_range):
        assert (verdict, message) == (FrameVerdict.FORMAT, None)
        return
    assert verdict is FrameVerdict.OK
    assert type(message) is MESSAGE_TYPES[parsed.name]
    for signal in own_signals(parsed):
        ours = field_value(message, signal)
        if is_in_range(signal, expected[signal.name]):
            convert = TO_SI[signal.unit or ""][1]
            assert ours == pytest.approx(convert(expected[signal.name]), rel=1e-12, abs=1e-12)
        else:
            assert ours is None


@each_message
@settings(max_examples=12)
@given(drawn=st.data())
def test_encodes_to_the_bytes_of_cantools(parsed: Parsed, drawn: st.DataObject) -> None:
    raws = drawn.draw(raw_values(parsed))
    wire: dict[str, float] = {}
    rows: dict[str, list[Any]] = {}
    # Between two steps of the wire, but not so near the middle that a rounding error decides.
    fraction = drawn.draw(st.floats(-0.49, 0.49))
    for signal in own_signals(parsed):
        scaled = raws[signal.name] * signal.scale + signal.offset
        if is_rounded(signal):
            scaled += fraction * signal.scale
            scaled = min(max(scaled, signal.minimum or 0), signal.maximum or 0)
        wire[signal.name] = scaled
        rows.setdefault(row_name(signal), []).append(TO_SI[signal.unit or ""][1](scaled))
    message = build(parsed, rows)
    is_j1939 = data_id(parsed) is None
    expected = parsed.encode(
        wire if is_j1939 else {**wire, "Crc": 0, "Counter": 0}, padding=is_j1939
    )

    frame = Transmitter(*Node).encode(message)

    assert frame == frame_of(parsed, protected(expected, parsed))


@each_message
@settings(max_examples=12)
@given(drawn=st.data())
def test_what_was_decoded_encodes_to_the_same_bytes(parsed: Parsed, drawn: st.DataObject) -> None:
    raws = drawn.draw(raw_values(parsed))
    raws = {**raws, "Counter": 0} if "Counter" in raws else raws
    is_j1939 = data_id(parsed) is None
    data = protected(parsed.encode(raws, scaling=False, padding=is_j1939, strict=False), parsed)
    frame = frame_of(parsed, data)
    message = Receiver(*Node).receive(frame).message
    assert message is not None

    assert Transmitter(*Node).encode(message) == frame


def is_rounded(signal: ParsedSignal) -> bool:
    """Whether the field is a float, which the wire rounds to its next step."""
    return signal.unit not in ("", "us", None) or signal.scale != 1


def row_name(signal: ParsedSignal) -> str:
    return re.sub(r"(?<=\D)\d\d$", "", signal.name)


def build(parsed: Parsed, rows: dict[str, list[Any]]) -> Any:
    """A message from the values of its signals, in the order of the wire."""
    values = [
        tuple(row) if name not in {signal.name for signal in parsed.signals} else row[0]
        for name, row in rows.items()
    ]
    return MESSAGE_TYPES[parsed.name](*values)


def number_fields(message: Any) -> list[str]:
    """Fields whose value is a number, not a truth or a name."""
    return [
        name
        for name, value in message._asdict().items()
        if type(value) in (int, float) or (isinstance(value, tuple) and type(value[0]) is float)
    ]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e300, "1", None])
def test_what_is_no_finite_number_in_range_is_never_sent(bad: object) -> None:
    for name, make in MESSAGE_TYPES.items():
        message: Any = make()
        for field in number_fields(message):
            is_optional = data_id(_DATABASE.get_message_by_name(name)) is None
            if bad is None and is_optional:
                continue
            value = getattr(message, field)
            wrong = (*value[:-1], bad) if isinstance(value, tuple) else bad
            with pytest.raises(EncodeError, match=rf"{name}\.\w+ \({field}\) is .* is allowed"):
                Transmitter(*Node).encode(message._replace(**{field: wrong}))


@pytest.mark.parametrize(
    ("message", "complaint"),
    [
        (
            GearboxSensors(clutch_position_fraction=1.01),
            "GearboxSensors.ClutchPosition (clutch_position_fraction) is 1.01, 0..1 is allowed",
        ),
        (
            EdgesMainRise(valid_stamps=28),
            "EdgesMainRise.ValidStamps (valid_stamps) is 28, 0..27 is allowed",
        ),
        (
            EdgesMainRise(read_time_us=1 << 32),
            "EdgesMainRise.ReadTime (read_time_us) is 4294967296, 0..4294967295 is allowed",
        ),
        (
            EdgesMainRise(timestamp_low_us=(1, 2)),
            "EdgesMainRise.timestamp_low_us is (1, 2), 27 values are allowed",
        ),
        (TC1(requested_gear=126), "TC1.RequestedGear (requested_gear) is 126, -125..125 or None"),
    ],
)
def test_an_encode_error_names_message_signal_value_and_range(message: Any, complaint: str) -> None:
    with pytest.raises(EncodeError, match=re.escape(complaint)):
        Transmitter(*Node).encode(message)


def test_a_neighbour_in_the_same_byte_never_spills_over() -> None:
    """Values too large for their bits are refused, not masked: they would set other valves."""
    wrong: Any = 4
    with pytest.raises(EncodeError, match="BrakeAction"):
        Transmitter(Node.TRANSMISSION_CONTROL).encode(ValveCommand(brake_action=wrong))


def test_defaults_command_everything_off() -> None:
    command = ValveCommand()
    assert set(command[:9]) == {ValveAction.OFF_NOW}
    assert ClutchCommand().action is ClutchAction.OPEN
    data = Transmitter(Node.TRANSMISSION_CONTROL).encode(command).data
    assert data[3:] == bytes(45)


def test_not_available_is_all_ones_on_the_wire() -> None:
    frame = Transmitter(Node.BENCH).encode(TC1(requested_gear=None))
    assert frame.data == b"\xff" * 8
    message = Receiver(Node.TRANSMISSION_CONTROL).receive(frame).message
    assert isinstance(message, TC1)
    assert message.requested_gear is None
    assert message.requested_clutch_slip_fraction is None
