"""A flood of requests, and frames that are damaged or come twice: denied, without harm."""

from __future__ import annotations

from itertools import pairwise

import pytest
from loop_bench import Alter, Loop

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ControllerState, ControllerStatus, FaultCode, ShiftResult
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset

TRUCK12 = load_sheet("truck12")
REST_US = 300_000
"""The clutch's way out and back by its sheet."""
RESTING = (ControllerState.IN_GEAR, ControllerState.CLUTCH_CLOSING)
FROM_SENSORS = {
    codec.spec.can_id
    for codec in CODECS.values()
    if codec.spec.sender.value == "GearboxIo" and codec.spec.data_id is not None
}


def truck(requests: list[tuple[int, int]], receiving: Alter = lambda frame: [frame]) -> Loop:
    return Loop(
        requests, sheet=TRUCK12, preset=Preset.TRUCK, toward=10, seed=3, receiving=receiving
    )


@pytest.mark.long
def test_a_flood_of_requests_is_heeded_after_a_rest_and_does_no_harm() -> None:
    """TC1 every 10 ms for 8 s, the gear asked for another one every 200 ms."""
    flood = [(300_000 + 10_000 * k, (8, 10)[k // 20 % 2]) for k in range(800)]
    loop = truck(flood).run(8_300_000)
    assert loop.outcomes
    assert {outcome.result for outcome in loop.outcomes} == {ShiftResult.ENGAGED}
    assert loop.violations == 0
    states = [(t, m.state) for t, m in loop.messages if isinstance(m, ControllerStatus)]
    ended_us, rests = None, []
    for (_, before), (time_us, now) in pairwise(states):
        if before not in RESTING and now in RESTING:
            ended_us = time_us
        if before in RESTING and now not in RESTING and ended_us is not None:
            rests.append(time_us - ended_us)
    assert len(rests) >= 4
    # Both ends by the arrival of a step's frames, and a step may be moved by half a millisecond.
    assert min(rests) >= REST_US - 1_000


def every(k: int, twice: bool) -> Alter:
    """Each k-th frame of the sensors comes twice, or with a bit turned."""
    seen = [0]

    def alter(frame: Frame) -> list[Frame]:
        if frame.can_id not in FROM_SENSORS:
            return [frame]
        seen[0] += 1
        if seen[0] < 500 or seen[0] % k:
            return [frame]
        if twice:
            return [frame, frame]
        return [frame._replace(data=frame.data[:-1] + bytes([frame.data[-1] ^ 1]))]

    return alter


@pytest.mark.parametrize("twice", [False, True])
@pytest.mark.parametrize(("k", "denied"), [(1, True), (2, True), (3, True), (5, False)])
def test_damaged_and_doubled_frames_deny_a_shift_and_harm_nothing(
    k: int, twice: bool, denied: bool
) -> None:
    """Up to each third one: channels are invalid and the request is refused. Each fifth: the shift
    is made."""
    loop = truck([(800_000, 10)], every(k, twice))
    loop.until(lambda: bool(loop.outcomes), 4_000_000)
    (outcome,) = loop.outcomes
    assert loop.violations == 0
    if denied:
        assert outcome.result is ShiftResult.REFUSED
        assert outcome.fault in (FaultCode.POSITION_STALE, FaultCode.SPEED_STALE)
        assert loop.valves_driven == ()
    else:
        assert outcome.result is ShiftResult.ENGAGED
