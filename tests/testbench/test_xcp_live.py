"""The example of docs/calibration.md: pyxcp tunes a controller that runs as a process of its own,
and the log of it is repeated."""

from __future__ import annotations

import runpy
import signal
import subprocess
import sys
from pathlib import Path

import can
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from live_command import ROOT, live

from meshpoint.cli.main import main

AIM = "window.aim_slip_rpm"


EXAMPLE = ROOT / "examples" / "xcp_tune.py"


def tuned_from_a_shell(channel: str, *words: str) -> str:
    command = [sys.executable, EXAMPLE, "meshpoint.a2l", *words, "-c", channel]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return done.stdout.strip().splitlines()[-1]


def tuned(channel: str, name: str, wanted: float) -> str:
    """The same in this process: it has loaded by then what the example takes seconds to load."""
    tune = runpy.run_path(str(EXAMPLE))["tune"]
    with can.Bus(channel, interface="meshpoint", fd=True) as bus:
        return str(tune(Path("meshpoint.a2l").read_text("utf-8"), name, wanted, bus))


def test_a_setting_is_tuned_from_a_shell_and_the_log_is_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    channel = f"unix:{tmp_path / 'bus.sock'}"
    assert main(["a2l"]) == 0
    given = ["--xcp", "write", "--log", "run.log", "--header-dir", ".", "-c", channel]
    with live(tmp_path, "up", *given) as up:
        up.until_said("ready for requests")
        assert tuned_from_a_shell(channel, AIM, "24") == f"{AIM} = 18, now 24"
        assert "OUT_OF_RANGE" in tuned(channel, AIM, 240.0)
        up.until_said(f"XCP: {AIM} 18 -> 24")
        assert tuned(channel, "limits.attempts", 4.0) == "limits.attempts = 3, now 4"
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
