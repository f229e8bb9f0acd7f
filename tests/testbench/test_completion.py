"""`meshpoint help completion`: what bash offers at each place of a command line."""

from __future__ import annotations

import contextlib
import io
import subprocess
from pathlib import Path

import pytest

from meshpoint.cli.main import main
from meshpoint.cli.table import COMMANDS
from meshpoint.controller.settings.settings import STRATEGY_NAMES
from meshpoint.gearbox.sheet import SHEET_NAMES
from meshpoint.rig_sim.settings import Profile


@pytest.fixture(scope="module")
def scripts() -> dict[str, str]:
    found = {}
    for shell in ("bash", "zsh", "fish"):
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            assert main(["help", "completion", shell]) == 0
        found[shell] = printed.getvalue()
    return found


CASES = [
    (("sim",), ["simulate"]),
    (("",), sorted(COMMANDS)),
    (("--v",), ["--version"]),
    (("simulate", "--as"), ["--as-built"]),
    (("simulate", "--preset", ""), ["thesis", "truck"]),
    (("simulate", "--shifts", "3", "--bus-q"), ["--bus-queue"]),
    (("show", ""), ["calibration", "file.toml", "gearbox", "messages", "settings"]),
    (("simulate", "--settings", ""), ["file.toml"]),
    (("help", "completion", "f"), ["fish"]),
    (("help", "b"), ["bus"]),
    (("rig", "--gearbox", ""), ["file.toml", *sorted(SHEET_NAMES)]),
    (("replay", "--gearbox", "t"), sorted(SHEET_NAMES)),
    (("demo", "--as-built", ""), sorted(("file.toml", *Profile))),
    (("controller", "--strategy", "target"), ["target_phase"]),
    (("campaign", "--strategy", ""), sorted(("file.toml", *STRATEGY_NAMES))),
]


def test_bash_offers_what_may_stand_there(tmp_path: Path, scripts: dict[str, str]) -> None:
    (tmp_path / "file.toml").touch()
    lines = [scripts["bash"]]
    for words, _ in CASES:
        quoted = " ".join(f"'{word}'" for word in ("meshpoint", *words))
        lines += [f"COMP_WORDS=({quoted})", f"COMP_CWORD={len(words)}", "_meshpoint"]
        lines.append('echo "${COMPREPLY[@]}"')
    ran = subprocess.run(
        ["bash", "-u", "-c", "\n".join(lines)],
        capture_output=True, text=True, cwd=tmp_path, check=True,
    )  # fmt: skip
    assert ran.stderr == ""
    offered = [sorted(line.split()) for line in ran.stdout.splitlines()]
    assert offered == [expected for _, expected in CASES]


def test_zsh_takes_the_script_of_bash(scripts: dict[str, str]) -> None:
    assert scripts["zsh"].endswith(scripts["bash"])
    assert "bashcompinit" in scripts["zsh"]


def test_fish_has_every_command_and_option(scripts: dict[str, str]) -> None:
    lines = scripts["fish"].splitlines()
    for name in COMMANDS:
        assert any(f"-a {name} -d '" in line for line in lines), name
    simulate = [line for line in lines if "from simulate'" in line]
    assert any(line.endswith("-l preset -xa 'thesis truck'") for line in simulate)
    assert any(line.endswith("-l settings -r") for line in simulate)
    assert any(line.endswith("-l as-built -ra 'clean typical harsh'") for line in simulate)
    assert any(line.endswith(f"-l gearbox -ra '{' '.join(SHEET_NAMES)}'") for line in simulate)
    assert any(line.endswith(f"-l strategy -ra '{' '.join(STRATEGY_NAMES)}'") for line in simulate)
