"""Shifts on a bus where things go wrong: counted, survived, and never unsafe."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from loop_bench import Alter, Loop

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import (
    ControllerState,
    ControllerStatus,
    FaultCode,
    ShiftResult,
    SleevesAux,
    ValveStatus,
)
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset

State = ControllerState
PROTECTED = {codec.spec.can_id for codec in CODECS.values() if codec.spec.data_id is not None}
TO_CONTROLLER = {
    codec.spec.can_id
    for codec in CODECS.values()
    if any(node.value == "TransmissionControl" for node in codec.spec.receivers)
}
REQUEST = [(300_000, 10)]
END_US = 1_600_000
EXPIRY_US = 100_000


def every(
    k: int, then: Callable[[Frame], list[Frame]], begin: int = 200
) -> tuple[Alter, list[int]]:
    """Changes every k-th protected frame to the controller after the first few; and a count."""
    seen, changed = [0], [0]

    def alter(frame: Frame) -> list[Frame]:
        if frame.can_id not in PROTECTED & TO_CONTROLLER:
            return [frame]
        seen[0] += 1
        if seen[0] < begin or seen[0] % k:
            return [frame]
        changed[0] += 1
        return then(frame)

    return alter, changed


def assert_shifted(loop: Loop) -> None:
    assert [outcome.result for outcome in loop.outcomes] == [ShiftResult.ENGAGED], loop.events
    assert loop.status.current_gear == 10
    assert loop.violations == 0


@pytest.mark.parametrize("k", [7, *(pytest.param(k, marks=pytest.mark.long) for k in (23, 50))])
def test_lost_frames_lose_no_shift(k: int) -> None:
    """Every k-th frame to the controller: another message each time, edges among them. No tooth
    is lost, and the counters say it was loss, not corruption."""
    alter, dropped = every(k, lambda frame: [])
    loop = Loop(REQUEST, receiving=alter).run(END_US)
    assert dropped[0] > 20
    assert_shifted(loop)
    assert loop.status.e2e_errors == 0
    assert not any("tooth numbers lost" in line for line in loop.events)


@pytest.mark.parametrize("k", [11, 37])
def test_corrupted_frames_are_counted_one_by_one_and_change_nothing(k: int) -> None:
    """One to three bits flipped anywhere: the CRC of profile 5 sees every one of them."""
    chance = random.Random(k)

    def flip(frame: Frame) -> list[Frame]:
        data = bytearray(frame.data)
        for bit in chance.sample(range(8 * len(data)), chance.randint(1, 3)):
            data[bit // 8] ^= 1 << bit % 8
        return [frame._replace(data=bytes(data))]

    alter, flipped = every(k, flip)
    loop = Loop(REQUEST, receiving=alter).run(END_US)
    assert flipped[0] > 30
    assert_shifted(loop)
    assert abs(loop.status.e2e_errors - flipped[0]) <= 1  # the last may wait for the next step
    assert loop.status.format_errors == 0


def test_frames_of_a_wrong_length_are_counted_and_change_nothing() -> None:
    """Cut, grown, empty, or sent as classic frames."""
    chance = random.Random(5)

    def distort(frame: Frame) -> list[Frame]:
        return [
            chance.choice(
                [
                    frame._replace(data=frame.data[:-1]),
                    frame._replace(data=frame.data + b"\0"),
                    frame._replace(data=b""),
                    frame._replace(is_fd=False),
                ]
            )
        ]

    alter, distorted = every(17, distort)
    loop = Loop(REQUEST, receiving=alter).run(END_US)
    assert_shifted(loop)
    assert abs(loop.status.format_errors - distorted[0]) <= 1


def test_frames_of_others_are_counted_and_change_nothing() -> None:
    """Foreign extended identifiers, standard ones that look like ours, any length."""
    chance = random.Random(7)
    ours = {codec.spec.can_id for codec in CODECS.values()}

    def add(frame: Frame) -> list[Frame]:
        foreign = Frame(0x18FE_F100, chance.randbytes(8), is_fd=False)
        standard = Frame(0x123, chance.randbytes(chance.randint(0, 8)), False, is_extended=False)
        assert foreign.can_id not in ours
        return [frame, foreign, standard]

    alter, added = every(9, add)
    loop = Loop(REQUEST, receiving=alter).run(END_US)
    assert_shifted(loop)
    assert abs(loop.status.foreign_frames - 2 * added[0]) <= 2
    assert (loop.status.e2e_errors, loop.status.format_errors) == (0, 0)


def test_frames_twice_or_out_of_order_never_make_a_wrong_tooth() -> None:
    """A gateway that repeats: the second copy has the counter of the first and is refused."""
    alter, repeated = every(5, lambda frame: [frame, frame])
    loop = Loop(REQUEST, receiving=alter).run(END_US)
    assert_shifted(loop)
    assert abs(loop.status.e2e_errors - repeated[0]) <= 5  # the last wait for the next step
    assert not any("tooth numbers lost" in line for line in loop.events)


@pytest.mark.parametrize("state", [State.DISENGAGING, State.SYNCHRONISING, State.ENGAGING])
def test_a_controller_cut_off_in_mid_shift_leaves_no_valve_driven(state: State) -> None:
    """The valve side forgets commands 100 ms after the last one."""
    loop = Loop(REQUEST)
    loop.run_to_state(state, END_US)
    assert loop.until(lambda: loop.valves_driven != (), END_US), loop.events
    last_us = loop.time.now_us
    loop.controller.silent = True
    loop.run(last_us + EXPIRY_US + 25_000)
    assert loop.valves_driven == ()
    assert loop.last(ValveStatus).expired_count == 1
    assert loop.violations == 0


@pytest.mark.parametrize(
    "from_gear, to_gear, changing",
    [
        (8, 9, State.STEPS_CHANGING),
        pytest.param(9, 8, State.STEPS_CHANGING, marks=pytest.mark.long),
        pytest.param(10, 9, State.SPLITTER_CHANGING, marks=pytest.mark.long),
    ],
)
def test_a_range_or_splitter_left_between_its_steps_is_brought_in_by_the_next_shift(
    from_gear: int, to_gear: int, changing: State
) -> None:
    """The valve side loses a change that is under way, and hears nothing for 1.5 s: the shift is
    given up, its sleeve stands at the cones. In neutral, the layshaft has come to rest behind an
    open splitter: one request turns it again, the next has its gear."""
    loop = Loop(
        [(300_000, to_gear), (4_000_000, to_gear), (7_000_000, to_gear)],
        preset=Preset.TRUCK,
        sheet=load_sheet("truck12"),
        start_gear=from_gear,
        toward=to_gear,
        as_built={"synchro.range_nm": 10.0, "synchro.splitter_nm": 40.0},
    )
    loop.run_to_state(changing, END_US)
    assert loop.until(lambda: loop.valves_driven != (), END_US), loop.events
    loop.run(loop.time.now_us + 30_000)
    loop.lose_valves()
    loop.controller.silent = True
    loop.run(loop.time.now_us + 1_500_000)
    loop.controller.silent = False
    aux = loop.last(SleevesAux)
    at_cones_m = loop.sheet.sleeve.to_contact_m + 0.5e-3
    assert min(abs(aux.sleeve_splitter_m[0]), abs(aux.sleeve_range_m[0])) < at_cones_m
    loop.run(9_500_000)
    assert loop.outcomes[-1].result is ShiftResult.ENGAGED, loop.events
    assert loop.status.current_gear == to_gear
    assert loop.violations == 0


@pytest.mark.parametrize("state", [State.SYNCHRONISING, State.COASTING])
def test_without_sensors_the_shift_ends_with_the_valves_off(state: State) -> None:
    """The controller goes on deaf: it takes its commands back by itself."""
    loop = Loop(REQUEST)
    loop.run_to_state(state, END_US)
    loop.controller.receiving = lambda frame: []
    loop.run(loop.time.now_us + 400_000)
    assert loop.valves_driven == ()
    assert loop.violations == 0
    assert [outcome.result for outcome in loop.outcomes] != [ShiftResult.ENGAGED]
    assert loop.outcomes[0].fault is FaultCode.SPEED_STALE
    assert loop.status.invalid_channels != 0


@pytest.mark.parametrize(
    "clock_start_us", [pytest.param(None, marks=pytest.mark.long), 0, 4_000_000_000]
)
def test_a_rig_that_restarts_is_found_again_without_its_references(
    clock_start_us: int | None,
) -> None:
    """Another power-up, other angles, another clock: nothing learned before holds any more; a
    shift can be made again. The clock from zero is only 0.3 s behind the old one, and the edges go
    on nearly as before: the sensor's arrays, empty again, tell."""
    for seed in range(1, 30):  # the flank of one first shift in four or so can be determined
        loop = Loop([(300_000, 10), (2_600_000, 10)], seed=seed).run(1_500_000)
        if loop.status.reference_known:
            break
    assert loop.status.reference_known == 0b100
    loop.rig.core = loop.new_rig(99, clock_start_us)
    loop.run(2_500_000)
    status = loop.status
    assert status.reference_known == 0
    assert (status.state, status.current_gear) == (State.IN_GEAR, 8)
    assert status.invalid_channels == 0
    assert any("tooth numbers lost" in line for line in loop.events)
    loop.run(4_000_000)
    assert [outcome.result for outcome in loop.outcomes] == [ShiftResult.ENGAGED] * 2, loop.events
    assert loop.violations == 0


