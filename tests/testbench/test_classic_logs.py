"""Logs of the classic profile told, watched and checked."""

from __future__ import annotations

from pathlib import Path

import pytest

from meshpoint.bus.classic.cores import ClassicRigCore, listener_unpacker
from meshpoint.bus.frames import message_of
from meshpoint.bus.profile import WireProfile
from meshpoint.campaigns.draw import draw, upshifts
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.cli.main import main
from meshpoint.commission.finding import Verdict
from meshpoint.commission.listener import Listener
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import Preset, RigSettings

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


def test_it_is_reported_with_valves_and_outcome(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["tell", str(log), "--profile", "classic", "--gearbox", "truck12"]) == 0
    reported = capsys.readouterr().out
    assert "asks for gear" in reported
    assert "valve main_" in reported
    assert "is in:" in reported


def test_without_the_profile_nothing_of_valves_is_reported(
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


def test_its_contacts_are_reported_and_what_cannot_be_decided_is_said(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["replay", "--gap-rate", str(log), "--gearbox", "truck12"]
    assert main([*words, "--profile", "classic"]) == 0
    reported = " ".join(capsys.readouterr().out.split())
    assert "met the gap in" in reported
    assert "of 1 (" in reported
    assert "not decidable" in reported
    assert "classic" in reported
    assert main(words) != 0
    assert "--profile classic" in " ".join(capsys.readouterr().err.split())


def heard(turns: bool) -> Listener:
    """Four seconds of a rig on a classic bus."""
    rpm = 600.0 if turns else 0.0
    rig = RigCore(SHEET, RigSettings(preset=Preset.THESIS, seed=1, main_speed_rpm=rpm))
    core = ClassicRigCore(rig, SHEET)
    listener = Listener(SHEET, listener_unpacker(SHEET).take)
    for tick in range(400):
        now_us = tick * 10_000
        for frame in core.step(now_us).frames:
            listener.take(now_us * 1e-6, message_of(frame, now_us * 1e-6, received=True))
    return listener


def test_a_check_finds_all_that_a_classic_bus_has() -> None:
    findings = {finding.subject: finding for finding in heard(turns=True).findings()}
    bad = [finding for finding in findings.values() if finding.verdict is Verdict.BAD]
    assert not [finding for finding in bad if finding.group != "stamps"]
    assert findings["EEC1"].text.startswith("50")
    assert findings["layshaft sensor"].verdict is Verdict.GOOD
    assert "falling" not in findings["layshaft sensor"].text
    assert "input sensor" not in findings
    assert not [name for name in findings if name.endswith("Fall")]
    (pair,) = [finding for name, finding in findings.items() if " to " in name]
    assert pair.verdict is Verdict.GOOD


def test_a_check_of_shafts_that_stand_says_that_they_were_not_turned() -> None:
    findings = {finding.subject: finding for finding in heard(turns=False).findings()}
    assert findings["main sensor"].verdict is Verdict.UNKNOWN


def test_a_shaft_without_edges_on_the_bus_cannot_be_asked_for(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["check", "--profile", "classic", "--turn", "input", "-i", "virtual", "-c", "x"]
    assert main([*words, "--gearbox", "truck12"]) != 0
    assert "no edges" in " ".join(capsys.readouterr().err.split())


def test_a_commissioning_over_it_is_refused_with_the_way(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["commission", "--profile", "classic", "--drawn", "1"]) != 0
    reported = " ".join(capsys.readouterr().err.split())
    assert "two shafts alone" in reported
    assert "over CAN FD" in reported
