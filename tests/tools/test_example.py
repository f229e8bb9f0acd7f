"""examples/vcan.sh with a meshpoint made of a small script: what it starts, ends and answers.

With the real one it needs a vcan0: `examples/vcan.sh` is to be run for that.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from toolbox import Machine
from vcan_machine import vcan_machine

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="SocketCAN, and so the example, is Linux's"
)

UNTIL_TERM = """trap 'exit 0' TERM; : >"$FACTS/ready$1"; while :; do sleep 0.05; done"""
MESHPOINT = f"""case "$1 $2" in
'controller --help') [ -e "$FACTS/arming" ] && echo '  --arm  drive the valves'; exit 0 ;;
'up --pace-only') : >"$3"; {UNTIL_TERM} ;;
rig*) {UNTIL_TERM} ;;
controller*)
    [ -e "$FACTS/dies" ] && exit 1
    {UNTIL_TERM.replace("exit 0", 'echo ended >>"$FACTS/ended"; exit 0')} ;;
request*)
    # A controller answers once it and the rig are at work.
    for one in -D up rig controller; do
        until [ -e "$FACTS/ready$one" ]; do sleep 0.05; done
    done
    exit "$(cat "$FACTS/request")" ;;
replay*) [ -s "$2" ] && exit "$(cat "$FACTS/replay")" ;;
esac"""


@pytest.fixture
def bench(tmp_path: Path) -> Machine:
    """Root's machine whose kernel has vcan; gears are engaged and logs identical."""
    machine = vcan_machine(tmp_path, user="root", system="debian")
    machine.fact("vcan")
    machine.fact("request", "0")
    machine.fact("replay", "0")
    machine.program("meshpoint", MESHPOINT)
    machine.program("candump", f"echo '(1.0) vcan0 123#11'; {UNTIL_TERM}")
    return machine


def started(machine: Machine, name: str) -> str:
    """How a meshpoint command was started, once."""
    [call] = [call for call in machine.called(f"meshpoint {name}") if "--help" not in call]
    return call


def test_a_shift_is_made_recorded_and_verified(bench: Machine) -> None:
    done = bench.run("examples/vcan.sh", "10", "out")
    assert done.returncode == 0, done.stderr
    assert "this takes about a minute" in done.stderr
    assert "1 frames recorded" in done.stderr
    assert started(bench, "request").startswith("meshpoint request 10 ")
    assert started(bench, "replay") == "meshpoint replay out/run.log --verify"
    for node in ("rig", "controller"):
        assert "--pace bus.time --speed 1 -i socketcan -c vcan0 --fd" in started(bench, node)
    assert (bench.facts / "ended").read_text() == "ended\n"


@pytest.mark.parametrize("asked", [False, True])
def test_the_controller_is_armed_where_it_asks_for_it(bench: Machine, asked: bool) -> None:
    if asked:
        bench.fact("arming")
    assert bench.run("examples/vcan.sh").returncode == 0
    assert ("--arm" in started(bench, "controller")) == asked


def test_a_node_that_dies_is_not_waited_for(bench: Machine) -> None:
    bench.fact("dies")
    done = bench.run("examples/vcan.sh")
    assert done.returncode == 1
    assert "a node ended with exit code 1 before the gear was engaged" in done.stderr
    assert not bench.called("meshpoint replay")


@pytest.mark.parametrize(("fact", "code"), [("request", 1), ("replay", 1), ("replay", 3)])
def test_what_failed_is_not_passed(bench: Machine, fact: str, code: int) -> None:
    bench.fact(fact, str(code))
    assert bench.run("examples/vcan.sh").returncode == code
    assert (bench.facts / "ended").exists()


@pytest.mark.parametrize("arguments", [["15"], ["0"], ["four"], ["4", "out", "more"]])
def test_wrong_arguments_are_refused(bench: Machine, arguments: list[str]) -> None:
    done = bench.run("examples/vcan.sh", *arguments)
    assert done.returncode == 2
    assert "GEAR 1 to 14" in done.stderr


def test_without_a_vcan0_it_says_why(bench: Machine) -> None:
    (bench.facts / "vcan").unlink()
    done = bench.run("examples/vcan.sh")
    assert done.returncode == 3
    assert "impossible: " in done.stderr
    assert not bench.called("meshpoint rig")