@pytest.mark.parametrize(
    ("state", "gear"), [(State.SYNCHRONISING, 8), (State.COASTING, 8), (State.ENGAGING, 10)]
)
def test_a_rig_that_restarts_in_mid_shift_ends_the_shift_and_is_found_again(
    state: State, gear: int
) -> None:
    """It starts in gear 8. While the main box is to stay in neutral that ends the shift; a sleeve
    that is on its way back to neutral after its firing is brought there out of any gear, and fired
    again."""
    loop = Loop(REQUEST)
    loop.run_to_state(state, END_US)
    loop.rig.core = loop.new_rig(99)
    loop.run(loop.time.now_us + 4_000_000)
    assert len(loop.outcomes) == 1
    assert loop.status.state is State.IN_GEAR, loop.events
    assert loop.status.current_gear == gear
    assert loop.valves_driven == ()
    assert loop.violations == 0


def test_garbage_in_every_field_never_stops_the_controller() -> None:
    """Random bytes under our identifiers, one for three good frames: it steps on every 10 ms. Its
    channels are no longer VALID with that many errors, so it may give the shift up; safely."""
    chance = random.Random(3)
    ids = sorted(TO_CONTROLLER)

    def add(frame: Frame) -> list[Frame]:
        garbage = Frame(chance.choice(ids), chance.randbytes(chance.randint(0, 64)))
        return [garbage, frame]

    alter, added = every(3, add)
    loop = Loop(REQUEST, receiving=alter).run(END_US)
    steps = [status.step_number for status in loop.of(ControllerStatus)]
    assert steps == list(range(len(steps)))
    assert len(steps) > 150
    refused = loop.status.e2e_errors + loop.status.format_errors
    assert added[0] - 20 <= refused <= added[0]
    assert len(loop.outcomes) == 1
    assert loop.valves_driven == ()
    assert loop.violations == 0
