"""Both ends of an authenticated link: what is passed on, and what never is."""

from __future__ import annotations

import itertools
import os
import sys
from pathlib import Path

import cantools.database
import pytest

from meshpoint.bus.authentication.frames import AUTHENTICATION_DBC, CHALLENGE, PROOF
from meshpoint.bus.authentication.proof import (
    CHALLENGE_EVERY_US,
    COMMANDS,
    ENGINE,
    HELD,
    VALVES,
    CommandProver,
    CommandVerifier,
)
from meshpoint.bus.command_keys import CommandKeys, KeysError, load_keys, make_keys
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import TSC1, ClutchCommand, ValveAction, ValveCommand
from meshpoint.dbc.node import Node
from meshpoint.dbc.schema import SCHEMA
from meshpoint.gearbox.tables import TableError

NAMES = ("valve_command", "clutch_command", "engine_request")


def keys(first: int = 1) -> CommandKeys:
    return make_keys({name: bytes([first + k]) * 16 for k, name in enumerate(NAMES)}, "test")


class Link:
    """A sender and a receiver that hear each other."""

    def __init__(self) -> None:
        self.transmitter = Transmitter(Node.TRANSMISSION_CONTROL)
        self.prover = CommandProver(keys())
        numbers = itertools.count(1)
        self.verifier = CommandVerifier(keys(), lambda: next(numbers) << 32)
        self.now_us = 0

    def challenge(self) -> Frame:
        frame = self.verifier.challenge(self.now_us)
        self.now_us += CHALLENGE_EVERY_US
        assert frame is not None
        self.prover.hear(frame)
        return frame

    def commands(self) -> list[Frame]:
        messages = (TSC1(), ValveCommand(brake_action=ValveAction.ON_NOW), ClutchCommand())
        return [self.transmitter.encode(message) for message in messages]

    def prove(self, frames: list[Frame]) -> Frame:
        proof = self.prover.prove(frames)
        assert proof is not None
        return proof

    def give(self, *frames: Frame) -> list[Frame]:
        return [passed for frame in frames for passed in self.verifier.receive(frame)]


@pytest.fixture
def link() -> Link:
    link = Link()
    link.challenge()
    return link


def test_commands_are_passed_on_with_their_proof_and_not_before(link: Link) -> None:
    commands = link.commands()
    assert link.give(*commands) == []
    assert link.give(link.prove(commands)) == commands
    assert (link.verifier.proven, link.verifier.refused) == (3, 0)


def test_all_else_is_passed_on_at_once(link: Link) -> None:
    frames = [Frame(0x18FF5F03, bytes(64)), Frame(0x123, b"", is_extended=False)]
    assert link.give(*frames) == frames


def test_nothing_is_proven_before_a_challenge() -> None:
    link = Link()
    assert link.prover.prove(link.commands()) is None


def test_a_step_without_commands_needs_no_proof(link: Link) -> None:
    assert link.prover.prove([Frame(0x18FF5F03, bytes(64))]) is None


def test_a_proof_is_good_once(link: Link) -> None:
    commands = link.commands()
    proof = link.prove(commands)
    assert link.give(*commands, proof) == commands
    assert link.give(*commands, proof) == []
    assert link.verifier.refused == 1


@pytest.mark.parametrize("index", range(3))
def test_a_changed_command_is_not_passed_on_and_the_others_are(link: Link, index: int) -> None:
    commands = link.commands()
    proof = link.prove(commands)
    last = commands[index].data[-1] ^ 1
    changed = list(commands)
    changed[index] = commands[index]._replace(data=commands[index].data[:-1] + bytes([last]))
    assert link.give(*changed, proof) == commands[:index] + commands[index + 1 :]


def test_a_command_among_forged_ones_is_found(link: Link) -> None:
    commands = link.commands()
    proof = link.prove(commands)
    forged = [commands[1]._replace(data=bytes([k]) * 48) for k in range(HELD - 1)]
    assert link.give(forged[0], *commands, *forged[1:], proof) == commands


