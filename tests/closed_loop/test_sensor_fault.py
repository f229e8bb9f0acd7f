"""`SensorFault` bits: a sensor that says of itself to be out of range is not believed."""

from __future__ import annotations

from functools import partial

import pytest
from loop_bench import Alter, Loop

from meshpoint.dbc.e2e import write_crc
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ControllerState, FaultCode, ShiftOutcome, ShiftResult
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset

TRUCK12 = load_sheet("truck12")
State, Code = ControllerState, FaultCode
SLEEVES_BYTE, EDGES_BYTE, EDGES_BIT = 7, 9, 0x80
EDGES = tuple(
    f"Edges{shaft}{edge}"
    for shaft in ("Input", "Layshaft", "Main", "Propeller")
    for edge in ("Rise", "Fall")
)


class Faulty:
    """Sets the bit in the frames of these messages, protected anew, while it is on."""

    def __init__(self, names: tuple[str, ...], bit: int = 1) -> None:
        self._codecs = {CODECS[name].spec.can_id: CODECS[name] for name in names}
        self._bit = bit
        self.on = False

    def __call__(self, frame: Frame) -> list[Frame]:
        codec = self._codecs.get(frame.can_id)
        if codec is None or not self.on:
            return [frame]
        data = bytearray(frame.data)
        if codec.spec.name.startswith("Edges"):
            data[EDGES_BYTE] |= EDGES_BIT
        else:
            data[SLEEVES_BYTE] |= self._bit
        data[2] = (data[2] - 1) & 0xFF  # protecting counts on by one
        assert codec.spec.data_id is not None
        write_crc(data, codec.spec.data_id)
        return [frame._replace(data=bytes(data))]


def loop_with(receiving: Alter) -> Loop:
    return Loop(
        [(300_000, 10), (2_000_000, 10)],
        sheet=TRUCK12,
        preset=Preset.TRUCK,
        toward=10,
        seed=3,
        receiving=receiving,
    )


LATER = partial(pytest.param, marks=pytest.mark.long)
"""What `make long` has: the other bit, the other wheel."""
CASES = [
    (("SleevesMain", "SleevesAux"), 1, Code.POSITION_STALE),
    LATER(("SleevesMain",), 1, Code.POSITION_STALE),
    (("SleevesMain",), 2, Code.POSITION_STALE),
    (("SleevesAux",), 1, Code.POSITION_STALE),
    LATER(("SleevesAux",), 2, Code.POSITION_STALE),
    (EDGES, 1, Code.SPEED_STALE),
    LATER(("EdgesLayshaftRise",), 1, Code.SPEED_STALE),
    (("EdgesMainRise",), 1, Code.SPEED_STALE),
]


@pytest.mark.parametrize(("names", "bit", "code"), CASES)
def test_no_shift_is_begun_on_a_sensor_out_of_range_and_one_is_when_it_is_back(
    names: tuple[str, ...], bit: int, code: FaultCode
) -> None:
    faulty = Faulty(names, bit)
    loop = loop_with(faulty)
    loop.run(200_000)
    faulty.on = True
    loop.run(1_000_000)
    assert [(o.result, o.fault) for o in loop.outcomes] == [(ShiftResult.REFUSED, code)]
    faulty.on = False
    loop.until(lambda: len(loop.outcomes) == 2, 4_000_000)
    assert loop.outcomes[-1].result is ShiftResult.ENGAGED, loop.events
    assert loop.violations == 0


@pytest.mark.parametrize("state", [State.SYNCHRONISING, State.COASTING])
@pytest.mark.parametrize(
    ("names", "code"),
    [(("SleevesMain",), Code.POSITION_STALE), (("EdgesLayshaftRise",), Code.SPEED_STALE)],
)
def test_a_shift_under_way_is_given_up(
    names: tuple[str, ...], code: FaultCode, state: ControllerState
) -> None:
    faulty = Faulty(names)
    loop = loop_with(faulty)
    loop.run_to_state(state, 2_000_000)
    faulty.on = True
    struck_us = loop.time.now_us
    assert loop.until(lambda: bool(loop.outcomes), struck_us + 100_000), loop.events
    said_us = next(t for t, message in loop.messages if isinstance(message, ShiftOutcome))
    assert said_us - struck_us <= 50_000
    assert loop.outcomes[0].fault is code
    loop.run(loop.time.now_us + 30_000)
    assert loop.valves_driven == ()
    assert loop.violations == 0


def test_falling_edges_out_of_range_are_left_out_and_the_shift_is_made() -> None:
    faulty = Faulty(("EdgesLayshaftFall", "EdgesMainFall"))
    loop = loop_with(faulty)
    loop.run(200_000)
    faulty.on = True
    loop.until(lambda: bool(loop.outcomes), 3_000_000)
    assert loop.outcomes[0].result is ShiftResult.ENGAGED, loop.events
    assert loop.violations == 0


@pytest.mark.parametrize("names", [("SleevesMain",), ("SleevesAux",), EDGES])
def test_the_guard_reads_the_bits_itself(names: tuple[str, ...]) -> None:
    """Invalid positions, unknown speeds: rows 7, 4, 6, 8 and 15 stand on them."""
    faulty = Faulty(names)
    loop = loop_with(faulty)
    views = loop.watch_guard()
    loop.run(200_000)
    assert views[-1][1].valid
    assert None not in views[-1][1].speeds
    faulty.on = True
    loop.run(loop.time.now_us + 30_000)
    assert views[-1][1].valid is (names is EDGES)
    assert views[-1][1].speeds == (None,) * 4 if names is EDGES else None not in views[-1][1].speeds
