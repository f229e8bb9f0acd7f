"""Steps are moved to where a read's frames have just come, wherever in the cycle they began."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.bench.virtual_time import VirtualTime
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.measure.clock import LONGER_US, MOST_MOVED_US, StepTiming
from meshpoint.controller.measure.inputs import StepInputs
from meshpoint.controller.settings.header import new_header
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.messages import EdgesInputRise
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import Preset, Profile, RigSettings

TICK_US = 10_000
START_US = 1 << 33
"""Of the sensor clock, which has wrapped by then."""


def steps(
    begin_us: int,
    cycle_us: int,
    first_us: int,
    last_us: int,
    jitter_us: int = 0,
    count: int = 600,
    tick_us: int = TICK_US,
) -> list[tuple[int, int | None]]:
    """Sensor times of this many steps, each with the age of the newest read that was whole. Frames
    come `first_us` to `last_us` after their read, and late by up to a jitter."""
    timing, rng = StepTiming(tick_us), np.random.default_rng(1)
    now_us, seen, found = START_US + begin_us, [0, 0], []
    late = rng.integers(0, jitter_us + 1, count * tick_us // cycle_us + 500)
    for _ in range(count):
        inputs: Any = StepInputs()
        for k, after_us in enumerate((first_us, last_us)):
            while True:
                read_us = START_US + seen[k] * cycle_us
                if read_us + after_us + int(late[seen[k]]) > now_us:
                    break
                stamp = read_us & 0xFFFFFFFF
                if k == 0:
                    inputs.edges[EdgesInputRise].append(SimpleNamespace(read_time_us=stamp))
                else:
                    inputs.sleeves_aux.append(SimpleNamespace(sample_time_us=stamp))
                seen[k] += 1
        timing.take(inputs, now_us)
        whole_us = START_US + (seen[1] - 1) * cycle_us
        found.append((now_us, now_us - whole_us if seen[1] else None))
        assert abs(timing.sooner_us) <= MOST_MOVED_US
        now_us += tick_us - timing.sooner_us
    return found


@settings(deadline=None, max_examples=60)
@given(
    begin_us=st.integers(0, TICK_US - 1),
    first_us=st.integers(100, 1_000),
    more_us=st.integers(0, 6_000),
    jitter_us=st.integers(0, 300),
    ppm=st.integers(-200, 200),
)
def test_steps_come_soon_after_the_last_frame_of_a_read(
    begin_us: int, first_us: int, more_us: int, jitter_us: int, ppm: int
) -> None:
    """By what is as old as the bus is slow, in all steps but some of a hundred, whatever the
    two clocks make of a tick."""
    cycle_us = TICK_US + ppm * TICK_US // 1_000_000
    last_us = first_us + more_us
    found = steps(begin_us, cycle_us, first_us, last_us, jitter_us)
    ages = np.array([age for _, age in found[100:] if age is not None])
    slack_us = 800 + 2 * jitter_us
    assert np.mean(ages < last_us + slack_us) > 0.94
    assert np.median(ages) <= last_us + slack_us / 2


@pytest.mark.parametrize("tick_us", [2_500, 5_000, 10_000])
@pytest.mark.parametrize("begin_us", [300, 4_100, 7_700])
def test_each_read_is_taken_soon_by_a_step_of_any_tick_that_fits_its_cycle(
    tick_us: int, begin_us: int
) -> None:
    """Of a shorter tick by one of the steps in a cycle: red before, where those of a tick of 5 ms
    stayed wherever they began, between the frames of a read or not."""
    last_us, count = 5_300, 1_500
    found = steps(begin_us, 10_000, 800, last_us, jitter_us=200, count=count, tick_us=tick_us)
    ages = [age for _, age in found[count // 2 :] if age is not None]
    each = 10_000 // tick_us
    freshest = [min(ages[k : k + each]) for k in range(0, len(ages) - each + 1, each)]
    assert np.mean(np.array(freshest) < last_us + 800) > 0.94


@pytest.mark.parametrize("tick_us", [3_000, 7_000, 20_000])
def test_steps_that_do_not_fit_the_cycle_stay_ticks(tick_us: int) -> None:
    found = steps(3_000, 10_000, 800, 5_300, tick_us=tick_us)
    assert np.all(np.diff([now_us for now_us, _ in found]) == tick_us)


def inputs_of(*read_us: int) -> Any:
    """The frames of these reads, all of them."""
    inputs: Any = StepInputs()
    for each in read_us:
        inputs.edges[EdgesInputRise].append(SimpleNamespace(read_time_us=each & 0xFFFFFFFF))
        inputs.sleeves_aux.append(SimpleNamespace(sample_time_us=each & 0xFFFFFFFF))
    return inputs


def steps_after(late: tuple[int, ...], between_every: int, count: int) -> list[int]:
    """Ages of the newest read at this many steps. A read's frames come after 800 us; the first
    reads come as late as given, and one step in `between_every` lies between two ticks and takes
    the frames of a read before the tick does."""
    timing, now_us, read, ages = StepTiming(TICK_US), START_US + 900, 0, []
    for k in range(count):
        came = []
        while now_us >= START_US + read * TICK_US + (late[read] if read < len(late) else 800):
            came.append(START_US + read * TICK_US)
            read += 1
        if between_every and k % between_every == 0:
            timing.between(inputs_of(*came), now_us - 50)
            came = []
        timing.take(inputs_of(*came), now_us)
        ages.append(now_us - (START_US + (read - 1) * TICK_US))
        now_us += TICK_US - timing.sooner_us
    return ages


@pytest.mark.parametrize("between_every", [0, 101, 20])
def test_after_a_time_of_late_frames_steps_come_soon_again(between_every: int) -> None:
    """Whatever steps between two ticks have taken: red before, where there was one a second steps
    came as late as they had once been for ever."""
    ages = steps_after((6_500,) * 300, between_every, 4_000)
    assert np.median(ages[250:300]) > 6_000
    assert np.median(ages[-200:]) < 1_300


def test_a_machine_that_stood_still_does_not_make_steps_wait() -> None:
    """What lay waiting then says of the machine, not of the bus: red before."""
    timing, now_us, read, ages = StepTiming(TICK_US), START_US + 900, 0, []
    for k in range(400):
        came = []
        while not 200 <= k < 203 and now_us >= START_US + read * TICK_US + 800:
            came.append(START_US + read * TICK_US)
            read += 1
        timing.take(inputs_of(*came), now_us)
        ages.append(now_us - (START_US + (read - 1) * TICK_US))
        now_us += TICK_US - timing.sooner_us
    assert max(ages[220:]) < 900 + 4 * LONGER_US


@pytest.mark.parametrize("cycle_us", [5_000, 7_300, 13_000])
def test_with_another_cycle_than_a_tick_steps_stay_ticks(cycle_us: int) -> None:
    found = steps(3_000, cycle_us, 10, 20)
    between = np.diff([now_us for now_us, _ in found])
    assert np.all(between == TICK_US)


def test_without_edges_steps_stay_ticks() -> None:
    timing = StepTiming(TICK_US)
    for k in range(20):
        timing.take(StepInputs(), START_US + k * TICK_US)
        assert timing.sooner_us == 0


@pytest.mark.parametrize(
    "begin_us",
    [9_700, *(pytest.param(each, marks=pytest.mark.check) for each in (0, 2_500, 5_000))],
)
def test_the_controller_s_edges_are_younger_than_six_milliseconds_on_the_bus(begin_us: int) -> None:
    """Both nodes over the virtual bus, on which a read's frames take 5.3 ms."""
    sheet = load_sheet("truck12")
    controller = ControllerCore(new_header("0", sheet, ControllerSettings()))
    rig = RigCore(sheet, RigSettings(preset=Preset.TRUCK, start_gear=8, profile=Profile.CLEAN))
    ages: list[float] = []

    class Watched:
        """The controller, whose edges' age is noted at each step."""

        next_step_us = property(lambda _: controller.next_step_us)
        receive = staticmethod(controller.receive)
        shutdown = staticmethod(controller.shutdown)

        @staticmethod
        def step(now_us: int) -> Any:
            made, shot = controller.step(now_us), controller.snapshot
            if shot is not None and shot.speeds.layshaft is not None:
                ages.append(shot.now_us - controller.observer.layshaft.latest().time_us)
            return made

    nodes: list[Any] = [Watched(), rig]
    VirtualTime(nodes, [20_000 + begin_us, 1]).run(lambda: False, 4_000_000)
    settled = np.array(ages[200:])  # the sensor clock is known after a second
    assert np.mean(settled < 6_500) > 0.97
