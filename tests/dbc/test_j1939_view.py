"""The DBC by PGN: what other tools find of the standard's messages, from any source address."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import can
import canmatrix.formats
import cantools
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from meshpoint.bus.light_can import mf4_module
from meshpoint.dbc.j1939 import group_of
from meshpoint.dbc.j1939_view import J1939_DBC, main
from meshpoint.dbc.schema import SCHEMA
from meshpoint.dbc.source import DBC_PATH
from meshpoint.dbc.specs import MessageSpec
from meshpoint.dbc.truck import TRUCK_DBC, TRUCK_SCHEMA

pytestmark = pytest.mark.check
ANY_SOURCE = 0x03FFFF00
"""Of an identifier, parameter group and destination."""
STANDARD = [message for message in SCHEMA.messages if not message.is_protected]
STANDARD += TRUCK_SCHEMA.messages
PARSED = cantools.database.load_file(J1939_DBC, frame_id_mask=ANY_SOURCE)
MATRIX = canmatrix.formats.loadp_flat(str(J1939_DBC))
SPNS = {
    "EngineSpeed": 190, "RequestedTorque": 518, "CurrentGear": 523, "InputShaftSpeed": 161,
    "WheelBasedSpeed": 84, "FrontAxleSpeed": 904, "FrontLeftSpeed": 1592, "VehicleSpeed": 1624,
}  # fmt: skip
"""Some of SAE J1939-71's."""


def test_the_file_is_that_of_the_contract() -> None:
    assert main(["--check"]) == 0
    assert {message.name for message in PARSED.messages} == {each.name for each in STANDARD}


def test_every_signal_of_the_standard_has_its_spn_in_both_files() -> None:
    """The number that its comment begins with."""
    of_nodes = [
        message
        for path in (DBC_PATH, TRUCK_DBC)
        for message in cantools.database.load_file(path).messages
    ]
    names = {each.name for each in STANDARD}
    for message in (*PARSED.messages, *of_nodes):
        for signal in message.signals if message.name in names else ():
            assert f"SPN {signal.spn}" == str(signal.comment).split(",")[0]
            assert SPNS.get(signal.name, signal.spn) == signal.spn


@pytest.mark.parametrize("path", [J1939_DBC, TRUCK_DBC, DBC_PATH], ids=lambda path: path.name)
def test_canmatrix_too_takes_every_message_of_the_standard_for_one_of_j1939(path: Path) -> None:
    names = {each.name for each in STANDARD}
    found = [
        frame for frame in canmatrix.formats.loadp_flat(str(path)).frames if frame.name in names
    ]
    assert found
    assert [frame.name for frame in found if not frame.is_j1939] == []


@pytest.mark.parametrize("spec", STANDARD, ids=[spec.name for spec in STANDARD])
@given(source=st.integers(0, 253), priority=st.integers(0, 7), data=st.data())
def test_a_frame_is_found_by_its_pgn_alone(
    spec: MessageSpec, source: int, priority: int, data: st.DataObject
) -> None:
    raw = {s.name: data.draw(st.integers(s.raw_min, s.raw_max)) for s in spec.signals}
    payload = PARSED.get_message_by_name(spec.name).encode(raw, scaling=False, padding=True)
    identifier = priority << 26 | spec.can_id & ANY_SOURCE | source
    message = PARSED.get_message_by_frame_id(identifier, force_extended_id=True)
    assert message.decode(payload, scaling=False, decode_choices=False) == raw
    frame = MATRIX.frame_by_pgn(group_of(identifier))
    assert frame is not None
    assert {name: int(of.raw_value) for name, of in frame.decode(payload).items()} == raw


def test_a_recorded_bus_is_decoded_by_a_reader_of_mdf(tmp_path: Path) -> None:
    """Engine speeds from three source addresses, written as an MF4 bus log by python-can."""
    message = PARSED.get_message_by_name("EEC1")
    fields: dict[str, Any] = {signal.name: 0 for signal in message.signals}
    speeds = [600.0 + 12.5 * k for k in range(60)]
    path = tmp_path / "bus.mf4"
    with mf4_module().MF4Writer(path) as writer:
        for k, speed in enumerate(speeds):
            writer.on_message_received(
                can.Message(
                    timestamp=1e9 + 0.01 * k,
                    arbitration_id=0x0CF00400 + k % 3,
                    data=message.encode(fields | {"EngineSpeed": speed}),
                    channel=1,
                )
            )
    from asammdf import MDF  # with pandas a second: not where tests are collected

    read = MDF(path).extract_bus_logging({"CAN": [(str(J1939_DBC), 0)]})
    found = [
        group for group in range(len(read.groups))
        if any(channel.name.endswith("EngineSpeed") for channel in read.groups[group].channels)
    ]  # fmt: skip
    samples = [read.get("EngineSpeed", group=group) for group in found]
    times = np.concatenate([each.timestamps for each in samples])
    values = np.concatenate([each.samples for each in samples])[np.argsort(times)]
    assert values.tolist() == speeds
    assert all(later > earlier for earlier, later in pairwise(np.sort(times)))
