"""The example of docs/calibration.md: pyxcp tunes a controller that runs as a process of its own,
and the log of it is repeated."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from live_command import ROOT, live

from meshpoint.cli.main import main

AIM = "window.aim_slip_rpm"


def tune(folder: Path, channel: str, *words: str) -> str:
    command = [sys.executable, ROOT / "examples" / "xcp_tune.py", "meshpoint.a2l", *words]
    command += ["-c", channel]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.strip().splitlines()[-1]


def test_a_setting_is_tuned_from_a_shell_and_the_log_is_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    channel = f"unix:{tmp_path / 'bus.sock'}"
    assert main(["a2l"]) == 0
    given = ["--xcp", "write", "--log", "run.log", "--header-dir", ".", "-c", channel]
    with live(tmp_path, "up", *given) as up:
        up.until_said("ready for requests")
        assert tune(tmp_path, channel, AIM, "24") == f"{AIM} = 18, now 24"
        assert "OUT_OF_RANGE" in tune(tmp_path, channel, AIM, "240")
        up.until_said(f"XCP: {AIM} 18 -> 24")
        assert tune(tmp_path, channel, "limits.attempts", "4") == "limits.attempts = 3, now 4"
        assert main(["request", "10", "-c", channel]) == 0
        up.signal(signal.SIGINT)
        assert up.end() == 0
    assert main(["replay", "run.log", "--verify"]) == 0
    said = capsys.readouterr().out
    assert "identical" in said
    assert "foreign" not in said


@pytest.mark.parametrize("command", ["controller", "up"])
def test_the_classic_profile_has_no_xcp(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command, "--xcp", "--profile", "classic"]) == 2
    assert "--xcp: allowed with --profile fd alone" in capsys.readouterr().err
