"""The same runs as ever, to the byte: whatever is made simpler inside, a shift stays what it was.

`recorded_runs.toml` has of each run the controller's log, its shifts, and digests of all frames.
`recorded/` has of some all that the controller heard and sent: these are repeated without a rig, so
that a change of the rig does not touch them.

A change that is meant to change what a shift does is followed by `make digests`; its diff then says
in plain words which decisions have changed.
"""

from __future__ import annotations

import functools
import platform
from typing import NamedTuple

import pytest
from recorded_runs import (
    DIGESTS,
    LONG,
    OF_CHECK,
    RUNS,
    TRANSCRIBED,
    Run,
    controller_of,
    first_difference,
    frame_of,
    recorded,
    repeated,
    transcript_of,
)

from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ValveAction

RECORDED = recorded()
BY_IDENTIFIER = {codec.spec.can_id: codec for codec in CODECS.values()}
MEANT = "If this change is meant: make digests"


def first_part(now: list[str], then: list[str]) -> int:
    """The first tenth of a second in which digests differ."""
    same = (a == b for a, b in zip(now, then, strict=False))
    return next((i for i, is_same in enumerate(same) if not is_same), min(len(now), len(then)))


def where_they_part(now: Run, then: Run) -> str:
    """Whose frames were the first to differ; who heard others before may well decide otherwise."""
    parts = {side: first_part(getattr(now, side), getattr(then, side)) for side in DIGESTS}
    first = min(parts.values())
    whose = " and ".join(side for side, part in parts.items() if part == first)
    return f"frames of {whose} differ from {first / 10} s of bus time on. {MEANT}"


def marks_of(name: str) -> list[pytest.MarkDecorator]:
    """By which command a run is repeated."""
    return [pytest.mark.long] * (name in LONG) + [pytest.mark.check] * (name in OF_CHECK)


@functools.cache
def made_once_more(*names: str) -> dict[str, tuple[Run, str | None]]:
    return repeated(names)


def again(name: str) -> tuple[Run, str | None]:
    if platform.machine() != "x86_64":
        pytest.skip(f"recorded on x86_64, this is {platform.machine()}: it may round otherwise")
    together = [each for each in RUNS if marks_of(each) == marks_of(name)]
    return made_once_more(*together)[name]


@pytest.mark.parametrize("name", [pytest.param(name, marks=marks_of(name)) for name in RUNS])
def test_a_run_is_what_it_was(name: str) -> None:
    now, then = again(name)[0], RECORDED[name]
    assert now.events == then.events, MEANT
    assert now.shifts == then.shifts, MEANT
    assert now == then, where_they_part(now, then)


@pytest.mark.parametrize("name", TRANSCRIBED)
def test_a_controller_that_hears_the_same_sends_the_same(name: str) -> None:
    found = again(name)[1]
    assert found is None, f"{name}, {found}. {MEANT}"


@pytest.mark.parametrize("name", TRANSCRIBED)
def test_in_what_is_recorded_nothing_is_on_when_a_shift_has_ended(name: str) -> None:
    """Records that are made anew have to keep it too."""
    ended, valves_off, sent = 0, True, dict[str, NamedTuple]()
    for line in transcript_of(name):
        if line[0] == ">":
            frame = frame_of(line[2:])
            codec = BY_IDENTIFIER[frame.can_id]
            sent[codec.message_type.__name__] = codec.decode(frame.data)
        elif line[0] == "=":
            outcome, command = sent.pop("ShiftOutcome", None), sent["ValveCommand"]
            if outcome is not None:
                actions = [v for k, v in command._asdict().items() if k.endswith("_action")]
                ended += 1
                valves_off &= not {ValveAction.ON_NOW, ValveAction.ON_AT} & set(actions)
    assert ended > 0
    assert valves_off


def test_one_bit_of_one_edge_is_a_difference_and_the_frame_is_named() -> None:
    """What the controller heard is changed in the midst of a shift; it says so in its next status,
    whose CRC is of all that it consumed."""
    lines = transcript_of("clean_thesis")
    can_id = f"< {CODECS['EdgesMainRise'].spec.can_id:08X}"
    at = [i for i, line in enumerate(lines) if line.startswith(can_id)][100]
    lines[at] = lines[at][:-1] + ("0" if lines[at][-1] != "0" else "1")
    found = first_difference(controller_of(RUNS["clean_thesis"]), lines[: at + 200])
    assert found is not None
    assert "> " in found


def test_a_difference_is_reported_with_whose_frames_part_first() -> None:
    then = Run(["a", "b", "c"], ["a", "b", "c"])
    for now, reported in (
        (Run(["a", "x", "y"], ["a", "b", "y"]), "controller differ from 0.1 s"),
        (Run(["a", "b", "y"], ["a", "x", "y"]), "others differ from 0.1 s"),
        (Run(["a", "x", "y"], ["a", "x", "y"]), "controller and others differ from 0.1 s"),
        (Run(["a", "b"], ["a", "b"]), "controller and others differ from 0.2 s"),
    ):
        assert reported in where_they_part(now, then)
