"""The node: expiry, bad input, the clock, shutdown, an hour in gear."""

from __future__ import annotations

import ast
import itertools
import math
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rig_bench import SHEET, RigBench, edges_of, thesis_rig, upshift

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import (
    ClutchAction,
    ClutchCommand,
    EdgesInputFall,
    EdgesLayshaftRise,
    GearboxSensors,
    ValveAction,
    ValveCommand,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox.gears import MainGear
from meshpoint.rig_sim import RigCore, SettingsError
from meshpoint.rig_sim.shared import angle_kernels
from meshpoint.rig_sim.thesis import closed_form as kernels
from meshpoint.rig_sim.thesis.world import World

VALVE_COMMAND_ID = Transmitter(Node.TRANSMISSION_CONTROL).encode(ValveCommand()).can_id


def test_the_valves_expire_100_ms_after_the_last_frame() -> None:
    bench = RigBench()
    on = ValveCommand(brake_action=ValveAction.ON_NOW)
    bench.run(303_000, lambda now_us: on)  # the last command is consumed at 300 ms
    for now_us, driven in ((399_999, True), (400_000, False)):
        bench.step(now_us)
        assert bench.world.valves.energised[0] is driven
    bench.step(430_000)
    assert bench.of(ValveStatus)[-1].expired_count == 1
    assert not bench.of(ValveStatus)[-1].brake_energised
    said = [line for line in bench.lines if "no valve command" in line]
    assert said == ["0.400000 s since its start: no valve command for 100 ms: all valves off"]


def test_the_clutch_moves_linearly_and_opens_by_itself() -> None:
    bench = RigBench()
    bench.step(0)
    while bench.now_us < 600_000:
        bench.send(ClutchCommand(action=ClutchAction.CLOSE))
        bench.step(bench.now_us + 10_000)
    assert bench.of(GearboxSensors)[-1].clutch_position_fraction == 1.0
    bench.step(800_000)
    positions = [sample.clutch_position_fraction for sample in bench.of(GearboxSensors)]
    # the last command was consumed at 600 ms; at 700 ms it opens, over 80 ms
    assert positions[70:80] == pytest.approx(
        [max(1.0 - ms / 80.0, 0.0) for ms in range(0, 100, 10)], abs=1e-4
    )


@settings(max_examples=30, deadline=None)
@given(
    st.lists(
        st.builds(
            Frame,
            st.one_of(st.integers(0, (1 << 29) - 1), st.just(VALVE_COMMAND_ID)),
            st.binary(max_size=64),
            st.booleans(),
            st.booleans(),
        ),
        max_size=20,
    )
)
def test_no_frame_whatever_stops_the_rig_or_moves_it(frames: list[Frame]) -> None:
    core, twin = RigCore(SHEET, thesis_rig()), RigCore(SHEET, thesis_rig())
    for now_us in range(0, 200_001, 10_000):
        for frame in frames:
            core.receive(frame)
        assert core.step(now_us).frames == twin.step(now_us).frames
    receiver = core.receiver
    counted = receiver.e2e_errors + receiver.format_errors + receiver.foreign_frames
    assert counted <= 21 * len(frames)


def test_a_corrupted_valve_command_is_counted_and_not_obeyed() -> None:
    bench = RigBench()
    bench.run(200_000)
    command = bench.control.encode(ValveCommand(brake_action=ValveAction.ON_NOW))
    broken = bytes([*command.data[:-1], command.data[-1] ^ 1])
    bench.core.receive(command._replace(data=broken))
    bench.step(201_000)
    assert bench.core.receiver.e2e_errors == 1
    assert not any(bench.world.valves.energised)


def test_it_asks_for_a_step_at_once_when_a_frame_has_come() -> None:
    bench = RigBench()
    assert bench.core.next_step_us <= 0
    bench.step(5_000)
    assert bench.core.next_step_us == 15_000
    bench.send(ValveCommand())
    assert bench.core.next_step_us <= 5_000
    bench.step(6_000)
    assert bench.core.next_step_us == 15_000


def test_power_up_is_the_first_step_whatever_the_drivers_clock_says() -> None:
    early, late = RigCore(SHEET, thesis_rig()), RigCore(SHEET, thesis_rig())
    for now_us in range(0, 300_001, 10_000):
        assert early.step(now_us).frames == late.step(now_us + 123_456_789_012).frames


def test_shutdown_switches_everything_off_and_says_so() -> None:
    bench = RigBench()
    on = ValveCommand(brake_action=ValveAction.ON_NOW)
    bench.run(200_000, lambda now_us: on)
    frames, _ = bench.core.shutdown(205_000)
    received = bench.ears.receive(frames[-1]).message
    assert isinstance(received, ValveStatus)
    assert not received.brake_energised
    assert not any(bench.world.valves.energised)


def test_in_an_hour_in_gear_the_phase_stays_exact_and_no_tooth_is_lost() -> None:
    world = World(SHEET, thesis_rig(seed=13))
    start_main = world.shafts.main
    start_layshaft = world.shafts.layshaft
    phase = world.shafts.phase_rad(MainGear.FIRST)
    while world.next_read_us <= 3_600_000_000:
        world.run_to(world.next_read_us)
        world.encoder.read(world.next_read_us)
        world._read_us += 9_990_000  # read every 10 s: nothing else happens
    assert abs(phase) == SHEET.dog.backlash_rad / 2
    world.plant.coast()  # from here on the phase is worked out from the two angles
    assert abs(world.shafts.phase_rad(MainGear.FIRST) - phase) < 1e-12

    main = world.shafts.main[0] - start_main[0] + (world.shafts.main[1] - start_main[1]) / math.tau
    assert main == pytest.approx(644.0 * 60.0, abs=1e-8)
    turned = world.shafts.layshaft[0] - start_layshaft[0]
    turned_rest = (world.shafts.layshaft[1] - start_layshaft[1]) / math.tau
    # the layshaft's turns are the main shaft's times 50/23, exactly
    whole = (world.shafts.main[0] - start_main[0]) * SHEET.main.first.driven
    rest = (world.shafts.main[1] - start_main[1]) / math.tau * SHEET.main.first.driven
    error = (whole - turned * SHEET.main.first.driving) + (
        rest - turned_rest * SHEET.main.first.driving
    )
    assert abs(error) < 1e-11


def test_settings_that_cannot_be_used_are_named() -> None:
    for wrong, key in (
        ({"start_gear": 0}, "start_gear"),
        ({"start_gear": 15}, "start_gear"),
        ({"seed": -1}, "seed"),
        ({"main_speed_rpm": math.nan}, "main_speed_rpm"),
        ({"main_speed_rpm": 5001.0}, "main_speed_rpm"),
        ({"clock_start_us": 1 << 32}, "clock_start_us"),
    ):
        with pytest.raises(SettingsError, match=key):
            thesis_rig(**wrong)  # type: ignore[arg-type]


def test_everything_is_compiled_before_the_first_step() -> None:
    both = {**vars(kernels), **vars(angle_kernels)}
    dispatchers = [k for k in both.values() if hasattr(k, "signatures")]
    if not dispatchers:
        pytest.skip("kernels run as plain Python")
    kernels.warm_up()
    angle_kernels.warm_up()
    before = [len(kernel.signatures) for kernel in dispatchers]
    bench = RigBench(thesis_rig(seed=2))
    bench.run(1_200_000, upshift)
    bench.return_to_gear(7, 1)
    bench.run(2_000_000)
    assert [len(kernel.signatures) for kernel in dispatchers] == before


SHIFT_WITHOUT_COMPILER = """
import sys
sys.path[:0] = sys.argv[1:]
from meshpoint.bus.light_can import load_can
load_can()
from rig_bench import RigBench, edges_of, thesis_rig, upshift
from meshpoint.dbc.messages import EdgesLayshaftRise, EdgesInputFall
bench = RigBench(thesis_rig(seed=2))
bench.run(500_000, upshift)
print([sorted(edges_of(bench.of(kind)).items()) for kind in (EdgesLayshaftRise, EdgesInputFall)])
"""


def test_the_kernels_give_the_same_edges_without_the_compiler() -> None:
    here = Path(__file__).parent
    run = subprocess.run(
        [sys.executable, "-c", SHIFT_WITHOUT_COMPILER, str(here), str(here.parents[1])],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    bench = RigBench(thesis_rig(seed=2))
    bench.run(500_000, upshift)
    for kind, plain in zip(
        (EdgesLayshaftRise, EdgesInputFall), ast.literal_eval(run.stdout), strict=True
    ):
        compiled = edges_of(bench.of(kind))
        assert len(plain) == len(compiled) > 300
        # 1 ns apart may fall on either side of a microsecond
        assert all(abs(compiled[index] - time_us) <= 1 for index, time_us in plain)
        assert sum(compiled[index] != time_us for index, time_us in plain) <= 2


def test_another_sender_of_the_commands_is_named_once_a_second() -> None:
    """One bad frame for every good one: the rig obeys none, and said nothing."""
    bench = RigBench()
    for now_us in range(0, 2_500_000, 10_000):
        bench.send(ValveCommand())
        bad = Transmitter(Node.TRANSMISSION_CONTROL).encode(ValveCommand())
        bench.core.receive(bad._replace(data=bytes([bad.data[0] ^ 1]) + bad.data[1:]))
        bench.step(now_us)
    said = [line for line in bench.lines if "another node sends it too" in line]
    assert len(said) == 3
    assert said[0].startswith("0.000000 s 1 x ValveCommand (0x0CFF4003)")
    assert said[1].startswith("1.000000 s 100 x ValveCommand")


def commanded(frames: Iterator[list[Frame]]) -> list[str]:
    """What the rig says of command frames that come each 10 ms for 2.5 s."""
    bench = RigBench()
    for now_us in range(0, 2_500_000, 10_000):
        for frame in next(frames):
            bench.core.receive(frame)
        bench.step(now_us)
    return bench.lines


def of_one_sender(restarted: int | None = None) -> Iterator[Frame]:
    """Valve commands with valid protection, whose counter begins anew once."""
    for k in itertools.count():
        if k in (0, restarted):
            sender = Transmitter(Node.TRANSMISSION_CONTROL)
        yield sender.encode(ValveCommand())


def test_lost_commands_are_called_lost_and_not_another_senders() -> None:
    """Of 20 frames, three in a row do not arrive: more than the counter's check lets pass."""
    lossy = ([] if k % 20 in (7, 8, 9) else [frame] for k, frame in enumerate(of_one_sender()))
    said = [line for line in commanded(lossy) if "ValveCommand" in line]
    assert said and all("frames were lost" in line for line in said)
    assert "1 x ValveCommand (0x0CFF4003)" in said[0] and "5 x ValveCommand" in said[1]


def test_a_controller_that_starts_anew_is_not_called_another() -> None:
    said = commanded([frame] for frame in of_one_sender(restarted=100))
    assert [line for line in said if "its sender began anew" in line]
    assert not [line for line in said if "another node" in line]


def test_two_controllers_in_turn_are_called_so() -> None:
    """Each by itself is faultless."""
    other = of_one_sender()
    for _ in range(100):
        next(other)
    said = commanded([frame, next(other)] for frame in of_one_sender())
    assert [line for line in said if "another node sends it too" in line]
    assert not [line for line in said if "lost" in line]


def test_a_bus_without_strangers_is_not_suspected() -> None:
    bench = RigBench()
    bench.run(1_500_000)
    assert not [line for line in bench.lines if "another node" in line]
