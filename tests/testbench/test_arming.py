"""Who arms a controller: --arm, else its settings, else the local bus alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from meshpoint.cli import arguments
from meshpoint.cli.table import build_parser

LOCAL = ""
REAL = "-i kvaser -c 0"


@pytest.fixture(autouse=True)
def nothing_configured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_BITRATE", "CAN_CONFIG"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("can.util.CONFIG_FILES", [str(tmp_path / "can.conf")])
    monkeypatch.setattr("can.rc", {})


@pytest.mark.parametrize("command", ["controller", "up"])
@pytest.mark.parametrize(
    ("bus", "option", "settings", "armed"),
    [
        (LOCAL, "", None, True),
        (LOCAL, "", "false", False),
        (LOCAL, "--no-arm", "true", False),
        (LOCAL, "--arm", "false", True),
        (REAL, "", None, False),
        (REAL, "", "true", True),
        (REAL, "--arm", None, True),
        (REAL, "--arm", "false", True),
        (REAL, "--no-arm", "true", False),
    ],
)
def test_a_real_bus_is_never_armed_by_itself(
    tmp_path: Path, command: str, bus: str, option: str, settings: str | None, armed: bool
) -> None:
    words = [command, *bus.split(), *option.split()]
    if settings is not None:
        path = tmp_path / "own.toml"
        path.write_text(f"[outputs]\narmed = {settings}\n")
        words += ["--settings", str(path)]
    assert arguments.armed_of(build_parser(command).parse_args(words)) is armed
