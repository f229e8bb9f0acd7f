"""A node's two ends of the link: who hears what, and what happens to damaged and missing frames."""

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.dbc import Frame, Node
from meshpoint.dbc.e2e import ChannelState, write_crc
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import EncodeError, FrameVerdict, Receiver, Transmitter, read_alone
from meshpoint.dbc.messages import (
    EEC1,
    MESSAGE_TYPES,
    TC1,
    ClutchCommand,
    EdgesLayshaftRise,
    GearboxSensors,
    Message,
    ReferenceEncoder,
    ReferenceEngagement,
    ShiftOutcome,
    ValveCommand,
    ValveStatus,
)

CYCLE_US = 10_000
PROTECTED = [codec for codec in CODECS.values() if codec.spec.data_id is not None]


def sensor_frames(count: int, start: int = 0) -> list[Frame]:
    """Frames of GearboxSensors with counters from `start` on; each carries its number as a time."""
    transmitter = Transmitter(Node.GEARBOX_IO)
    frames = [
        transmitter.encode(GearboxSensors(sample_time_us=number)) for number in range(start + count)
    ]
    return frames[start:]


def controller() -> Receiver:
    return Receiver(Node.TRANSMISSION_CONTROL)


def verdicts(receiver: Receiver, frames: list[Frame]) -> list[FrameVerdict]:
    return [receiver.receive(frame).verdict for frame in frames]


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


@pytest.mark.parametrize("restarted", ["sender", "receiver"])
def test_after_a_restart_the_channel_recovers_by_itself(restarted: str) -> None:
    receiver = controller()
    verdicts(receiver, sensor_frames(137))
    assert receiver.valid(GearboxSensors)
    if restarted == "sender":
        assert verdicts(receiver, sensor_frames(4)) == [
            FrameVerdict.WRONG_SEQUENCE,
            *[FrameVerdict.OK] * 3,
        ]
        assert receiver.valid(GearboxSensors)
    else:
        receiver = controller()
        assert verdicts(receiver, sensor_frames(2, start=137)) == [FrameVerdict.OK] * 2
        assert not receiver.valid(GearboxSensors)
        receiver.receive(sensor_frames(1, start=139)[0])
        assert receiver.valid(GearboxSensors)


def test_three_wrong_counters_end_validity() -> None:
    receiver = controller()
    frames = sensor_frames(20)
    verdicts(receiver, frames)
    verdicts(receiver, [frames[-1]] * 2)
    assert receiver.valid(GearboxSensors)
    receiver.receive(frames[-1])
    assert not receiver.valid(GearboxSensors)


def test_damaged_frames_of_known_identifiers_end_validity_whatever_the_damage() -> None:
    (good, *more) = sensor_frames(20)
    damages = [good._replace(data=good.data[:-1]), good._replace(data=bytes(16))]
    for damage in damages:
        receiver = controller()
        verdicts(receiver, more)
        verdicts(receiver, [damage] * 3)
        assert receiver.state(GearboxSensors) is ChannelState.INVALID


def out_of_range(frame: Frame) -> Frame:
    """The frame with a clutch position of 655.35 %, intact otherwise."""
    data = bytearray(frame.data)
    data[13:15] = b"\xff\xff"
    data_id = CODECS["GearboxSensors"].spec.data_id
    assert data_id is not None
    write_crc(data, data_id, increment_counter=False)
    return frame._replace(data=bytes(data))


def test_values_out_of_range_are_refused_counted_and_end_validity() -> None:
    receiver = controller()
    frames = sensor_frames(13)
    verdicts(receiver, frames[:10])
    wrong = [out_of_range(frame) for frame in frames[10:]]
    assert [receiver.receive(frame) for frame in wrong] == [(FrameVerdict.FORMAT, None)] * 3
    assert receiver.format_errors == 3
    assert not receiver.valid(GearboxSensors)


