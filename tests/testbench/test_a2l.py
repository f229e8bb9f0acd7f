"""`meshpoint a2l`: a file that other tools read, of exactly this version."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from meshpoint.base.version import product_version
from meshpoint.bridges.a2l_module import a2l
from meshpoint.cli.main import main
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.layout import CODECS
from meshpoint.xcp.memory import PAGE_ADDRESS, PARAMETERS, ROW_BYTES, identity

CHECKER = Path(sys.executable).with_name("a2ltool")
TEXT = a2l(product_version())


def block_of(kind: str, name: str) -> str:
    found = re.search(rf"/begin {kind} {re.escape(name)} .*?/end {kind}", TEXT, re.DOTALL)
    assert found is not None, name
    return found[0]


def test_another_tool_finds_no_fault_in_it(tmp_path: Path) -> None:
    path = tmp_path / "controller.a2l"
    assert main(["a2l", "-o", str(path)]) == 0
    done = subprocess.run(
        [CHECKER, "--check", "--strict", path], capture_output=True, text=True, check=False
    )
    assert (done.returncode, "No problems found" in done.stdout) == (0, True), done.stdout
    assert path.read_text("utf-8") == TEXT


def test_the_tool_does_find_faults(tmp_path: Path) -> None:
    path = tmp_path / "controller.a2l"
    path.write_text(TEXT.replace("RECORD_LAYOUT whole_value", "RECORD_LAYOUT other"), "utf-8")
    done = subprocess.run(
        [CHECKER, "--check", "--strict", path], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1


@pytest.mark.parametrize("by_standard", [False, True], ids=["own_grammar", "standards_grammar"])
@pytest.mark.parametrize("is_wrong", [False, True])
def test_how_to_reach_the_controller_is_said_as_the_grammar_has_it(
    by_standard: bool, is_wrong: bool, tmp_path: Path
) -> None:
    """The tool removes an IF_DATA block that does not fit the grammar: ours, or the standard's,
    which it brings."""
    text = TEXT.replace("UNIT_1US TIMESTAMP_FIXED", "UNIT_1Y") if is_wrong else TEXT
    assert is_wrong == (text != TEXT)
    path, cleaned = tmp_path / "controller.a2l", tmp_path / "cleaned.a2l"
    if by_standard:
        text = re.sub("/begin A2ML.*?/end A2ML", "", text, flags=re.DOTALL)
    path.write_text(text, "utf-8")
    insert = ["--insert-a2ml"] if by_standard else []
    subprocess.run([CHECKER, *insert, path, "-o", path], check=True)
    subprocess.run([CHECKER, "--ifdata-cleanup", path, "-o", cleaned], check=True)
    left = cleaned.read_text("utf-8").count("/begin IF_DATA XCP")
    assert left == (1 if is_wrong else 2), "of the module, and of the pages' segment"


def test_a_setting_has_its_limits_its_unit_and_its_address() -> None:
    aim = block_of("CHARACTERISTIC", "window.aim_slip_rpm")
    (row,) = (i for i, each in enumerate(PARAMETERS) if each.name == "window.aim_slip_rpm")
    address = f"0x{PAGE_ADDRESS + ROW_BYTES * row:08X}"
    conversion = re.search(rf"VALUE {address} single_value 0 (\w+) 1 200", aim)
    assert conversion is not None, aim
    assert '"rpm"' in block_of("COMPU_METHOD", conversion[1])
    assert "target_phase releases the brake" in aim


def test_every_setting_between_shifts_is_in_it_and_no_limit_of_the_guard() -> None:
    named = re.findall(r"/begin CHARACTERISTIC (\S+)", TEXT)
    assert sorted(named) == sorted(each.name for each in PARAMETERS)
    assert "limits.blocks" in named
    assert not [name for name in named if name.startswith("guard.") or "valve_on" in name]
    for each in PARAMETERS:
        assert each.rule.low <= each.of(ControllerSettings()) <= each.rule.high


def test_a_flag_is_one_bit_of_its_message() -> None:
    spec = CODECS["ControllerEstimates"].spec
    (flag,) = (signal for signal in spec.signals if signal.name == "MainValid")
    mask = 1 << flag.start_bit % 8
    assert f"BIT_MASK 0x{mask:X}" in block_of("MEASUREMENT", "ControllerEstimates.MainValid")


def test_a_state_has_words() -> None:
    state = block_of("MEASUREMENT", "ControllerStatus.State")
    table = re.search(r"UBYTE (\w+) ", state)
    assert table is not None
    assert '"HALTED"' in block_of("COMPU_VTAB", f"{table[1]}_words").upper()


def test_a_learned_figure_says_what_it_is() -> None:
    text = block_of("MEASUREMENT", "learned.noise.torque_nm")
    assert "Standard deviation of the torques at the layshaft that its model leaves out." in text


def test_another_version_has_another_name() -> None:
    assert f'EPK "{identity(product_version())}"' in TEXT
    assert identity("0.0.1") != identity(product_version())


def test_a_wrong_name_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["a2l", "-o", "controller.txt"]) == 2
    assert "allowed is .a2l" in capsys.readouterr().err


def test_a_folder_that_is_not_there_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["a2l", "-o", str(tmp_path / "no" / "x.a2l")]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_no_name_is_a_word_that_readers_keep_for_types() -> None:
    """pya2l reads a record layout's name `float` as a type."""
    names = re.findall(r"/begin (?:RECORD_LAYOUT|COMPU_METHOD|COMPU_VTAB|GROUP) (\S+)", TEXT)
    assert not {name.lower() for name in names} & {"float", "double", "int", "long", "char", "uint"}
