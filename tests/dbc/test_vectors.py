"""docs/reference/vectors.md: other tools read the frames as the page says."""

from __future__ import annotations

import pytest
from e2e import p05
from read_dbc import database

from meshpoint.cli.vectors import encoded
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.source import DBC_PATH

VECTORS = encoded()
DATABASE = database(DBC_PATH)


@pytest.mark.parametrize(("name", "words", "frame"), VECTORS)
def test_the_standards_library_finds_its_protection_right(
    name: str, words: str, frame: Frame
) -> None:
    data_id = CODECS[name].spec.data_id
    if data_id is None:
        assert not frame.is_fd, "J1939's own messages are classic frames without protection"
        return
    assert p05.e2e_p05_check(frame.data, data_id)
    earlier = [f for n, _, f in VECTORS if n == name]
    assert frame.data[2] == earlier.index(frame)


def signals(index: int) -> dict[str, object]:
    name, _, frame = VECTORS[index]
    assert DATABASE.get_message_by_name(name).frame_id == frame.can_id
    return dict(DATABASE.decode_message(frame.can_id, frame.data, decode_choices=False))


def test_edges_chain_back_from_the_read_across_the_clocks_wrap() -> None:
    first, second = signals(0), signals(1)
    for read in (first, second):
        newest = int(read["ReadTime"]) - (int(read["ReadTime"]) - read["TimestampLow00"]) % 65536
        before = newest - (newest - int(read["TimestampLow01"])) % 65536
        assert newest - before == 997
    assert (second["ReadTime"] - first["ReadTime"]) % 2**32 == 10_000
    assert second["NewestIndex"] - first["NewestIndex"] == 10
    assert signals(2)["Stopped"] == 1


def test_values_are_what_the_words_say() -> None:
    by_words = {words: signals(i) for i, (_, words, _) in enumerate(VECTORS)}
    sensors = next(v for w, v in by_words.items() if w.startswith("brake valve open"))
    assert sensors["SupplyPressure"] == pytest.approx(9.513, abs=0.001)
    assert sensors["ClutchPosition"] == pytest.approx(100.0)
    engine = next(v for w, v in by_words.items() if w.startswith("engine at 1,200"))
    assert engine["EngineSpeed"] == 1200
    command = next(v for w, v in by_words.items() if w.startswith("brake on now"))
    assert (command["BrakeAction"], command["MainSecondAction"]) == (1, 3)
    assert command["MainSecondTime"] == 104_000
    off = by_words["all valves off"]
    assert {v for k, v in off.items() if k.endswith("Action")} == {0}
