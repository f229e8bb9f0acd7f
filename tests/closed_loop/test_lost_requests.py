"""A line that is gone from a log shows, also of messages that have no counter: the controller has
reported what it consumed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from loop_bench import Loop

from meshpoint.bus.logs.recorder import LogWriter
from meshpoint.cli.main import main
from meshpoint.dbc.layout import CODECS
from meshpoint.logs.account import Account


def account_without(loop: Loop, message: str, number: int) -> Account:
    """Of the run's log without one of these frames."""
    can_id = CODECS[message].spec.can_id
    places = [i for i, (_, frame) in enumerate(loop.frames) if frame.can_id == can_id]
    account = Account()
    for i, (time_us, frame) in enumerate(loop.frames):
        if i != places[number]:
            account.take(time_us * 1e-6, frame)
    return account


@pytest.mark.parametrize(("message", "number"), [("EEC1", 5), ("EEC1", -20), ("TC1", 0)])
def test_a_frame_without_a_counter_that_is_lost_is_reported(
    one_shift: Loop, message: str, number: int
) -> None:
    account = account_without(one_shift, message, number)
    assert account.lost == 0
    assert account.to_json()["consumed_but_missing"] == 1
    assert any("1 frames lost that the controller has consumed" in w for w in account.words())


def test_a_whole_log_lacks_nothing_and_a_log_of_sensors_is_not_judged(one_shift: Loop) -> None:
    for chosen in (
        one_shift.frames,
        [pair for pair in one_shift.frames if pair[1].can_id & 0xFF != 0x03],
        one_shift.frames[3_000:],
    ):
        account = Account()
        for time_us, frame in chosen:
            account.take(time_us * 1e-6, frame)
        assert account.to_json()["consumed_but_missing"] == 0
        assert account.to_json()["steps_of_changed_frames"] == 0


def test_a_request_with_another_gear_than_was_consumed_is_reported(one_shift: Loop) -> None:
    tc1, account = CODECS["TC1"].spec.can_id, Account()
    for time_us, frame in one_shift.frames:
        data = frame.data if frame.can_id != tc1 else frame.data[:-1] + b"\x00"
        account.take(time_us * 1e-6, frame._replace(data=data))
    assert account.to_json()["consumed_but_missing"] == 0
    assert account.to_json()["steps_of_changed_frames"] > 0


@pytest.mark.parametrize("command", ["replay --gap-rate", "identify"])
def test_the_gap_rate_and_identify_tell_it(
    one_shift: Loop, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    one_shift.header.save(tmp_path)
    can_id, path = CODECS["TC1"].spec.can_id, tmp_path / "a.log"
    with LogWriter(path, flush_every_s=None) as log:
        first = next(i for i, (_, frame) in enumerate(one_shift.frames) if frame.can_id == can_id)
        for i, (time_us, frame) in enumerate(one_shift.frames):
            if i != first:
                log.write(time_us * 1e-6, frame)
    values = tmp_path / "reported.json"
    main([*command.split(), str(path), "--json", str(values)])
    reported: dict[str, Any] = json.loads(values.read_text())
    assert reported["account"]["consumed_but_missing"] == 1
    assert "1 frames lost that the controller has consumed" in capsys.readouterr().out