def test_a_flood_between_command_and_proof_denies_it_and_passes_nothing(link: Link) -> None:
    commands = link.commands()
    proof = link.prove(commands)
    forged = [commands[1]._replace(data=bytes([k]) * 48) for k in range(HELD)]
    assert commands[1] not in link.give(*commands, *forged, proof)
    assert link.verifier.proven == 2


def test_a_code_is_good_for_its_own_command_alone(link: Link) -> None:
    commands = link.commands()
    message = PROOF.decode(link.prove(commands))
    exchanged = message._replace(valve_mac=message.clutch_mac, clutch_mac=message.valve_mac)
    assert link.give(*commands, PROOF.encode(0, exchanged)) == commands[:1]  # TSC1


@pytest.mark.parametrize("counter", [0, 1, 4, 6, 0xFFFF])
def test_a_counter_set_back_or_forward_proves_nothing(link: Link, counter: int) -> None:
    for _ in range(4):
        commands = link.commands()
        assert link.give(*commands, link.prove(commands)) == commands
    commands = link.commands()
    message = PROOF.decode(link.prove(commands))
    assert message.proof_counter == 5
    assert link.give(*commands, PROOF.encode(0, message._replace(proof_counter=counter))) == []
    # The right one still does: nothing forged has moved the counter.
    assert link.give(PROOF.encode(0, message)) == commands


def test_commands_of_before_are_over_two_challenges_later(link: Link) -> None:
    commands = link.commands()
    proof = link.prove(commands)
    link.challenge()
    kept = link.commands()
    late = CommandProver(keys())
    assert late.prove(kept) is None
    assert link.give(*commands, proof) == commands  # the challenge before still holds
    again = link.commands()
    second = link.prove(again)
    link.challenge()
    link.challenge()
    assert link.give(*again, second) == []


def test_once_the_newest_challenge_is_answered_the_one_before_is_over(link: Link) -> None:
    old = link.commands()
    old_proof = link.prove(old)
    link.challenge()
    new = link.commands()
    assert link.give(*new, link.prove(new)) == new
    assert link.give(*old, old_proof) == []


def test_a_restarted_sender_is_heard_from_the_next_challenge_on(link: Link) -> None:
    for _ in range(3):
        commands = link.commands()
        assert link.give(*commands, link.prove(commands)) == commands
    link.prover = CommandProver(keys())
    link.challenge()
    commands = link.commands()
    assert link.give(*commands, link.prove(commands)) == commands


def test_a_restarted_receiver_takes_nothing_that_was_recorded(link: Link) -> None:
    commands = link.commands()
    proof = link.prove(commands)
    restarted = CommandVerifier(keys(), lambda: 0x1234)
    challenge = restarted.challenge(0)
    assert challenge is not None
    assert [f for frame in (*commands, proof) for f in restarted.receive(frame)] == []
    link.prover.hear(challenge)
    fresh = link.prove(commands)
    assert [f for frame in (*commands, fresh) for f in restarted.receive(frame)] == commands


def test_challenges_come_every_50_ms_and_differ(link: Link) -> None:
    assert link.verifier.challenge(CHALLENGE_EVERY_US - 1) is None
    values = {CHALLENGE.decode(link.challenge()).challenge for _ in range(300)}
    assert len(values) == 300


def test_a_counter_that_has_run_out_waits_for_the_next_challenge(link: Link) -> None:
    link.prover._counter = 0xFFFE
    assert link.prover.prove(link.commands()) is not None
    assert link.prover.prove(link.commands()) is None
    link.challenge()
    assert link.prover.prove(link.commands()) is not None


def test_other_keys_prove_nothing(link: Link) -> None:
    other = CommandProver(keys(first=100))
    other.hear(link.challenge())
    commands = link.commands()
    proof = other.prove(commands)
    assert proof is not None
    assert link.give(*commands, proof) == []


