"""The classic profile: what is packed comes out again, and what is lost or damaged is known."""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.bus.classic.commands import OrderIntake, OrderSender, orders_say
from meshpoint.bus.classic.edges import (
    A_FRAME,
    INDEX_WRAP,
    LOW,
    STAMPS,
    WRAP,
    EdgeArray,
    EdgeReport,
    EdgeSender,
    SpeedWheel,
)
from meshpoint.bus.classic.parts import PartsIntake, PartsSender
from meshpoint.bus.classic.sensors import (
    SensorIntake,
    SensorSender,
    between,
    coarser,
    edges_per_us,
)
from meshpoint.bus.classic.traffic import LIMIT, classic_traffic, worst_load
from meshpoint.dbc.classic.codecs import CLASSIC_CODECS
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import FrameVerdict, Receiver
from meshpoint.dbc.messages import (
    EEC1,
    ClutchAction,
    ClutchCommand,
    ControllerState,
    ControllerStatus,
    EdgesInputRise,
    EdgesLayshaftRise,
    EdgesMainRise,
    EdgesPropellerRise,
    GearboxSensors,
    ShiftOutcome,
    SleevesAux,
    SleevesMain,
    ValveAction,
    ValveCommand,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.units import RPM

SHEET = load_sheet("truck12")
EDGE_TYPE = CLASSIC_CODECS["EdgesLayshaft"].message_type
READ_US = 10_000


def report_at(now_us: int, edges_us: Sequence[int], start_us: int, start_index: int) -> EdgeReport:
    """What a wheel with these edges says at a read; all times since the first one of the run."""
    past = bisect.bisect_right(edges_us, now_us)
    newest = list(reversed(edges_us[max(0, past - STAMPS) : past]))
    lows = [(start_us + edge) & LOW for edge in newest]
    return EdgeReport(
        (start_us + now_us) % WRAP, (start_index + past) % INDEX_WRAP, len(lows), False, False,
        False, (*lows, *(0,) * (STAMPS - len(lows))),
    )  # fmt: skip


intervals = st.lists(st.integers(250, 30_000), min_size=3, max_size=60)
starts = st.sampled_from([0, WRAP - 1, WRAP - 70_000, 123_456_789])
indices = st.sampled_from([0, 65_530, 255, 40_000])


def times_of(spans_us: list[int]) -> list[int]:
    """Edges with these intervals, the first at its interval."""
    return [sum(spans_us[: k + 1]) for k in range(len(spans_us))]


@settings(max_examples=40)
@given(intervals, starts, indices)
def test_every_edge_arrives_with_its_number(
    spans_us: list[int], start_us: int, start_index: int
) -> None:
    """Also where the sensor clock and the running number wrap. Two edges may wait for a read."""
    edges = times_of(spans_us)
    sender, array = EdgeSender(EDGE_TYPE), EdgeArray()
    for now_us in range(READ_US, edges[-1] + 2 * READ_US, READ_US):
        said = report_at(now_us, edges, start_us, start_index)
        for message in list(sender.cut(said)):
            array.take(message, 1, said.read_time_us, sender.index % 256)
        if not said.valid_stamps >= A_FRAME:
            continue
        assert array.is_up_to(sender.index % 256)
        waiting = (said.newest_index - sender.index) % INDEX_WRAP
        heard = array.report(said.read_time_us, said.stopped, said.sensor_fault)
        assert waiting <= 2
        assert heard.newest_index % 256 == sender.index % 256
        held = heard.valid_stamps
        wanted = said.timestamp_low_us[waiting : min(waiting + held, said.valid_stamps)]
        assert heard.timestamp_low_us[: len(wanted)] == wanted
    assert array.filled == 0


@settings(max_examples=40)
@given(st.data(), st.integers(500, 4_000), starts)
def test_a_lost_frame_costs_no_number(data: st.DataObject, span_us: int, start_us: int) -> None:
    """Its three edges are put between their neighbours, off by no more than the speed has
    changed; the edges behind it have their own numbers and times."""
    edges = [span_us * (k + 1) for k in range(60)]
    sender, array = EdgeSender(EDGE_TYPE), EdgeArray()
    frames: list[tuple[Any, int, int]] = []
    for now_us in range(READ_US, edges[-1], READ_US):
        said = report_at(now_us, edges, start_us, 7)
        made = list(sender.cut(said))
        frames += [(message, said.read_time_us, sender.index % 256) for message in made]
    lost = data.draw(st.integers(1, len(frames) - 2))
    steps = 1
    for number, (message, read_us, target) in enumerate(frames):
        if number == lost:
            steps = 2
            continue
        array.take(message, steps, read_us, target)
        steps = 1
    heard = array.report(frames[-1][1], stopped=False, fault=False)
    assert array.filled <= A_FRAME
    assert heard.newest_index % 256 == sender.index % 256
    count = (sender.index - 7) % INDEX_WRAP
    newest_first = [(start_us + edge) & LOW for edge in reversed(edges[:count])]
    held = heard.valid_stamps
    off_us = [
        (a - b + 40) & LOW
        for a, b in zip(heard.timestamp_low_us[:held], newest_first[:held], strict=True)
    ]
    assert all(abs(off - 40) <= 2 for off in off_us)


def test_too_many_lost_frames_start_the_array_anew() -> None:
    """Nobody knows when those edges came: fewer stamps hold, and none of them is made up."""
    edges = [1_000 * (k + 1) for k in range(60)]
    sender, array = EdgeSender(EDGE_TYPE), EdgeArray()
    said = report_at(20_000, edges, 0, 0)
    for message in list(sender.cut(said)):
        array.take(message, 1, said.read_time_us, sender.index % 256)
    said = report_at(30_000, edges, 0, 0)
    *_, last = sender.cut(said)
    array.take(last, 3, said.read_time_us, sender.index % 256)
    heard = array.report(30_000, stopped=False, fault=False)
    assert (heard.valid_stamps, array.filled) == (3, 0)
    assert heard.newest_index == sender.index
    assert heard.timestamp_low_us[:3] == (30_000, 29_000, 28_000)


@settings(max_examples=40)
@given(st.floats(0.0, 2_500.0), starts)
def test_a_speed_comes_out_of_its_wheel_again(rpm: float, start_us: int) -> None:
    """Within a part in a thousand; none where the edges are too far apart for their stamps."""
    wheel, rate = SpeedWheel(), rpm / 60.0 * 40 / 1e6
    for read in range(30):
        said = wheel.report((start_us + read * READ_US) % WRAP, rate)
    found = edges_per_us(said)
    if rate * LOW < 1.01:
        assert found in (None, 0.0)
    else:
        assert found == pytest.approx(rate, rel=1e-3)


def read_messages(number: int, rpm: float = 1_000.0, **changes: Any) -> dict[str, Any]:
    """Read `number` (from 1) of a gearbox whose shafts all turn at this speed."""
    now_us, found = number * READ_US, {}
    kinds: tuple[Any, ...] = (
        EdgesInputRise, EdgesLayshaftRise, EdgesMainRise, EdgesPropellerRise,
    )  # fmt: skip
    wheels = SHEET.wheels
    for kind, wheel in zip(
        kinds, (wheels.input_, wheels.layshaft, wheels.main, wheels.propeller), strict=True
    ):
        span_us = 60e6 / rpm / wheel.teeth
        edges = [round(span_us * (k + 1)) for k in range(int(now_us / span_us))]
        found[kind.__name__] = kind(*report_at(now_us, edges, 0, 0))
    time = {"sample_time_us": now_us}
    found["GearboxSensors"] = GearboxSensors(
        **time, brake_pressure_pa=3.2e5, supply_pressure_pa=9.5e5, oil_temperature_k=350.0,
        clutch_position_fraction=0.25,
    )  # fmt: skip
    found["SleevesMain"] = SleevesMain(
        **time, sleeve_first_second_m=tuple(0.012 - 0.0004 * k for k in range(10)),
        sleeve_crawl_third_m=(-0.001,) * 10,
    )  # fmt: skip
    found["SleevesAux"] = SleevesAux(
        **time, sleeve_splitter_m=(0.01,) * 10, sleeve_range_m=(-0.01,) * 10
    )
    found["ValveStatus"] = ValveStatus(
        **time, brake_energised=True, range_high_pending=True, refused_count=17
    )
    found["EEC1"] = EEC1(engine_speed_rad_s=100.0)
    return found | changes


def heard_of(frames: Sequence[Frame], intake: SensorIntake, receiver: Receiver) -> list[Any]:
    """Verdicts and messages that the controller's receiver comes to."""
    out = []
    for frame in frames:
        inner = intake.take(frame) if frame.can_id in intake.ids else [frame]
        out += [receiver.receive(f) for f in inner]
    return out


def test_a_read_comes_out_as_it_went_in() -> None:
    """Within the steps of the smaller fields, dated by the read's own time."""
    sender, intake = SensorSender(SHEET), SensorIntake(SHEET)
    receiver = Receiver(Node.TRANSMISSION_CONTROL)
    newest: dict[type, Any] = {}
    for number in range(1, 41):
        wanted = read_messages(number)
        for verdict, message in heard_of(sender.pack(wanted), intake, receiver):
            assert verdict is FrameVerdict.OK
            newest[type(message)] = message
    sensors, main = newest[GearboxSensors], newest[SleevesMain]
    assert sensors.sample_time_us == main.sample_time_us == 400_000
    assert sensors.brake_pressure_pa == pytest.approx(3.2e5, abs=160.1)
    assert sensors.supply_pressure_pa == pytest.approx(9.5e5, abs=10.1)
    assert sensors.clutch_position_fraction == pytest.approx(0.25, abs=5.1e-4)
    status = newest[ValveStatus]
    assert (status.brake_energised, status.split_low_energised, status.range_high_pending) == (
        True, False, True,
    )  # fmt: skip
    assert status.refused_count == 17 % 16
    moving = main.sleeve_first_second_m
    wanted_m = [0.012 - 0.0004 * k for k in range(6)]
    assert moving[:6] == pytest.approx(wanted_m, abs=6e-6)
    assert newest[SleevesAux].sleeve_range_m == pytest.approx((-0.01,) * 10, abs=6e-6)
    for kind, wheel in (
        (EdgesInputRise, SHEET.wheels.input_), (EdgesLayshaftRise, SHEET.wheels.layshaft),
        (EdgesMainRise, SHEET.wheels.main), (EdgesPropellerRise, SHEET.wheels.propeller),
    ):  # fmt: skip
        rate = edges_per_us(EdgeReport._make(newest[kind]))
        assert rate is not None
        assert rate * 60e6 / wheel.teeth == pytest.approx(1_000.0, rel=2e-3)
        assert newest[kind].read_time_us == 400_000


@settings(max_examples=30)
@given(st.integers(0, 200), st.integers(1, 255))
def test_a_damaged_frame_reaches_the_core_as_a_damaged_one(at: int, change: int) -> None:
    """Whatever byte of whatever frame: no message comes of it, and the core counts an error."""
    sender, intake = SensorSender(SHEET), SensorIntake(SHEET)
    receiver = Receiver(Node.TRANSMISSION_CONTROL)
    frames = [frame for number in range(1, 13) for frame in sender.pack(read_messages(number))]
    own = [frame for frame in frames if frame.can_id in intake.ids and frame.can_id >> 16 != 0x0CF0]
    before, bad = own[: at % len(own)], own[at % len(own)]
    heard_of(before, intake, receiver)
    data = bytearray(bad.data)
    data[at % 8] ^= change
    found = heard_of([bad._replace(data=bytes(data))], intake, receiver)
    slow = CLASSIC_CODECS["SlowSensors"].spec.can_id
    if bad.can_id != slow:  # of which a core has no frame of its own
        assert FrameVerdict.E2E in {verdict for verdict, _ in found}
    assert receiver.e2e_errors == sum(verdict is FrameVerdict.E2E for verdict, _ in found)


def test_a_lost_read_dates_nothing_wrong() -> None:
    """Where SensorRead is lost, what belongs to it is not taken for the read before; the next
    read goes on, and one that came after several losses is out of sequence."""
    sender, intake = SensorSender(SHEET), SensorIntake(SHEET)
    receiver = Receiver(Node.TRANSMISSION_CONTROL)
    read_id = CLASSIC_CODECS["SensorRead"].spec.can_id
    for number in range(1, 12):
        heard_of(sender.pack(read_messages(number)), intake, receiver)
    rest = [f for f in sender.pack(read_messages(12)) if f.can_id != read_id]
    assert not [
        m
        for _, m in heard_of(rest, intake, receiver)
        if isinstance(m, (GearboxSensors, SleevesMain))
    ]
    found = heard_of(sender.pack(read_messages(13)), intake, receiver)
    assert {verdict for verdict, _ in found} == {FrameVerdict.OK}
    assert {m.sample_time_us for _, m in found if isinstance(m, GearboxSensors)} == {130_000}
    for number in range(14, 19):
        sender.pack(read_messages(number))
    found = heard_of(sender.pack(read_messages(19)), intake, receiver)
    assert FrameVerdict.WRONG_SEQUENCE in {verdict for verdict, _ in found}


def test_a_repeated_frame_is_reported_as_one() -> None:
    sender, intake = SensorSender(SHEET), SensorIntake(SHEET)
    receiver = Receiver(Node.TRANSMISSION_CONTROL)
    for number in range(1, 12):
        frames = sender.pack(read_messages(number))
        heard_of(frames, intake, receiver)
    state_id = CLASSIC_CODECS["GearboxState"].spec.can_id
    again = [frame for frame in frames if frame.can_id == state_id]
    verdicts = [verdict for verdict, _ in heard_of(again, intake, receiver)]
    assert verdicts == [FrameVerdict.REPEATED] * 2  # sensors and valves


def test_speeds_that_stop_coming_are_none() -> None:
    """Nothing is said of input and propeller shaft once their speeds have not been heard for three
    cycles; nothing is made up from the last one."""
    sender, intake = SensorSender(SHEET), SensorIntake(SHEET)
    receiver = Receiver(Node.TRANSMISSION_CONTROL)
    speeds_id = CLASSIC_CODECS["ETC1"].spec.can_id
    last_us = 0
    for number in range(1, 60):
        frames = sender.pack(read_messages(number))
        if number > 20:
            frames = [frame for frame in frames if frame.can_id != speeds_id]
        for _, message in heard_of(frames, intake, receiver):
            if isinstance(message, EdgesInputRise):
                last_us = message.read_time_us
    assert 300_000 <= last_us <= 360_000


def test_positions_between_samples_lie_on_lines() -> None:
    assert between(5.0, 0.0, -5.0, 10) == (5.0, 4.0, 3.0, 2.0, 1.0, 0.0, -1.0, -2.0, -3.0, -4.0)
    assert between(5.0, 0.0, None, 10)[5:] == (0.0,) * 5


actions = st.lists(st.sampled_from(ValveAction), min_size=9, max_size=9)
stamps = st.lists(st.integers(0, WRAP - 1), min_size=9, max_size=9)


@settings(max_examples=60)
@given(actions, stamps, st.sampled_from([None, *ClutchAction]))
def test_a_command_comes_out_as_it_went_in(
    wanted: list[ValveAction], times_us: list[int], clutch: ClutchAction | None
) -> None:
    """Actions all, times where they are read; and the packed bytes say the same."""
    command = ValveCommand(*wanted, *times_us)
    order = None if clutch is None else ClutchCommand(action=clutch)
    sender, intake, receiver = OrderSender(), OrderIntake(), Receiver(Node.GEARBOX_IO)
    frames = sender.valves(command, order)
    assert orders_say(frames, command, order)
    found = [receiver.receive(f).message for frame in frames for f in intake.take(frame)]
    timed = {ValveAction.ON_AT, ValveAction.OFF_AT}
    expected = [t if a in timed else 0 for a, t in zip(wanted, times_us, strict=True)]
    assert found == [ValveCommand(*wanted, *expected), *([order] if order else [])]


@settings(max_examples=60)
@given(actions, stamps, st.integers(0, 51), st.integers(0, 8))
def test_orders_that_were_changed_do_not_read_back(
    wanted: list[ValveAction], times_us: list[int], bit: int, which: int
) -> None:
    """One bit of content anywhere in the packed frames, but for what nobody reads: the time of
    orders without an activation, and the last bits of a ValveTime."""
    command = ValveCommand(*wanted, *times_us)
    frames = OrderSender().valves(command, None)
    number = which % len(frames)
    value = int.from_bytes(frames[number].data, "little") ^ 1 << 12 + bit
    frames[number] = frames[number]._replace(data=value.to_bytes(8, "little"))
    timeless = len(frames) == 1 and not any(a >= ValveAction.OFF_AT for a in wanted)
    unread = (timeless and bit >= 20) or (number < len(frames) - 1 and bit >= 40)
    try:
        says = orders_say(frames, command, None)
    except (ValueError, IndexError):
        says = False
    assert says is unread


def test_orders_without_their_times_are_not_obeyed() -> None:
    """Nor with those of the orders before: the whole command counts as lost."""
    fire = ValveCommand(
        brake_action=ValveAction.OFF_AT, brake_time_us=1_000,
        main_first_action=ValveAction.ON_AT, main_first_time_us=2_000,
    )  # fmt: skip
    later = fire._replace(main_first_time_us=9_000)
    sender, intake, receiver = OrderSender(), OrderIntake(), Receiver(Node.GEARBOX_IO)
    for frame in sender.valves(fire, None):
        for inner in intake.take(frame):
            assert receiver.receive(inner).message == fire
    *_, orders = sender.valves(later, None)
    assert intake.take(orders) == []
    assert intake.incomplete == 1
    heard = [
        receiver.receive(inner)
        for frame in sender.valves(later, None)
        for inner in intake.take(frame)
    ]
    assert [(h.verdict, h.message) for h in heard] == [(FrameVerdict.OK, later)]


def test_a_message_in_parts_is_whole_or_none() -> None:
    """With any part lost it is not put together, also not with the part of another one."""
    sender, intake = PartsSender("ShiftOutcome"), PartsIntake("ShiftOutcome")
    receiver = Receiver(Node.BENCH)
    first = ShiftOutcome(from_gear=8, to_gear=10, end_time_us=77, predicted_phase_rad=0.01)
    second = first._replace(to_gear=12)
    frames = sender.frames(first)
    found = [inner for frame in frames for inner in intake.take(frame)]
    assert len(found) == 1
    heard = receiver.receive(found[0]).message
    assert isinstance(heard, ShiftOutcome)
    assert (heard.from_gear, heard.to_gear, heard.end_time_us) == (8, 10, 77)
    assert heard.predicted_phase_rad == pytest.approx(0.01, abs=1e-6)
    for lost in range(len(frames)):
        broken = sender.frames(second)
        kept = [frame for number, frame in enumerate(broken) if number != lost]
        assert [inner for frame in kept for inner in intake.take(frame)] == []
    for _ in range(15 - len(frames)):  # its counter comes round to that of the first message
        sender.frames(second)
    head, *_ = sender.frames(second)
    assert intake.take(head) == []
    assert intake.take(frames[1]) == []


def test_the_status_keeps_what_it_has_room_for() -> None:
    sender, intake = PartsSender("ControllerStatus"), PartsIntake("ControllerStatus")
    status = ControllerStatus(
        step_number=7, step_time_us=1 << 51, state=ControllerState.ENGAGING, current_gear=-1,
        target_gear=10, run_hash_low=0xDEAD_BEEF, run_hash_high=0x1234_5678, consumed_crc=99,
    )  # fmt: skip
    found = [inner for frame in sender.frames(status) for inner in intake.take(frame)]
    heard = Receiver(Node.BENCH).receive(found[0]).message
    assert heard == status._replace(consumed_crc=0)


def test_the_bus_is_not_full_at_the_highest_speeds() -> None:
    """Every frame at its longest, with what bench and reference say; edges as many as there are
    at the sheet's highest speed."""
    assert worst_load(SHEET, bench=False) < worst_load(SHEET) <= LIMIT
    rate = sum(1e9 / m.period_ns for m in classic_traffic(SHEET) if m.name.startswith("Edges"))
    layshaft = SHEET.limits.input_max_rad_s / RPM * 35 / 37 * 43 / 60
    main = SHEET.limits.input_max_rad_s / RPM * 45 / 60
    assert rate == pytest.approx((layshaft + main) / 3, rel=1e-3)
    assert math.isclose(SHEET.limits.input_max_rad_s / RPM, 2400.0)


def test_what_is_finer_inside_is_rounded_halves_up() -> None:
    """A position of each whole micrometre, in steps of 10 um."""
    for um in range(-20_000, 20_001):
        assert round(coarser(um * 1e-6, 1e-6, 10) / 1e-5) == (um + 5) // 10