def run(receiver: Receiver, frames: list[Frame], start_us: int = 0) -> int:
    """One frame and one step a cycle; the time of the last step."""
    now_us = start_us
    for now_us in range(start_us, start_us + len(frames) * CYCLE_US, CYCLE_US):
        receiver.receive(frames[(now_us - start_us) // CYCLE_US])
        receiver.tick(now_us)
    return now_us


def test_a_channel_gone_quiet_is_invalid_within_five_cycle_times() -> None:
    """The frame that the last step consumed may have arrived up to a cycle time before it."""
    receiver = controller()
    last_us = run(receiver, sensor_frames(10))
    receiver.tick(last_us + 4 * CYCLE_US - 1)
    assert receiver.valid(GearboxSensors)
    receiver.tick(last_us + 4 * CYCLE_US)
    assert not receiver.valid(GearboxSensors)


def test_a_frozen_channel_is_invalid_within_five_cycle_times() -> None:
    """The sender's data stand still, counter and CRC with them, but the frames keep coming."""
    receiver = controller()
    frames = sensor_frames(10)
    last_us = run(receiver, frames)
    run(receiver, [frames[-1]] * 4, last_us + CYCLE_US)
    assert not receiver.valid(GearboxSensors)


def test_a_quiet_channel_leaves_the_others_alone() -> None:
    receiver = controller()
    rig = Transmitter(Node.GEARBOX_IO, Node.ENGINE)
    for step in range(30):
        receiver.receive(rig.encode(EEC1(engine_speed_rad_s=100.0)))
        if step < 10:
            receiver.receive(rig.encode(EdgesLayshaftRise()))
        receiver.tick(step * CYCLE_US)
    assert receiver.valid(EEC1)
    assert not receiver.valid(EdgesLayshaftRise)


def test_invalid_channels_are_one_bit_each_in_order_of_identifier() -> None:
    receiver = controller()
    cyclic = sorted(
        (codec.spec.can_id, name)
        for name, codec in CODECS.items()
        if Node.TRANSMISSION_CONTROL in codec.spec.receivers and codec.spec.is_cyclic
    )
    assert receiver.invalid_channels == (1 << len(cyclic)) - 1
    verdicts(receiver, sensor_frames(3))
    bit = [name for _, name in cyclic].index("GearboxSensors")
    assert receiver.invalid_channels == (1 << len(cyclic)) - 1 - (1 << bit)


@pytest.mark.parametrize("message_type", [TC1, ShiftOutcome])
def test_only_received_cyclic_messages_have_a_state(message_type: type[Message]) -> None:
    with pytest.raises(KeyError):
        controller().valid(message_type)


def test_events_may_come_with_any_gap_but_not_twice() -> None:
    sender = Transmitter(Node.TRANSMISSION_CONTROL)
    outcomes = [sender.encode(ShiftOutcome(attempts=number % 256)) for number in range(200)]
    bench = Receiver(Node.BENCH)
    arriving = [outcomes[0], outcomes[0], outcomes[1], outcomes[150], outcomes[199], outcomes[199]]
    assert verdicts(bench, arriving) == [
        FrameVerdict.OK,
        FrameVerdict.REPEATED,
        FrameVerdict.OK,
        FrameVerdict.OK,
        FrameVerdict.OK,
        FrameVerdict.REPEATED,
    ]


def test_a_refused_message_does_not_use_up_a_counter() -> None:
    sender = Transmitter(Node.GEARBOX_IO)
    frames = [sender.encode(GearboxSensors())]
    with pytest.raises(EncodeError):
        sender.encode(GearboxSensors(brake_pressure_pa=-1e6))
    frames.append(sender.encode(GearboxSensors()))
    assert [frame.data[2] for frame in frames] == [0, 1]
    assert frames[1].data[3:] == frames[0].data[3:]


def test_an_event_of_a_sender_that_has_restarted_is_taken() -> None:
    """Its counter begins anew and may be that of the event before: 50 ms of silence of all that it
    sends by the clock tell the restart. While anything is heard, the same counter repeats."""
    bench, outcome = Receiver(Node.BENCH), ShiftOutcome(to_gear=10)
    for silence_us, expected in ((30_000, FrameVerdict.REPEATED), (80_000, FrameVerdict.OK)):
        before, now_us = Transmitter(Node.TRANSMISSION_CONTROL), 0
        assert bench.receive(before.encode(outcome)).verdict is FrameVerdict.OK
        for now_us in range(0, 100_000, CYCLE_US):
            bench.receive(before.encode(ValveCommand()))
            bench.tick(now_us)
        for later_us in range(now_us + CYCLE_US, now_us + silence_us, CYCLE_US):
            bench.tick(later_us)
        after = Transmitter(Node.TRANSMISSION_CONTROL)
        assert bench.receive(after.encode(outcome)).verdict is expected
        bench = Receiver(Node.BENCH)


def test_one_silent_message_of_a_sender_is_no_restart() -> None:
    bench, sender = Receiver(Node.BENCH), Transmitter(Node.TRANSMISSION_CONTROL)
    event = sender.encode(ShiftOutcome(to_gear=10))
    assert bench.receive(event).verdict is FrameVerdict.OK
    for now_us in range(0, 500_000, CYCLE_US):
        bench.receive(sender.encode(ValveCommand()))
        if now_us < 100_000:
            bench.receive(sender.encode(ClutchCommand()))
        bench.tick(now_us)
    assert bench.state(ClutchCommand) is ChannelState.INVALID
    assert bench.receive(event).verdict is FrameVerdict.REPEATED


def test_the_silence_of_one_sender_forgets_no_counter_of_another() -> None:
    bench = Receiver(Node.BENCH)
    controller_, other = Transmitter(Node.TRANSMISSION_CONTROL), Transmitter(Node.REFERENCE)
    events = [controller_.encode(ShiftOutcome(to_gear=10)), other.encode(ReferenceEngagement())]
    assert verdicts(bench, events) == [FrameVerdict.OK] * 2
    for now_us in range(0, 200_000, CYCLE_US):
        if now_us < 100_000:
            bench.receive(controller_.encode(ValveCommand()))
        bench.tick(now_us)
    assert verdicts(bench, events) == [FrameVerdict.OK, FrameVerdict.REPEATED]


def test_a_node_that_starts_anew_counts_anew_and_the_others_of_its_transmitter_go_on() -> None:
    sender = Transmitter(Node.GEARBOX_IO, Node.REFERENCE)
    for _ in range(3):
        sender.encode(GearboxSensors())
        sender.encode(ReferenceEncoder())
    sender.restart(Node.GEARBOX_IO)
    assert sender.encode(GearboxSensors()).data[2] == 0
    assert sender.encode(ReferenceEncoder()).data[2] == 3
    sender.encode(GearboxSensors())
    sender.restart(Node.REFERENCE)
    assert sender.encode(ReferenceEncoder()).data[2] == 0
    assert sender.encode(GearboxSensors()).data[2] == 2


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
        transmitter.leave_unread({ReferenceEncoder, ReferenceEngagement})
    specs = [CODECS[kind.__name__].spec for kind in (ReferenceEngagement, ReferenceEncoder)]
    empty = [Frame(spec.can_id, bytes(spec.length), spec.is_fd, True) for spec in specs]
    assert rig.unread(ReferenceEngagement, ReferenceEncoder) == empty
    assert rig.unread(ReferenceEncoder, GearboxSensors) is None
    assert rig.unread(GearboxSensors) is None
    assert controller.unread(ReferenceEncoder) is None
