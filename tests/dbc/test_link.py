"""A node's two ends of the link: who hears what, and what happens to damaged and missing frames."""

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from link_frames import controller, sensor_frames, verdicts

from meshpoint.dbc import Frame, Node
from meshpoint.dbc.e2e import write_crc
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import EncodeError, FrameVerdict, Receiver, Transmitter, read_alone
from meshpoint.dbc.messages import (
    EEC1,
    MESSAGE_TYPES,
    GearboxSensors,
    ReferenceEncoder,
    ReferenceEngagement,
    ValveCommand,
    ValveStatus,
)

PROTECTED = [codec for codec in CODECS.values() if codec.spec.data_id is not None]


@pytest.mark.parametrize("node", Node)
def test_a_node_hears_what_the_dbc_lists_it_for_and_nothing_else(node: Node) -> None:
    for codec in CODECS.values():
        frame = Transmitter(codec.spec.sender).encode(codec.message_type())
        received = Receiver(node).receive(frame)
        if node in codec.spec.receivers:
            assert received.verdict is FrameVerdict.OK
            assert type(received.message) is codec.message_type
        else:
            assert received == (FrameVerdict.NOT_FOR_US, None)


def test_the_controller_never_hears_the_reference() -> None:
    receiver = controller()
    for name, message_type in MESSAGE_TYPES.items():
        if name.startswith("Reference"):
            frame = Transmitter(Node.REFERENCE).encode(message_type())
            assert receiver.receive(frame) == (FrameVerdict.NOT_FOR_US, None)


def test_a_node_sends_its_own_messages_only() -> None:
    with pytest.raises(EncodeError, match="TransmissionControl: does not send ReferenceEncoder"):
        Transmitter(Node.TRANSMISSION_CONTROL).encode(ReferenceEncoder())
    rig = Transmitter(Node.GEARBOX_IO, Node.ENGINE, Node.REFERENCE)
    assert rig.encode(ReferenceEncoder()).is_fd
    assert not rig.encode(EEC1()).is_fd