def test_damaged_frames_of_the_link_are_nothing(link: Link) -> None:
    commands = link.commands()
    proof = link.prove(commands)
    for bad in (
        proof._replace(data=proof.data[:-1]),
        proof._replace(is_fd=False),
        proof._replace(data=proof.data[:5] + bytes([proof.data[5] ^ 1]) + proof.data[6:]),
    ):
        assert link.give(*commands, bad) == []
    assert CHALLENGE.decode(proof) is None


def test_standard_frames_with_a_commands_number_are_no_commands(link: Link) -> None:
    frame = Frame(ENGINE & 0x7FF, bytes(8), False, is_extended=False)
    assert link.give(frame) == [frame]
    assert link.give(Frame(VALVES, bytes(48), is_extended=False)) == []


def test_the_dbc_of_the_link_is_read_by_other_tools_and_shares_no_identifier() -> None:
    database = cantools.database.load_file(AUTHENTICATION_DBC)
    names = {message.name: message for message in database.messages}
    ours = {spec.can_id for spec in SCHEMA.messages}
    ids = {spec.data_id for spec in SCHEMA.messages}
    for name, channel in (("CommandProof", PROOF), ("FreshnessChallenge", CHALLENGE)):
        assert names[name].frame_id == channel.can_id
        assert channel.can_id not in ours
        assert channel._data_id not in ids
    link = Link()
    frame = link.challenge()
    decoded = names["FreshnessChallenge"].decode(frame.data)
    assert decoded["Challenge"] == 1 << 32
    assert max(COMMANDS) < PROOF.can_id


def test_the_code_is_that_of_rfc_4493() -> None:
    """AES-CMAC with the RFC's key and its 40-byte message: the library is used as meant."""
    from cryptography.hazmat.primitives.ciphers.algorithms import AES
    from cryptography.hazmat.primitives.cmac import CMAC

    mac = CMAC(AES(bytes.fromhex("2b7e151628aed2a6abf7158809cf4f3c")))
    mac.update(
        bytes.fromhex(
            "6bc1bee22e409f96e93d7e117393172aae2d8a571e03ac9c9eb76fac45af8e5130c81c46a35ce411"
        )
    )
    assert mac.finalize().hex() == "dfa66747de9ae63030ca32611497c827"


def key_file(path: Path, **values: str) -> Path:
    text = {name: f"{k + 1:032x}" for k, name in enumerate(NAMES)} | values
    path.write_text("".join(f'{name} = "{value}"\n' for name, value in text.items()))
    path.chmod(0o600)
    return path


def test_keys_come_from_a_file(tmp_path: Path) -> None:
    found = load_keys(key_file(tmp_path / "keys.toml"))
    assert found.by_id[VALVES] == (1).to_bytes(16, "big")
    assert "0001" not in repr(found)


@pytest.mark.parametrize(
    "values",
    [
        {"valve_command": "12"},
        {"valve_command": "x" * 32},
        {"clutch_command": f"{1:032x}"},
        {"another": "00"},
    ],
)
def test_a_key_file_that_cannot_be_used_is_refused_without_showing_a_key(
    tmp_path: Path, values: dict[str, str]
) -> None:
    with pytest.raises(TableError) as refused:
        load_keys(key_file(tmp_path / "keys.toml", **values))
    assert "keys.toml" in str(refused.value)
    assert "0000" not in str(refused.value)


@pytest.mark.skipif(os.name != "posix", reason="file modes are POSIX's")
def test_a_key_file_that_others_can_read_is_refused(tmp_path: Path) -> None:
    path = key_file(tmp_path / "keys.toml")
    path.chmod(0o640)
    with pytest.raises(KeysError, match="chmod 600"):
        load_keys(path)


def test_without_the_package_one_line_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "cryptography.hazmat.primitives.cmac", None)
    with pytest.raises(KeysError, match=r"meshpoint\[authentication\]"):
        CommandProver(keys())
