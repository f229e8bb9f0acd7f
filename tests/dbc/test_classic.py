"""The classic profile's DBC, and E2E profile 1 over its frames."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from read_dbc import database

from meshpoint.dbc.classic.codecs import (
    CLASSIC_CODECS,
    CLASSIC_SCHEMA,
    COUNTERS,
    ClassicEar,
    ClassicSender,
    Heard,
)
from meshpoint.dbc.classic.contract import CONTRACT
from meshpoint.dbc.classic.make import main
from meshpoint.dbc.classic.source import CLASSIC_DBC
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.schema import SCHEMA
from meshpoint.dbc.specs import MessageSpec

OWN = [spec for spec in CLASSIC_SCHEMA.messages if spec.is_protected]
DATABASE = database(CLASSIC_DBC)


def raw_values(spec: MessageSpec) -> st.SearchStrategy[dict[str, int]]:
    """Raw values of all signals but the header's, within their ranges."""
    return st.fixed_dictionaries(
        {s.name: st.integers(s.raw_min, s.raw_max) for s in spec.signals[2:]}
    )


def test_the_file_is_that_of_the_contract() -> None:
    """Written from it, and read back as it."""
    assert main(["--check"]) == 0
    assert CLASSIC_SCHEMA == CONTRACT


def test_all_frames_are_classic_ones_of_eight_bytes() -> None:
    assert {(spec.length, spec.is_fd) for spec in CLASSIC_SCHEMA.messages} == {(8, False)}


def test_identifiers_tell_the_two_profiles_apart() -> None:
    """What both have is J1939 and the same in both."""
    fd = {spec.can_id: spec for spec in SCHEMA.messages}
    shared = [spec for spec in CLASSIC_SCHEMA.messages if spec.can_id in fd]
    assert {spec.name for spec in shared} == {"EEC1", "TSC1", "ETC2", "TC1"}
    for spec in shared:
        assert (spec.signals, spec.sender) == (fd[spec.can_id].signals, fd[spec.can_id].sender)


@pytest.mark.parametrize("spec", OWN, ids=[spec.name for spec in OWN])
def test_cantools_reads_what_we_send(spec: MessageSpec) -> None:
    """Each signal at its ends, by a reader that knows the file alone; and we read it again."""
    codec = CLASSIC_CODECS[spec.name]
    for end in ("raw_min", "raw_max"):
        wanted = {s.name: getattr(s, end) for s in spec.signals[2:]}
        values = [
            tuple(field.si_value(wanted[s.name]) for s in field.signals) for field in codec.fields
        ]
        plain = [
            v if field.is_tuple else v[0] for field, v in zip(codec.fields, values, strict=True)
        ]
        sender, ear = ClassicSender(spec.name), ClassicEar(spec.name)
        frame = sender.frame(sender.message_type(*plain))
        message = DATABASE.get_message_by_frame_id(frame.can_id)
        found = message.decode(frame.data, decode_choices=False, scaling=False)
        assert {name: found[name] for name in wanted} == wanted
        assert found["Counter"] == 0
        heard = ear.hear(frame)
        assert heard.heard is Heard.OK
        sent_again = ClassicSender(spec.name).frame(heard.message)
        assert sent_again == frame


@given(st.data())
def test_a_flipped_bit_is_found(data: st.DataObject) -> None:
    """A CRC-8 finds every single bit, and every two within 8 bytes."""
    spec = data.draw(st.sampled_from(OWN))
    sender, ear = ClassicSender(spec.name), ClassicEar(spec.name)
    frame = sender.frame(sender.message_type())
    bits = data.draw(st.sets(st.integers(0, 63), min_size=1, max_size=2))
    number = int.from_bytes(frame.data, "little")
    for bit in bits:
        number ^= 1 << bit
    bad = frame._replace(data=number.to_bytes(8, "little"))
    assert ear.hear(bad).heard is Heard.DAMAGED
    assert ear.hear(frame).heard is Heard.OK


@given(st.lists(st.integers(0, 20), max_size=60))
def test_the_counter_says_how_many_were_lost(lost: list[int]) -> None:
    """Of each gap modulo 15; fifteen lost frames look like a repetition, and are refused."""
    sender, ear = ClassicSender("ValveOrders"), ClassicEar("ValveOrders")
    ear.hear(sender.frame(sender.message_type()))
    for count in lost:
        for _ in range(count):
            sender.frame(sender.message_type())
        hearing = ear.hear(sender.frame(sender.message_type()))
        steps = (count + 1) % COUNTERS
        assert hearing.steps == steps
        assert hearing.heard is (Heard.OK if steps else Heard.REPEATED)


def test_frames_of_another_kind_are_damaged() -> None:
    """Of another message, of another length, or CAN FD."""
    sender = ClassicSender("ValveTime")
    frame = sender.frame(sender.message_type())
    other = ClassicEar("ValveOrders")
    for bad in (
        frame,
        Frame(frame.can_id, frame.data, is_fd=True),
        Frame(frame.can_id, frame.data[:7], is_fd=False),
    ):
        assert other.hear(bad).heard is Heard.DAMAGED


@given(raw=raw_values(next(spec for spec in OWN if spec.name == "GearboxState")))
def test_values_of_any_kind_come_back(raw: dict[str, int]) -> None:
    """Raw values in, the same raw values out of what cantools reads."""
    codec = CLASSIC_CODECS["GearboxState"]
    values = [field.si_value(raw[field.signals[0].name]) for field in codec.fields]
    sender = ClassicSender("GearboxState")
    frame = sender.frame(sender.message_type(*values))
    message = DATABASE.get_message_by_frame_id(frame.can_id)
    found = message.decode(frame.data, decode_choices=False, scaling=False)
    assert {name: found[name] for name in raw} == raw
