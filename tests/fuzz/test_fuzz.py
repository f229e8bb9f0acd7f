"""The fuzzers, small, with fixed seeds; the long runs are their commands (docs/fuzz.md)."""

from __future__ import annotations

from pathlib import Path

import fuzz_files
import pytest
from fuzz_frames import BACK_LIMIT_MS, SPARSE, Flood, Fuzz
from fuzz_live import run as run_live
from hostile import ACCIDENTS, ATTACKS, COMMANDS, SPECS, Hostile

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import FrameVerdict, Receiver
from meshpoint.dbc.node import Node


@pytest.mark.parametrize("proven", [False, True])
def test_hostile_frames_harm_nothing_and_what_they_deny_is_back_at_once(proven: bool) -> None:
    fuzz = Fuzz(seed=11, proven=proven, flood=Flood())
    found = fuzz.blocks(frames=6_000)
    assert found.frames >= 6_000
    assert set(found.kinds) == set(ATTACKS if proven else ACCIDENTS)
    assert found.violations == 0
    assert max(found.back_ms) <= BACK_LIMIT_MS
    assert set(found.results) == {"engaged"}


@pytest.mark.parametrize(
    ("seed", "shifts"), [(100, 6), pytest.param(101, 12, marks=pytest.mark.long)]
)
def test_a_hostile_frame_now_and_then_in_a_shift_harms_nothing(seed: int, shifts: int) -> None:
    """Under a flood nothing is shifted; between frames that come one by one the shift goes on, on
    what they have reported."""
    found = Fuzz(seed, proven=True, flood=SPARSE).shift_among(shifts)
    assert found.frames > 20 * shifts
    assert found.violations == 0


def test_a_flood_is_noticed_while_it_lasts() -> None:
    """So that the test above cannot pass because nothing arrives."""
    fuzz = Fuzz(seed=12, proven=False, flood=Flood())
    fuzz.run(600_000)
    for node in fuzz.nodes:
        node.is_flooded = True
    fuzz.run(300_000)
    assert not fuzz.is_back()
    assert fuzz.status is not None
    assert fuzz.status.e2e_errors > 100


def test_hostile_frames_are_what_they_are_said_to_be() -> None:
    """Right CRC and counter where that is meant: an attacker that is always refused proves
    nothing."""
    receiver, hostile = Receiver(*Node), Hostile(1, ("protected",), frozenset())
    hostile.hear(Frame(0x18FF1080, bytes(64)))
    verdicts = {receiver.receive(frame).verdict for frame in hostile.frames(3_000)}
    assert FrameVerdict.OK in verdicts
    assert FrameVerdict.E2E not in verdicts
    spared = Hostile(1, ATTACKS, COMMANDS)
    spared.hear(Frame(0x18FF1080, bytes(64)))
    refusing = Receiver(*Node)
    for frame in spared.frames(3_000):
        if frame.can_id in COMMANDS and SPECS[frame.can_id].is_protected:
            assert refusing.receive(frame).verdict is not FrameVerdict.OK


@pytest.mark.parametrize("one", fuzz_files.FILES, ids=lambda one: one.name)
def test_a_damaged_file_is_read_or_refused_and_nothing_else(
    one: fuzz_files.Format, tmp_path: Path
) -> None:
    count = 6 if one.name in fuzz_files.COSTLY else 80
    found, crashes = fuzz_files.fuzz(one, count, 1, tmp_path)
    assert not crashes
    assert found["refused"] > 0


@pytest.mark.long
def test_live_nodes_outlive_hostile_frames() -> None:
    good, line = run_live(2_000, 1)
    assert good, line
