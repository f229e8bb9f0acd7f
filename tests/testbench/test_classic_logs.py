"""A log of the classic profile, told and watched."""

from __future__ import annotations

from pathlib import Path

import pytest

from meshpoint.bus.profile import WireProfile
from meshpoint.controller.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset
from meshpoint.testbench.campaign.draw import draw, upshifts
from meshpoint.testbench.campaign.loop import ClosedLoop
from meshpoint.testbench.cli import main

SHEET = load_sheet("truck12")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One shift on a classic bus, as candump writes it."""
    drawn = draw(3, SHEET, Preset.THESIS, upshifts(), 1, {})
    loop = ClosedLoop(
        SHEET, ControllerSettings(), Preset.THESIS, drawn, log=[], wire=WireProfile.CLASSIC
    )
    assert loop.shift() is not None
    assert loop.log is not None
    assert not any(frame.is_fd for _, frame in loop.log)
    path = tmp_path_factory.mktemp("classic") / "bus.log"
    path.write_text(
        "".join(
            f"({time_us / 1e6:.6f}) can0 {frame.can_id:08X}#{frame.data.hex().upper()}\n"
            for time_us, frame in loop.log
        )
    )
    return path


def test_it_is_told_with_valves_and_outcome(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tell", str(log), "--profile", "classic", "--gearbox", "truck12"]) == 0
    told = capsys.readouterr().out
    assert "asks for gear" in told
    assert "valve main_" in told
    assert "is in:" in told


def test_without_the_profile_nothing_of_valves_is_told(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["tell", str(log), "--gearbox", "truck12"]) == 0
    assert "valve main_" not in capsys.readouterr().out


def test_it_is_watched(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["watch", str(log), "--profile", "classic", "--gearbox", "truck12", "--speed", "0"]
    assert main(words) == 0
    picture = capsys.readouterr().out
    assert "no sensor side heard" not in picture
    assert "foreign" not in picture
    assert "ValveCommand   1" in picture, "a rate of a hundred and more"