@pytest.mark.parametrize("codec", PROTECTED, ids=lambda codec: codec.spec.name)
def test_every_single_flipped_bit_is_noticed(codec: Any) -> None:
    frame = Transmitter(codec.spec.sender).encode(codec.message_type())
    receiver = Receiver(*Node)
    for bit in range(8 * len(frame.data)):
        damaged = bytearray(frame.data)
        damaged[bit // 8] ^= 1 << bit % 8
        assert receiver.receive(frame._replace(data=bytes(damaged))) == (FrameVerdict.E2E, None)
    assert receiver.e2e_errors == 8 * len(frame.data)
    assert receiver.receive(frame).verdict is FrameVerdict.OK


@settings(max_examples=150)
@given(
    st.sampled_from(PROTECTED),
    st.binary(min_size=64, max_size=64),
    st.sets(st.integers(0, 511), min_size=2, max_size=3),
)
def test_two_and_three_flipped_bits_are_noticed(codec: Any, noise: bytes, bits: set[int]) -> None:
    length = codec.spec.length
    data = bytearray(noise[:length])
    write_crc(data, codec.spec.data_id, increment_counter=False)
    for bit in {bit % (8 * length) for bit in bits}:
        data[bit // 8] ^= 1 << bit % 8
    assert Receiver(*Node).receive(Frame(codec.spec.can_id, bytes(data))) == (
        FrameVerdict.E2E,
        None,
    )


@settings(max_examples=100)
@given(
    st.one_of(
        st.integers(0, (1 << 29) - 1), st.sampled_from([c.spec.can_id for c in CODECS.values()])
    ),
    st.binary(max_size=64),
    st.booleans(),
    st.booleans(),
)
def test_no_frame_can_upset_a_receiver(
    can_id: int, data: bytes, is_fd: bool, is_extended: bool
) -> None:
    received = Receiver(*Node).receive(Frame(can_id, data, is_fd, is_extended))
    assert (received.message is not None) == (received.verdict is FrameVerdict.OK)


@pytest.mark.parametrize("name", MESSAGE_TYPES)
def test_wrong_length_and_frame_format_are_refused(name: str) -> None:
    codec = CODECS[name]
    frame = Transmitter(codec.spec.sender).encode(codec.message_type())
    receiver = Receiver(*Node)
    wrong = [
        frame._replace(data=frame.data[:-1]),
        frame._replace(data=b""),
        frame._replace(data=frame.data + b"\0"),
        frame._replace(is_fd=not frame.is_fd),
    ]
    assert verdicts(receiver, wrong) == [FrameVerdict.FORMAT] * 4
    assert receiver.format_errors == 4
    assert receiver.receive(frame._replace(is_extended=False)) == (FrameVerdict.FOREIGN, None)
    assert receiver.foreign_frames == 1


def test_foreign_frames_are_counted_and_those_for_others_are_not() -> None:
    receiver = controller()
    assert receiver.receive(Frame(0x18FEF100, bytes(8), is_fd=False)) == (
        FrameVerdict.FOREIGN,
        None,
    )
    receiver.receive(Transmitter(Node.TRANSMISSION_CONTROL).encode(ValveCommand()))
    counts = receiver.foreign_frames, receiver.format_errors, receiver.e2e_errors
    assert counts == (1, 0, 0)


def test_a_repeated_frame_counts_once() -> None:
    receiver = controller()
    first, second = sensor_frames(2)
    expected = [FrameVerdict.OK, FrameVerdict.REPEATED, FrameVerdict.OK, FrameVerdict.REPEATED]
    assert verdicts(receiver, [first, first, second, second]) == expected
    assert receiver.e2e_errors == 2


def test_one_lost_frame_is_tolerated_and_after_two_the_next_is_refused() -> None:
    frames = sensor_frames(10)
    assert verdicts(controller(), [frames[0], frames[2], frames[4]]) == [FrameVerdict.OK] * 3
    assert verdicts(controller(), [frames[0], frames[3], frames[4]]) == [
        FrameVerdict.OK,
        FrameVerdict.WRONG_SEQUENCE,
        FrameVerdict.OK,
    ]


def test_of_two_swapped_frames_the_late_one_is_refused() -> None:
    frames = sensor_frames(4)
    swapped = [frames[0], frames[2], frames[1], frames[3]]
    assert verdicts(controller(), swapped) == [
        FrameVerdict.OK,
        FrameVerdict.OK,
        FrameVerdict.WRONG_SEQUENCE,
        FrameVerdict.OK,
    ]


def test_the_counter_is_one_more_with_every_frame_and_runs_over_its_end() -> None:
    frames = sensor_frames(600)
    assert [frame.data[2] for frame in frames] == [number % 256 for number in range(600)]
    assert set(verdicts(controller(), frames)) == {FrameVerdict.OK}


@settings(max_examples=100)
@given(st.lists(st.sampled_from(["pass", "pass", "pass", "lose", "repeat", "hold"]), max_size=60))
def test_whatever_the_bus_does_no_message_comes_twice(fates: list[str]) -> None:
    frames = sensor_frames(len(fates))
    arriving: list[Frame] = []
    held: list[Frame] = []
    for frame, fate in zip(frames, fates, strict=True):
        if fate == "hold":
            held.append(frame)
        elif fate != "lose":
            arriving += [frame, frame] if fate == "repeat" else [frame]
            arriving += held
            held = []
    receiver = controller()
    received = [receiver.receive(frame).message for frame in arriving]
    times = [m.sample_time_us for m in received if isinstance(m, GearboxSensors)]
    assert len(set(times)) == len(times)
    for (before, frame), message in zip(pairwise(arriving), received[1:], strict=True):
        if (frame.data[2] - before.data[2]) % 256 == 1:
            assert message is not None  # the frame after its predecessor is always taken
        if frame.data[2] == before.data[2]:
            assert message is None


def test_a_frame_by_itself_is_read_whatever_its_counter_and_refused_where_it_is_damaged() -> None:
    codec, sender = CODECS["ValveStatus"], Transmitter(Node.GEARBOX_IO)
    status = ValveStatus(sample_time_us=1_000, brake_energised=True)
    frames = [sender.encode(status) for _ in range(3)]
    assert [read_alone(codec, frame) for frame in frames] == [status] * 3
    frame = frames[0]
    flipped = bytes([frame.data[0] ^ 1]) + frame.data[1:]
    assert read_alone(codec, frame._replace(data=flipped)) is None
    assert read_alone(codec, frame._replace(data=frame.data[:-1])) is None
    assert read_alone(codec, frame._replace(can_id=frame.can_id + 1)) is None


def test_a_frame_without_protection_is_read_by_itself_too() -> None:
    sent = Transmitter(Node.ENGINE).encode(EEC1(engine_speed_rad_s=100.0))
    found = read_alone(CODECS["EEC1"], sent)
    assert found.engine_speed_rad_s == pytest.approx(100.0, abs=0.02)
    assert read_alone(CODECS["EEC1"], sent._replace(data=sent.data + b"\0")) is None


def test_a_frame_instead_of_one_that_is_not_sent_has_its_counter() -> None:
    """All around the counter: what the receiver gets counts on by one."""
    sender, receiver = Transmitter(Node.TRANSMISSION_CONTROL), Receiver(Node.GEARBOX_IO)
    counters = []
    for _ in range(300):
        sender.encode(ValveCommand())
        frame = sender.instead(ValveCommand())
        counters.append(frame.data[2])
        assert receiver.receive(frame).verdict is FrameVerdict.OK
    assert counters == [(counters[0] + k) % 256 for k in range(300)]
    assert receiver.receive(sender.encode(ValveCommand())).verdict is FrameVerdict.OK


def test_what_nobody_reads_is_an_empty_frame_of_its_message() -> None:
    rig, controller = Transmitter(Node.GEARBOX_IO, Node.REFERENCE), Transmitter(Node.BENCH)
    assert rig.unread(ReferenceEncoder) is None
    for transmitter in (rig, controller):
        transmitter.skip_unsubscribed({ReferenceEncoder, ReferenceEngagement})
    specs = [CODECS[kind.__name__].spec for kind in (ReferenceEngagement, ReferenceEncoder)]
    empty = [Frame(spec.can_id, bytes(spec.length), spec.is_fd, True) for spec in specs]
    assert rig.unread(ReferenceEngagement, ReferenceEncoder) == empty
    assert rig.unread(ReferenceEncoder, GearboxSensors) is None
    assert rig.unread(GearboxSensors) is None
    assert controller.unread(ReferenceEncoder) is None
