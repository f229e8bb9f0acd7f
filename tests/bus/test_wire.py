"""How frames are laid out between node and hub."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from meshpoint.bus.local import wire
from meshpoint.bus.local.wire import Flag

# On a busy machine any example may take long.
patient = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])

FD = Flag.EXTENDED | Flag.FD


def unpacked(stream: bytes) -> list[wire.WireRecord]:
    return [record for record, _ in wire.records(stream)]


@given(st.binary(max_size=300))
@patient
def test_bytes_that_are_no_records_are_an_error_or_incomplete_and_nothing_else(junk: bytes) -> None:
    try:
        for record, end in wire.records(junk):
            assert end <= len(junk)
            assert len(record.data) <= 64
    except wire.WireError as error:
        assert "record starts with 0x" in str(error)


@given(st.lists(st.binary(max_size=8), min_size=1, max_size=10), st.data())
@patient
def test_a_stream_may_be_cut_anywhere(payloads: list[bytes], data: st.DataObject) -> None:
    stream = b"".join(
        wire.pack(Flag.EXTENDED, index, payload, len(payload))
        for index, payload in enumerate(payloads)
    )
    cut = data.draw(st.integers(0, len(stream)))
    head = list(wire.records(stream[:cut]))
    behind = head[-1][1] if head else 0
    records = [record for record, _ in head] + unpacked(stream[behind:])
    assert [record.data for record in records] == payloads


def test_missing_bytes_lead_from_record_to_record() -> None:
    stream = wire.pack(FD, 1, bytes(12), 12) + wire.pack(FD, 2, b"", 0)
    taken = bytearray()
    reads = []
    while missing := wire.missing_bytes(bytes(taken)):
        reads.append(missing)
        taken += stream[len(taken) : len(taken) + missing]
    assert reads == [16, 12]
    assert unpacked(bytes(taken))[0].can_id == 1


def test_a_stamp_reaches_every_complete_record_and_stops_at_a_bad_one() -> None:
    record = wire.pack(FD, 1, bytes(8), 8)
    stream = bytearray(record * 2 + record[:20])
    assert wire.stamp(stream, 1_700_000_000_000_000) == (48, None)
    assert [record.time_us for record in unpacked(bytes(stream[:48]))] == [
        1_700_000_000_000_000
    ] * 2
    broken = bytearray(record + b"\xff" + record[1:])
    end, error = wire.stamp(broken, 1)
    assert end == len(record)
    assert isinstance(error, wire.WireError)


@pytest.mark.parametrize(
    ("flags", "can_id", "length"),
    [
        (Flag.FD, 1, 9),
        (0, 1, 9),
        (0, 0x800, 8),
        (Flag.EXTENDED, 1 << 29, 8),
        (Flag.BITRATE_SWITCH, 1, 8),
        (Flag.FD | Flag.REMOTE, 1, 8),
        (Flag.ERROR | Flag.REMOTE, 1, 8),
    ],
)
def test_what_cannot_be_on_a_can_bus_is_not_packed(flags: int, can_id: int, length: int) -> None:
    with pytest.raises(wire.WireError, match="no CAN frame"):
        wire.pack(flags, can_id, bytes(length), length)
