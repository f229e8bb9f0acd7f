"""docs/wire.md: its numbers and test vectors are those of the code."""

import re
from pathlib import Path

from e2e import p05

from meshpoint.bus.classic.commands import OrderSender
from meshpoint.dbc.classic.codecs import CLASSIC_SCHEMA
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ValveAction, ValveCommand
from meshpoint.rig_sim.shared import valve_drivers

VECTOR = re.compile(r"`((?:[0-9A-F]{2} ){7}[0-9A-F]{2})`")
DOCUMENT = (Path(__file__).parents[2] / "docs" / "wire.md").read_text(encoding="utf-8")


def test_its_end_to_end_vectors_are_those_of_the_standards_library() -> None:
    vectors = VECTOR.findall(DOCUMENT[: DOCUMENT.index("## The classic profile")])
    made = []
    for counter in (0, 1):
        data = bytearray(8)
        data[2] = counter
        p05.e2e_p05_protect(data, 0x1234, increment_counter=False)
        made.append(data.hex(" ").upper())
    assert vectors == made


def test_its_vectors_of_the_classic_profile_are_what_is_sent() -> None:
    """Two commands in a row; and every message that it names is in that profile's DBC."""
    part = DOCUMENT[DOCUMENT.index("## The classic profile") : DOCUMENT.index("## Time")]
    sender = OrderSender()
    fire = ValveCommand(
        brake_action=ValveAction.OFF_AT, brake_time_us=0x0102_0304,
        main_second_action=ValveAction.ON_AT, main_second_time_us=0xA0B0_C0D0,
    )  # fmt: skip
    frames = [*sender.valves(ValveCommand(), None), *sender.valves(fire, None)]
    assert VECTOR.findall(part) == [frame.data.hex(" ").upper() for frame in frames]
    assert re.findall(r"`(0CFF\d{4})`", part) == [f"{frame.can_id:08X}" for frame in frames]
    table = part[part.index("| from |") : part.index("- **Edges.**")]
    named = set(re.findall(r"`([A-Z]\w+)`", table)) - {"ValveStatus"}
    assert len(named) > 15
    assert named <= {spec.name for spec in CLASSIC_SCHEMA.messages}


def test_every_message_it_names_is_in_the_contract() -> None:
    table = DOCUMENT[DOCUMENT.index("| from |") : DOCUMENT.index("The bus is CAN FD")]
    named = set(re.findall(r"`([A-Z]\w+)`", table))
    assert len(named) > 12
    assert named <= set(CODECS)


def test_its_limits_are_the_valve_drivers() -> None:
    text = re.sub(r"\s+", " ", DOCUMENT)
    assert f"more than {valve_drivers.MAX_LATE_US // 1000} ms late" in text
    assert f"more than {valve_drivers.MAX_AHEAD_US // 1000} ms ahead" in text
    assert f"empties all slots {valve_drivers.EXPIRY_US // 1000} ms after" in text
