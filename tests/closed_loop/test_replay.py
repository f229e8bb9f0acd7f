"""A recorded bus through the same controller: identical, or it says where and why not."""

from __future__ import annotations

import dataclasses
import platform
from pathlib import Path
from typing import ClassVar

import pytest
from loop_bench import Loop

from meshpoint.controller.settings.header import RunHeader, arithmetic
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.replays.replay import LogReplay
from meshpoint.replays.session import Session, Verification


def verify(loop: Loop, frames: list[Frame], folder: Path) -> Session:
    loop.header.save(folder)
    (session,) = LogReplay(folder, verify=True).run(frames)
    return session


@pytest.fixture(scope="session")
def log(one_shift: Loop) -> list[Frame]:
    return [frame for _, frame in one_shift.frames]


@pytest.mark.parametrize(
    "name",
    ["one_shift", pytest.param("six_shifts", marks=pytest.mark.long), "immediate_shift"],
)
def test_every_simulated_log_is_identical(
    name: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """Byte for byte, also where the controller steps between two ticks."""
    loop: Loop = request.getfixturevalue(name)
    session = verify(loop, [frame for _, frame in loop.frames], tmp_path)
    assert session.verdict is Verification.IDENTICAL, str(session)
    assert session.steps == len({status.step_number for status in loop.of(type(loop.status))})
    assert session.frames > 3 * session.steps


def test_a_run_on_a_bad_bus_is_identical_too(tmp_path: Path) -> None:
    """What was corrupt on the wire is corrupt in the log: the same verdicts fall again. Foreign
    frames count by their number alone."""
    loop = Loop([(300_000, 10)])
    spoilt, inner = [0], loop.rig.core
    encode = inner.step

    def step(now_us: int):  # type: ignore[no-untyped-def]
        made = encode(now_us)
        frames = []
        for frame in made.frames:
            spoilt[0] += 1
            if spoilt[0] % 40 == 0:
                frames.append(frame._replace(data=frame.data[:-1] + b"\x55"))
            elif spoilt[0] % 41 == 0:
                frames += [frame, Frame(0x18FE_F100, b"12345678", is_fd=False)]
            elif spoilt[0] % 43:
                frames.append(frame)
        return made._replace(frames=frames)

    inner.step = step  # type: ignore[method-assign]
    loop.run(1_600_000)
    assert loop.status.e2e_errors > 10
    assert loop.status.foreign_frames > 10
    session = verify(loop, [frame for _, frame in loop.frames], tmp_path)
    assert session.verdict is Verification.IDENTICAL, str(session)


@pytest.mark.parametrize(
    "name",
    [
        "EdgesLayshaftRise",
        "SleevesMain",
        "ReferenceEncoder",
        "EEC1",
        "ValveCommand",
        "ControllerEstimates",
        "ControllerStatus",
        "ETC1",
    ],
)
@pytest.mark.parametrize("share", [pytest.param(0.1, marks=pytest.mark.check), 0.6])
def test_a_log_with_one_bit_changed_is_never_called_identical(
    name: str, share: float, log: list[Frame], one_shift: Loop, tmp_path: Path
) -> None:
    """In a frame it heard, in one it only counted, or in one it sent itself."""
    can_id = CODECS[name].spec.can_id
    where = [i for i, frame in enumerate(log) if frame.can_id == can_id]
    at = where[int(share * len(where))]
    data = bytearray(log[at].data)
    data[-1] ^= 0x10
    tampered = [*log[:at], log[at]._replace(data=bytes(data)), *log[at + 1 :]]
    session = verify(one_shift, tampered, tmp_path)
    assert session.verdict is not Verification.IDENTICAL
    assert session.step is not None
    assert session.reason


@pytest.fixture(scope="module")
def clean(log: list[Frame], one_shift: Loop, tmp_path_factory: pytest.TempPathFactory) -> Session:
    """What is said of the log as it was."""
    return verify(one_shift, log, tmp_path_factory.mktemp("clean"))


@pytest.mark.parametrize("can_id", [0x0CFF4003, 0x08B6BB03, 0x18FF5F03, 0x0CF00203])
def test_frames_under_its_address_that_it_did_not_send_are_named_as_intruders(
    can_id: int, log: list[Frame], clean: Session, one_shift: Loop, tmp_path: Path
) -> None:
    """A babbling valve command without its protection, a message that nobody knows, a status frame,
    and one of J1939, which has no protection: the controller did nothing wrong."""
    length = next((c.spec.length for c in CODECS.values() if c.spec.can_id == can_id), 8)
    babble = Frame(can_id, bytes(range(length)), is_fd=length > 8)
    babbled = []
    for i, frame in enumerate(log):
        # Not behind the log's last frame: it might be of a step whose end is not in the log.
        babbled += [frame, babble] if i % 50 == 7 and frame is not log[-1] else [frame]
    session = verify(one_shift, babbled, tmp_path)
    assert session.verdict is Verification.IDENTICAL, str(session)
    assert session.intruders == {can_id: len(babbled) - len(log)}
    assert f"{can_id:08X}" in str(session)
    assert clean.intruders == {}
    assert (session.steps, session.frames) == (clean.steps, clean.frames)


@pytest.mark.parametrize("name", ["ETC1", "ValveCommand"])
def test_an_intruder_in_place_of_its_own_frame_is_a_difference(
    name: str, log: list[Frame], one_shift: Loop, tmp_path: Path
) -> None:
    can_id = CODECS[name].spec.can_id
    at = [i for i, frame in enumerate(log) if frame.can_id == can_id][40]
    other = log[at]._replace(data=bytes(len(log[at].data)))
    session = verify(one_shift, [*log[:at], other, *log[at + 1 :]], tmp_path)
    assert session.verdict is Verification.DIFFERS
    assert f"{can_id:08X}" in session.reason


class Elsewhere(Loop):
    """A loop whose controller says that it ran somewhere else."""

    made_with: ClassVar[dict[str, str | None]]

    @property
    def header(self) -> RunHeader:
        return dataclasses.replace(super().header, **self.made_with)


class OnAnotherPython(Elsewhere):
    """As headers were before they named the arithmetic."""

    made_with: ClassVar = {"architecture": f"{platform.machine()} python 3.9", "arithmetic": None}


class OnAnotherProcessor(Elsewhere):
    made_with: ClassVar = {"arithmetic": f"{arithmetic()[:-8]}01234567"}


@pytest.mark.parametrize(
    ("elsewhere", "verdict"),
    [
        (OnAnotherPython, Verification.DIFFERS),
        (OnAnotherProcessor, Verification.NOT_VERIFIABLE),
    ],
)
def test_the_same_bytes_are_identical_wherever_they_were_made(
    elsewhere: type[Elsewhere], verdict: Verification, tmp_path: Path
) -> None:
    """Others may come of rounding where that is another; of Python's minor version they never do,
    so there it is the controller."""
    loop = elsewhere([])
    loop.run(200_000)
    frames = [frame for _, frame in loop.frames]
    assert verify(loop, frames, tmp_path).verdict is Verification.IDENTICAL
    can_id = CODECS["ETC1"].spec.can_id
    at = [i for i, frame in enumerate(frames) if frame.can_id == can_id][9]
    frames[at] = frames[at]._replace(data=bytes(8))
    session = verify(loop, frames, tmp_path)
    assert session.verdict is verdict
    assert f"{can_id:08X}" in session.reason
    assert ("rounding 01234567" in session.reason) is (verdict is Verification.NOT_VERIFIABLE)


@pytest.mark.parametrize("name", ["EdgesMainFall", "ValveCommand", "ControllerStatus"])
def test_a_log_with_a_frame_missing_is_never_called_identical(
    name: str, log: list[Frame], one_shift: Loop, tmp_path: Path
) -> None:
    can_id = CODECS[name].spec.can_id
    where = [i for i, frame in enumerate(log) if frame.can_id == can_id]
    at = where[len(where) // 2]
    session = verify(one_shift, log[:at] + log[at + 1 :], tmp_path)
    assert session.verdict is not Verification.IDENTICAL


def test_equal_requests_that_a_slow_node_takes_one_by_one_are_all_found(tmp_path: Path) -> None:
    """Asked three times before its first step, it takes one request a step: which of the three the
    first was cannot be determined, and must not matter."""
    held: list[Frame] = []

    def one_each_tick(frame: Frame) -> list[Frame]:
        if frame.can_id == CODECS["TC1"].spec.can_id:
            held.append(frame)
            return []
        due = held and frame.can_id == CODECS["EEC1"].spec.can_id
        return [frame, held.pop(0)] if due else [frame]

    phases_us = [726, 5_600, 189]  # the operator's step is the first
    loop = Loop([(0, 10)] * 3, receiving=one_each_tick, phases_us=phases_us)
    loop.run(200_000)
    assert not held and loop.status.step_number > 10
    session = verify(loop, [frame for _, frame in loop.frames], tmp_path)
    assert session.verdict is Verification.IDENTICAL, str(session)


@pytest.mark.long
def test_another_strategy_acts_on_the_same_frames(six_shifts: Loop, tmp_path: Path) -> None:
    """Up to the first aimed shift both do the same; from there on the difference is reported."""
    six_shifts.header.save(tmp_path)

    def change(header: RunHeader) -> RunHeader:
        settings = dataclasses.replace(header.settings, strategy_name="speed_window")
        return dataclasses.replace(header, settings=settings)

    made: list[Frame] = []
    frames = [frame for _, frame in six_shifts.frames]
    (session,) = LogReplay(tmp_path, False, change, made.append).run(frames)
    assert session.verdict is Verification.IDENTICAL
    assert session.steps == len(six_shifts.of(type(six_shifts.status)))
    outcome_id = CODECS["ShiftOutcome"].spec.can_id
    assert sum(frame.can_id == outcome_id for frame in made) >= 3
    valve_id = CODECS["ValveCommand"].spec.can_id
    commands = [frame.data for frame in made if frame.can_id == valve_id]
    logged = [frame.data for frame in six_shifts.sent_as("ValveCommand")]
    assert commands[:200] == logged[:200]
    assert commands != logged


def test_a_log_without_status_frames_says_so(tmp_path: Path) -> None:
    (session,) = LogReplay(tmp_path, verify=True).run([Frame(0x123, b"", is_extended=False)])
    assert session.verdict is Verification.NOT_VERIFIABLE
    assert "status" in str(session)
