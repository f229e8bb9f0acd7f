"""Random values and random frames of an XCP master: what is out of range is refused, and no valve
moves."""

from __future__ import annotations

import math
import random
import struct
from dataclasses import replace
from pathlib import Path

import pytest
from loop_bench import Loop
from xcp_master import address_of, master, refusal, settings_of, verdict

from meshpoint.base.version import product_version
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.header import XcpAccess, new_header
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import XCP_COMMAND_ID, XCP_RESPONSE_ID
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.tables import TableError
from meshpoint.replays.session import Verification
from meshpoint.xcp.memory import (
    MEASURED_ADDRESS,
    PAGE_ADDRESS,
    PARAMETERS,
    ROW_BYTES,
    Parameter,
    StepFacts,
)
from meshpoint.xcp.node import XcpNode


@pytest.mark.parametrize("downloads", [300, pytest.param(1_000, marks=pytest.mark.long)])
def test_downloads_leave_every_setting_in_its_range(tmp_path: Path, downloads: int) -> None:
    """A value is taken where its limits and those of the others allow it, and nothing of it is
    where they do not."""
    draw = random.Random(47)
    with master(alone=True) as (one, run, _):
        one.connect()
        expected, taken = ControllerSettings(), 0
        for _ in range(downloads):
            parameter = draw.choice(PARAMETERS)
            content = drawn(parameter, draw)
            wanted = changed(expected, parameter, content)
            one.setMta(address_of(parameter.name))
            if wanted is None:
                assert "OUT_OF_RANGE" in refusal(one.download, content)
            else:
                one.download(content)
                expected, taken = wanted, taken + 1
            assert settings_of(run) == expected
        assert 0.3 < taken / downloads < 0.7
    session = verdict(run, tmp_path)
    assert session.verdict is Verification.IDENTICAL, session.reason


def drawn(parameter: Parameter, draw: random.Random) -> bytes:
    """Inside the limits, beyond them, or anything."""
    low, high = parameter.rule.low, parameter.rule.high
    width = high - low
    value = draw.choice(
        [draw.uniform(low, high), low, high, high + draw.random() * width, low - 0.1 * width]
    )
    if draw.random() < 0.2 or (value < 0 and parameter.is_whole):
        return draw.randbytes(ROW_BYTES)
    return parameter.packed(value)


def changed(
    settings: ControllerSettings, parameter: Parameter, content: bytes
) -> ControllerSettings | None:
    """The settings as a file with this value would give them; None where that would be refused."""
    value = parameter.unpacked(content)
    low, high = (
        parameter.unpacked(parameter.packed(each))
        for each in (parameter.rule.low, parameter.rule.high)
    )
    if not (math.isfinite(value) and low <= value <= high):
        return None
    before = getattr(settings, parameter.group)
    reference = getattr(ControllerSettings(), parameter.group)
    si = min(max(value, parameter.rule.low), parameter.rule.high) * parameter.rule.si
    if content == parameter.packed(parameter.of(ControllerSettings())):
        si = getattr(reference, parameter.attribute)
    number = value if parameter.is_whole else si
    try:
        group = replace(before, **{parameter.attribute: number})
        return replace(settings, **{parameter.group: group})
    except TableError:
        return None


def random_commands(draw: random.Random) -> list[Frame]:
    """Now and then some that open a session, and write where a setting is."""
    if draw.random() < 0.02:
        return [Frame(XCP_COMMAND_ID, b"\xff\x00", is_fd=bool(draw.getrandbits(1)))]
    if draw.random() < 0.2:
        address = PAGE_ADDRESS + ROW_BYTES * draw.randrange(len(PARAMETERS))
        number = drawn(draw.choice(PARAMETERS), draw)
        point, write = b"\xf6\0\0\0" + struct.pack("<I", address), b"\xf0\x04" + number
        return [Frame(XCP_COMMAND_ID, each, is_fd=False) for each in (point, write)]
    length = draw.choice((0, 1, 2, 4, 7, 8, 8, 8, 12, 64))
    content = draw.randbytes(length)
    if length and draw.random() < 0.7:
        content = bytes([draw.randrange(0xC0, 0x100)]) + content[1:]
    if length >= 8 and draw.random() < 0.5:
        address = draw.choice((PAGE_ADDRESS, MEASURED_ADDRESS)) + draw.randrange(200)
        content = content[:3] + struct.pack("<BI", 0, address) + content[8:]
    return [Frame(XCP_COMMAND_ID, content, is_fd=length > 8)]


def test_a_hundred_thousand_random_frames_spoil_no_setting() -> None:
    draw, sheet = random.Random(4_711), load_sheet("thesis")
    node = XcpNode(product_version(), ControllerSettings(), XcpAccess.WRITE)
    kept = ControllerCore(new_header("1", sheet, ControllerSettings())).calibration("")
    facts = StepFacts((0.0,) * 4, 0, lambda: kept)
    sent = changes = 0
    for step in range(12_500):
        for command in [each for _ in range(8) for each in random_commands(draw)]:
            node.receive(command)
        frames, _ = node.step([], facts, 10_000 * step, shift_ended=step % 9 == 0)
        sent += len(frames)
        change = node.take_change()
        if change is not None:
            changes += 1
            for each in PARAMETERS:
                margin = 1e-12 * abs(each.rule.high)
                value = each.of(change[0])
                assert each.rule.low - margin <= value <= each.rule.high + margin, each.name
    assert sent > 20_000
    assert changes > 20


def test_random_frames_move_no_valve() -> None:
    draw = random.Random(17)

    def noisy(frame: Frame) -> list[Frame]:
        return [frame, *random_commands(draw)]

    loop = Loop([], xcp=XcpAccess.WRITE, receiving=noisy).run(2_000_000)
    assert len(loop.sent_as("ValveCommand")) > 150
    assert all(set(frame.data[3:]) == {0} for frame in loop.sent_as("ValveCommand"))
    assert loop.valves_driven == ()
    assert any(frame.can_id == XCP_RESPONSE_ID for _, frame in loop.frames)


def test_a_shift_amid_random_frames_is_the_same_shift(tmp_path: Path) -> None:
    """As long as none of them is a good download."""
    draw = random.Random(7)

    def noisy(frame: Frame) -> list[Frame]:
        if frame.can_id & 0xFF != 0x80:
            return [frame]
        return [frame, Frame(XCP_COMMAND_ID, draw.randbytes(8), is_fd=False)]

    quiet = Loop([(300_000, 10)]).run(2_500_000)
    loud = Loop([(300_000, 10)], xcp=XcpAccess.READ, receiving=noisy).run(2_500_000)
    assert [each.result for each in quiet.outcomes] == [each.result for each in loud.outcomes]
    assert quiet.sent_as("ValveCommand") == loud.sent_as("ValveCommand")
