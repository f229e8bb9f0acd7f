"""Proven commands in the loop: what an attacker sends changes nothing, and a key is needed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from forged_commands import NAMES, Attacker, Run

from meshpoint.base.exits import Exit
from meshpoint.bus.command_keys import make_keys
from meshpoint.cli.main import main
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import ShiftOutcome, ShiftResult, ValveStatus
from meshpoint.dbc.node import Node

OTHER = make_keys({name: bytes([9 + k]) * 16 for k, name in enumerate(NAMES)}, "other")


def messages(run: Run, kind: type) -> list[object]:
    receiver = Receiver(*Node)
    decoded = [receiver.receive(frame).message for _, frame in run.frames]
    return [message for message in decoded if type(message) is kind]


def test_an_attacked_run_is_that_without_attacks() -> None:
    """Two shifts; the long run is `forged_commands.py 1000000`."""
    attacker = Attacker(1)
    attacked, quiet = Run(attacker, each=20).to(2_500_000), Run(None).to(2_500_000)
    assert sum(attacker.sent.values()) > 3_000
    assert set(attacker.sent) == set(Attacker.KINDS)
    assert attacked.frames == quiet.frames
    assert sum(attacked.rig.truth.violations.values()) == 0
    assert attacked.gate.verifier.refused > 1_000
    outcomes = messages(attacked, ShiftOutcome)
    assert [outcome.result for outcome in outcomes] == [ShiftResult.ENGAGED] * 2  # type: ignore[attr-defined]


def test_a_controller_with_other_keys_moves_nothing() -> None:
    run = Run(None, keys=OTHER).to(1_500_000)
    assert run.gate.verifier.proven == 0
    assert run.gate.verifier.refused > 50
    for status in messages(run, ValveStatus):
        driven = [k for k, v in status._asdict().items() if k.endswith("_energised") and v]  # type: ignore[attr-defined]
        assert not driven


def test_simulate_with_keys_and_replay_without_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys, log = tmp_path / "keys.toml", tmp_path / "x.log"
    keys.write_text(
        "".join(f'{name} = "{k:032x}"\n' for k, name in enumerate(NAMES))
    )  # fmt: skip
    keys.chmod(0o600)
    run = ["simulate", "--preset", "thesis", "--shifts", "1", "--seed", "3", "--json", "-"]
    assert main([*run, "--keys", str(keys), "--log", str(log)]) == Exit.DONE
    shifts = json.loads(capsys.readouterr().out.split("\nlog ")[0])["shifts"]
    assert [shift["result"] for shift in shifts] == ["engaged"]
    assert main(["replay", str(log), "--verify"]) == Exit.DONE
    said = capsys.readouterr().out
    assert "identical" in said
    assert "0CFF4203" not in said
