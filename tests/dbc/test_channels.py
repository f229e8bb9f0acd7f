"""Whether a channel may be believed: wrong counters, silence, restarts of either end."""

import pytest
from link_frames import CYCLE_US, controller, sensor_frames, verdicts

from meshpoint.dbc import Frame, Node
from meshpoint.dbc.e2e import ChannelState, write_crc
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import EncodeError, FrameVerdict, Receiver, Transmitter
from meshpoint.dbc.messages import (
    EEC1,
    TC1,
    ClutchCommand,
    EdgesLayshaftRise,
    GearboxSensors,
    Message,
    ReferenceEncoder,
    ReferenceEngagement,
    ShiftOutcome,
    ValveCommand,
)


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
