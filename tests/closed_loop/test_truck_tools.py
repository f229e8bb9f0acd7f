"""Truck tools on our bus: requests from any address, engine requests with counter and checksum."""

from __future__ import annotations

from pathlib import Path

import pytest
from loop_bench import Loop

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import COUNTER_MODULUS, REQUEST_ID, is_intact
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ShiftOutcome, ShiftResult
from meshpoint.replays.replay import LogReplay
from meshpoint.replays.session import Verification

TSC1_ID = CODECS["TSC1"].spec.can_id


class Tool:
    """Turns the operator's requests into those of another tool, before they reach the bus."""

    def __init__(self, core, can_id: int) -> None:
        self._core, self._can_id = core, can_id

    def __getattr__(self, name: str):
        return getattr(self._core, name)

    def step(self, now_us: int):
        step = self._core.step(now_us)
        frames = [f._replace(can_id=self._can_id) for f in step.frames]
        return step._replace(frames=frames)


def asked_by(can_id: int) -> Loop:
    loop = Loop([(300_000, 10)], toward=10)
    loop.nodes[2] = Tool(loop.operator, can_id)
    return loop.run(1_500_000)


@pytest.mark.parametrize("can_id", [0x0C010321, 0x0C01FF05])
def test_a_tool_of_any_address_gets_its_gear_and_the_log_is_verified(
    can_id: int, tmp_path: Path
) -> None:
    loop = asked_by(can_id)
    (outcome,) = loop.of(ShiftOutcome)
    assert (outcome.to_gear, outcome.result) == (10, ShiftResult.ENGAGED)
    assert can_id in {f.can_id for _, f in loop.frames}
    assert REQUEST_ID not in {f.can_id for _, f in loop.frames}
    loop.header.save(tmp_path)
    (session,) = LogReplay(tmp_path, verify=True).run([f for _, f in loop.frames])
    assert session.verdict is Verification.IDENTICAL, str(session)


def test_a_request_to_another_node_is_none_of_ours() -> None:
    assert asked_by(0x0C010521).of(ShiftOutcome) == []


def test_each_engine_request_counts_on_and_its_checksum_is_right() -> None:
    loop = Loop(shifts=1, pairs=((10, 8),), start_gear=10)
    loop.run(4_000_000)
    sent = [f for _, f in loop.frames if f.can_id == TSC1_ID]
    assert len(sent) > 20
    assert all(map(is_intact, sent))
    counters = [f.data[7] & 0x0F for f in sent]
    assert counters == [k % COUNTER_MODULUS for k in range(len(sent))]
    assert {f.data[7] >> 4 for f in sent} <= set(range(8))


def test_an_engine_request_with_a_wrong_checksum_moves_no_engine() -> None:
    def garbled(frame: Frame) -> list[Frame]:
        if frame.can_id != TSC1_ID:
            return [frame]
        return [frame._replace(data=frame.data[:7] + bytes([frame.data[7] ^ 0x10]))]

    loop = Loop(shifts=1, pairs=((10, 8),), start_gear=10)
    loop.rig.receiving = garbled
    loop.run(8_000_000)
    results = [o.result for o in loop.of(ShiftOutcome)]
    assert ShiftResult.ENGAGED not in results
    assert any("wrong CRC or counter" in line for line in loop.events)
