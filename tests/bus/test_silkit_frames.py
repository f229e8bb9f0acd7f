"""What comes from SIL Kit, without it: frames in its form, messages of a coordinated run."""

from __future__ import annotations

import importlib.util
from types import SimpleNamespace as Event

import pytest

from meshpoint.bench.shared_bus import HandOver
from meshpoint.bridges.silkit_coordinated import Announced, pack
from meshpoint.bus.silkit.library import FDF, IDE, RTR, XLF, Heard, SilKitError, wire_frame
from meshpoint.bus.simulated.frame_bits import WireFrame
from meshpoint.cli.main import main
from meshpoint.dbc.frame import Frame

LOW = Frame(0x18FF1080, bytes(range(64)))
HIGH = Frame(0x123, b"abc", is_fd=False, is_extended=False)
RIG = 1
FLAGS = {LOW: IDE | FDF, HIGH: 0}


def heard_in(announced: Announced, *frames: Heard) -> None:
    for frame in frames:
        announced.on_frame(None, Event(frame=frame))


def sent(*frames: Frame) -> list[Heard]:
    return [Heard(frame.can_id, frame.data, FLAGS[frame], 0) for frame in frames]


@pytest.fixture
def announced() -> Announced:
    return Announced("CAN1", own=frozenset({0, 2}))


def test_what_is_handed_over_arrives_with_its_time_node_and_frames(announced: Announced) -> None:
    earlier, later = HandOver(1_000, RIG, [LOW, HIGH]), HandOver(1_200, RIG, [HIGH])
    for handed in (earlier, later):
        announced.on_message(None, Event(data=pack(handed)))
        heard_in(announced, *sent(*handed.frames))
    assert announced.before(1_200) == [earlier]
    assert announced.before(1_318) == [later]


def test_a_participants_own_messages_are_not_taken_for_others(announced: Announced) -> None:
    announced.on_message(None, Event(data=pack(HandOver(1_000, 2, [LOW]))))
    assert announced.before(2_000) == []


@pytest.mark.parametrize(
    ("came", "reason"),
    [
        (sent(HIGH), "CAN1: frame 0x123: neither controller nor rig"),
        ([], "CAN1: frame 0x18FF1080 has not arrived"),
        ([Heard(LOW.can_id, bytes(9), IDE, 0)], "CAN1: frame 0x18FF1080: 9 bytes, allowed are"),
        ([Heard(LOW.can_id, b"", IDE | XLF, 0)], "CAN1: frame 0x18FF1080: CAN XL, allowed are"),
    ],
    ids=["another's", "none", "too long", "CAN XL"],
)
def test_a_frame_that_was_not_announced_is_named(
    announced: Announced, came: list[Heard], reason: str
) -> None:
    announced.on_message(None, Event(data=pack(HandOver(1_000, RIG, [LOW]))))
    heard_in(announced, *came)
    with pytest.raises(SilKitError, match=reason):
        announced.before(2_000)


@pytest.mark.parametrize("length", [0, 8, 9, 12, 14])
def test_a_message_of_another_length_is_named(announced: Announced, length: int) -> None:
    announced.on_message(None, Event(data=bytes(length)))
    with pytest.raises(SilKitError, match=f"topic meshpoint/handed: message of {length} bytes"):
        announced.before(2_000)


def test_a_remote_frame_keeps_the_length_it_asks_for() -> None:
    expected = WireFrame(5, b"", False, False, False, is_remote=True, dlc=4)
    assert wire_frame(Heard(5, b"", RTR, 4)) == expected


@pytest.mark.skipif(importlib.util.find_spec("SilKit_py") is not None, reason="it is installed")
@pytest.mark.parametrize("words", [["simulate", "--silkit"], ["watch", "-i", "silkit"]])
def test_where_it_is_not_installed_the_extra_is_named(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "pip install 'meshpoint[silkit]', in Python 3.12 or newer" in said


def test_other_nodes_frames_are_not_on_its_bus(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "--silkit", "--bus-load", "0.5"]) == 2
    assert "--silkit: other nodes' frames (--bus-load)" in capsys.readouterr().err
