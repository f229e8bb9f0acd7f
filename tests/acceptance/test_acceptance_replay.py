"""`meshpoint replay`: three things it may say of a log, and an error for what is no log of ours."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import pytest
from acceptance_kit import Outcome, assert_ended_well, assert_refused, run
from acceptance_wire import LogLine, Recorded, Wire, copy_run, read_lines, verdict_of, write_lines


def verify(log: Path) -> Outcome:
    return run("replay", log, "--verify")


def assert_not_identical(outcome: Outcome) -> None:
    verdict = verdict_of(outcome)
    assert verdict == "not verifiable" or verdict.startswith("differs"), outcome.text
    assert outcome.code not in (0, 2), outcome.text


@pytest.fixture
def copied(recorded: Recorded, tmp_path: Path) -> Path:
    """A copy of the recorded run to tamper with."""
    return copy_run(recorded.log, tmp_path / "copy")


def index_of(lines: list[LogLine], wire: Wire, name: str, nth: int) -> int:
    found = [index for index, line in enumerate(lines) if line.can_id == wire.ids[name]]
    return found[nth]


def flipped(line: LogLine, at: int) -> LogLine:
    data = bytearray(line.data)
    data[at] ^= 0x01
    return line._replace(data=bytes(data))


@pytest.mark.parametrize("strategy", ["speed_window", "target_phase"])
@pytest.mark.parametrize("estimator", ["window", "thesis"])
def test_a_log_of_simulate_is_identical(
    simulated: Callable[..., Recorded], strategy: str, estimator: str
) -> None:
    log = simulated(
        "--seed", 5, "--shifts", 2, "--estimator", estimator, "--strategy", strategy
    ).log
    outcome = verify(log)
    assert_ended_well(outcome)
    assert verdict_of(outcome) == "identical"


def test_a_moved_log_with_its_header_is_identical(copied: Path) -> None:
    outcome = verify(copied)
    assert_ended_well(outcome)
    assert verdict_of(outcome) == "identical"


def test_a_changed_valve_command_differs_at_its_step(copied: Path, wire: Wire) -> None:
    lines = read_lines(copied)
    at = index_of(lines, wire, "ValveCommand", 200)
    changed = flipped(lines[at], 10)
    lines[at] = changed._replace(data=wire.protect(changed.can_id, changed.data))
    write_lines(copied, lines)
    status = next(line for line in lines[at:] if line.can_id == wire.ids["ControllerStatus"])
    step = int.from_bytes(status.data[3:7], "little")
    outcome = verify(copied)
    assert verdict_of(outcome) == f"differs {step}", outcome.text
    assert outcome.code not in (0, 2), outcome.text


@pytest.mark.parametrize("name", ["EdgesLayshaftRise", "SleevesMain", "EEC1", "ReferencePhase"])
def test_a_changed_rig_frame_is_never_identical(copied: Path, wire: Wire, name: str) -> None:
    lines = read_lines(copied)
    at = index_of(lines, wire, name, 150)
    lines[at] = flipped(lines[at], len(lines[at].data) - 1)
    write_lines(copied, lines)
    outcome = verify(copied)
    assert_not_identical(outcome)


@pytest.mark.parametrize("name", ["EdgesMainFall", "GearboxSensors", "ControllerStatus"])
def test_a_removed_frame_is_never_identical(copied: Path, wire: Wire, name: str) -> None:
    lines = read_lines(copied)
    del lines[index_of(lines, wire, name, 150)]
    write_lines(copied, lines)
    outcome = verify(copied)
    assert_not_identical(outcome)


def test_an_added_frame_of_ours_is_never_identical(copied: Path, wire: Wire) -> None:
    lines = read_lines(copied)
    at = index_of(lines, wire, "EdgesMainFall", 150)
    lines.insert(at, lines[at])
    write_lines(copied, lines)
    assert_not_identical(verify(copied))


def test_frames_of_others_in_the_log_change_nothing(copied: Path, wire: Wire) -> None:
    # Counted are only frames with identifiers of our DBC.
    lines = read_lines(copied)
    stranger = lines[100]._replace(
        prefix=f"({lines[100].time_s:.6f}) can0 1ABCDEF0", can_id=0x1ABCDEF0, mark="#", data=b"\1\2"
    )
    lines.insert(100, stranger)
    write_lines(copied, lines)
    outcome = verify(copied)
    # The status frame counts foreign frames, so a stranger the controller never met may show.
    verdict = verdict_of(outcome)
    assert verdict == "identical" or verdict.startswith("differs"), outcome.text


def test_a_log_that_starts_in_mid_run_is_not_verifiable(copied: Path) -> None:
    lines = read_lines(copied)
    began_s = lines[0].time_s
    write_lines(copied, [line for line in lines if line.time_s >= began_s + 1.0])
    outcome = verify(copied)
    assert verdict_of(outcome) == "not verifiable", outcome.text
    assert "start" in (outcome.out + outcome.err).lower(), "it does not say why"
    assert outcome.code not in (0, 2), outcome.text


def test_a_log_without_its_header_is_not_verifiable(copied: Path) -> None:
    for path in copied.parent.iterdir():
        if path != copied:
            path.unlink()
    outcome = verify(copied)
    assert verdict_of(outcome) == "not verifiable", outcome.text
    assert "header" in (outcome.out + outcome.err).lower(), "it does not say why"
    assert outcome.code not in (0, 2), outcome.text


def test_a_log_with_the_header_of_another_run_is_not_verifiable(
    copied: Path, simulated: Callable[..., Recorded]
) -> None:
    other = simulated("--seed", 5, "--shifts", 2, "--estimator", "window")
    headers = [path for path in other.log.parent.iterdir() if path != other.log]
    own = [path for path in copied.parent.iterdir() if path != copied]
    assert len(headers) == len(own) == 1
    own[0].write_bytes(headers[0].read_bytes())
    outcome = verify(copied)
    assert verdict_of(outcome) in ("not verifiable", "error"), outcome.text


def test_a_header_that_is_no_header_is_said_to_be_none(copied: Path) -> None:
    for path in copied.parent.iterdir():
        if path != copied:
            path.write_bytes(b"\xff\x00 not a header {")
    outcome = verify(copied)
    assert verdict_of(outcome) in ("not verifiable", "error"), outcome.text
    assert outcome.code != 0


def test_a_log_cut_between_two_lines_never_fails_badly(copied: Path) -> None:
    lines = read_lines(copied)
    write_lines(copied, lines[: len(lines) * 6 // 10])
    # All that is there can be repeated; only its end is missing.
    assert verdict_of(verify(copied)) in ("identical", "not verifiable")


def test_a_log_cut_in_the_middle_of_a_line_is_never_silently_identical(copied: Path) -> None:
    raw = copied.read_bytes()
    end = raw.index(b"\n", len(raw) * 6 // 10)
    copied.write_bytes(raw[: end - 7])
    outcome = verify(copied)
    text = (outcome.out + outcome.err).lower()
    if verdict_of(outcome) == "identical":
        assert any(word in text for word in ("truncated", "incomplete", "cut")), outcome.text
    elif outcome.code == 2:
        assert_refused(outcome, copied.name)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\n\n\n",
        b"This is a letter, not a log.\nIt has two lines.\n",
        bytes(range(256)) * 64,
        b"(0.0) can0 123\n",
        b"(nan) can0 18FF1080##1" + b"00" * 64 + b"\n",
        b"(1.0) can0 18FF1080##1zz\n",
        b'{"shifts": []}\n',
    ],
    ids=["empty", "blank lines", "letter", "binary", "no mark", "nan", "no hex", "json"],
)
@pytest.mark.parametrize("option", ["--verify", None], ids=["verify", "replay"])
def test_what_is_no_log_is_refused_by_name(
    tmp_path: Path, content: bytes, option: str | None
) -> None:
    (tmp_path / "letter.log").write_bytes(content)
    outcome = run("replay", tmp_path / "letter.log", *([option] if option else []))
    assert_refused(outcome, "letter.log")


def test_a_log_of_another_bus_is_said_not_to_be_ours(tmp_path: Path) -> None:
    lines = [f"({1 + i / 100:.6f}) can0 18FEF1{i:02X}#0102030405060708\n" for i in range(50)]
    (tmp_path / "truck.log").write_text("".join(lines))
    outcome = run("replay", tmp_path / "truck.log", "--verify")
    if outcome.code == 2:
        assert_refused(outcome, "truck.log")
    else:
        assert verdict_of(outcome) == "not verifiable", outcome.text
        assert outcome.code not in (0, 2)


def test_a_missing_log_is_refused_by_name(tmp_path: Path) -> None:
    assert_refused(run("replay", tmp_path / "nowhere.log", "--verify"), "nowhere.log")


def test_a_folder_is_no_log(tmp_path: Path) -> None:
    (tmp_path / "folder.log").mkdir()
    assert_refused(run("replay", tmp_path / "folder.log", "--verify"), "folder.log")


@pytest.mark.parametrize("seed", range(4))
def test_a_log_with_noise_in_it_never_gives_a_traceback(copied: Path, seed: int) -> None:
    draw = random.Random(seed)
    raw = bytearray(copied.read_bytes()[:400_000])
    for _ in range(20):
        raw[draw.randrange(len(raw))] = draw.randrange(256)
    copied.write_bytes(raw)
    outcome = verify(copied)
    assert verdict_of(outcome) != "identical", outcome.text
    assert outcome.code != 0, outcome.text


def test_replay_tells_what_the_core_commands_shift_by_shift(recorded: Recorded) -> None:
    outcome = run("replay", recorded.log, "--json", "-")
    assert_ended_well(outcome)
    report = outcome.json
    assert len(report["shifts"]) == len(recorded.report["shifts"])
    for said, was in zip(report["shifts"], recorded.report["shifts"], strict=True):
        assert (said["from"], said["to"]) == (was["from"], was["to"])


def test_replay_with_another_strategy_is_what_the_other_would_have_done(
    recorded: Recorded,
) -> None:
    outcome = run("replay", recorded.log, "--strategy", "speed_window", "--json", "-")
    assert_ended_well(outcome)
    was = recorded.report["shifts"]
    commanded = outcome.json["commanded"]
    assert [(c["from"], c["to"]) for c in commanded] == [(row["from"], row["to"]) for row in was]
    assert {c["strategy"] for c in commanded} == {"speed_window"}
    assert [c["recorded"]["strategy"] for c in commanded] == [row["strategy"] for row in was]
    aimed = [c for c in commanded if c["recorded"]["strategy"] == "target_phase"]
    assert any(c["fired_ms"] != c["recorded"]["fired_ms"] for c in aimed)
    # Where teeth met came of the recorded commands: it is nothing the other strategy did.
    assert all(row["contact"] is None for row in outcome.json["shifts"])


def test_reference_frames_change_nothing_of_what_the_controller_commands(
    recorded: Recorded, copied: Path, wire: Wire
) -> None:
    # The rig's truth is on the bus for logs alone: garbage in its place, valid end to end.
    draw = random.Random(1)
    lines = read_lines(copied)
    for index, line in enumerate(lines):
        if (wire.name(line.can_id) or "").startswith("Reference"):
            name = wire.name(line.can_id)
            data = bytearray(line.data)
            first = 7 if name != "ReferenceEngagement" else 9
            data[first:] = bytes(draw.randrange(256) for _ in data[first:])
            if name == "ReferenceEngagement":
                data[-7:] = line.data[-7:]
            lines[index] = line._replace(data=wire.protect(line.can_id, bytes(data)))
    write_lines(copied, lines)
    honest, spoofed = (run("replay", log, "--json", "-") for log in (recorded.log, copied))
    assert_ended_well(honest)
    assert_ended_well(spoofed)
    keys = ("from", "to", "strategy", "reference", "attempts")
    commanded = [
        [{key: row[key] for key in keys if key in row} for row in outcome.json["shifts"]]
        for outcome in (honest, spoofed)
    ]
    assert commanded[0] == commanded[1]
