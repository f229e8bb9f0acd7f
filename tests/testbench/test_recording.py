"""`--log` of real processes, that end or are killed, and their replay."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from cut_logs import CUT, read_until_cut
from patience import HANG_S, until

from meshpoint.bus.frames import frame_of
from meshpoint.bus.local.plugin import MeshpointBus
from meshpoint.bus.logs.files import log_files
from meshpoint.bus.logs.reader import LogError, read_log
from meshpoint.cli.main import main
from meshpoint.dbc.frame import Frame
from meshpoint.replays.replay import STATUS

ROOT = Path(__file__).resolve().parents[2]


def meshpoint(*arguments: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", "meshpoint", *arguments],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])},
    )


def kill(process: subprocess.Popen[bytes]) -> None:
    """Kills it as `kill -9` does."""
    process.kill()
    process.wait()


def identical_until_cut(session: dict[str, object]) -> bool:
    """Whether every step that is whole in the log was repeated."""
    reason = str(session["reason"])
    agrees = reason.startswith("every step before it agrees") and CUT in reason
    return session["verdict"] == "identical" or agrees


def wait_for_bytes(folder: Path, least: int) -> None:
    until(
        lambda: sum(path.stat().st_size for path in folder.glob("*")) >= least,
        f"{least} bytes in {folder}",
    )


def replay(logs: list[Path], capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    """The one session of a log, verified."""
    code = main(["replay", *map(str, logs), "--verify", "--json", "-"])
    (session,) = json.loads(capsys.readouterr().out)["sessions"]
    assert code == {"identical": 0, "not verifiable": 3}[session["verdict"]]
    return dict(session)


@pytest.mark.parametrize("ending", ["log", pytest.param("blf", marks=pytest.mark.long), "asc"])
def test_a_log_in_parts_replays_as_the_run_it_was(
    ending: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As a folder, as files in order; a missing part is noticed."""
    target = str(tmp_path / f"run.{ending}")
    shifts, size = {"log": ("1", "150kB"), "blf": ("2", "80kB"), "asc": ("1", "250kB")}[ending]
    assert main(["simulate", "--shifts", shifts, "--log", target, "--log-size", size]) == 0
    capsys.readouterr()
    files = log_files([tmp_path])
    assert len(files) >= 3
    whole = replay([tmp_path], capsys)
    assert whole["verdict"] == "identical"
    assert replay(files, capsys) == whole
    holed = replay([files[0], *files[2:]], capsys)
    assert holed["verdict"] == "not verifiable"


@pytest.mark.long
def test_a_killed_simulation_leaves_a_log_that_replays_to_its_end(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    process = meshpoint("simulate", "--shifts", "100000", "--log", f"{tmp_path}/")
    try:
        wait_for_bytes(tmp_path, 1_000_000)
    finally:
        kill(process)
    session = replay([tmp_path], capsys)
    assert identical_until_cut(session), session["reason"]
    (log,) = log_files([tmp_path])
    times = [time_s for time_s, _ in read_until_cut(read_log(log))]
    assert times == sorted(times)
    assert times[-1] > 2.0


def heard_now(channel: str) -> Frame:
    """A frame that is on the bus right now."""
    with MeshpointBus(channel, start_hub=False) as listener:
        message = listener.recv(HANG_S)
    assert message is not None
    return frame_of(message)


def holds(log: Path, frame: Frame) -> bool:
    """Whether a log that is still being written has this frame."""
    try:
        return any(one == frame for _, one in read_log(log))
    except LogError:
        return False  # read in the middle of a flush


def steps_in(parts: Path) -> int:
    """How many steps of the controller the logs that are still being written tell of."""
    steps = 0
    for log in log_files([parts]):
        with contextlib.suppress(LogError):
            steps += sum(one.can_id == STATUS.spec.can_id for _, one in read_log(log))
    return steps


@pytest.mark.long
def test_killed_nodes_leave_logs_that_were_brought_up_to_date_meanwhile(
    tmp_path: Path, channel: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both record the bus. The controller's log begins before its first step, so it repeats it."""
    parts, blf = tmp_path / "parts", tmp_path / "rig.blf"
    parts.mkdir()
    bus = ["-i", "meshpoint", "-c", channel]
    rig = meshpoint("rig", *bus, "--log", str(blf))
    controller = meshpoint("controller", *bus, "--log", f"{parts}/", "--log-size", "300kB")
    try:
        wait_for_bytes(parts, 350_000)
        until(lambda: steps_in(parts) > 60, "60 steps of the controller", poll_s=0.5)
        frame = heard_now(channel)
        # Nobody ends the logs: what comes into them now, comes by itself.
        until(lambda: holds(blf, frame), "a frame of now in the rig's log", poll_s=0.5)
        until(
            lambda: any(holds(part, frame) for part in log_files([parts])[-2:]),
            "the same frame in the controller's",
            poll_s=0.5,
        )
    finally:
        kill(controller)
        kill(rig)
    assert frame in [one for _, one in read_until_cut(read_log(blf))]
    assert len(log_files([parts])) >= 2
    session = replay([parts], capsys)
    assert identical_until_cut(session), session["reason"]
    assert int(str(session["steps"])) > 50


def test_a_size_without_a_log_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "--shifts", "1", "--log-size", "10MB"]) == 2
    assert "--log" in capsys.readouterr().err
    for size in ("10", "10XB", "-1MB", "9GiB", "٣MB"):
        with pytest.raises(SystemExit) as stop:
            main(["simulate", "--log", "run.log", f"--log-size={size}"])
        assert stop.value.code == 2
        assert "64KiB" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
