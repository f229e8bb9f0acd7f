"""Records of the kernels: names over flat memory, compiled and as plain Python."""

from __future__ import annotations

import copy
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest

from meshpoint.kernels.records import (
    Integers,
    Over,
    RecordMemory,
    Records,
    Vector,
    filled,
    layout_of,
)

ROOT = Path(__file__).parents[2]
MOST_ARGUMENTS, MOST_LINES = 6, 70


class Point:
    """A record in a record."""

    x_m: float
    y_m: float


class Whole:
    """One of everything."""

    time_us: int
    points: Annotated[Records[Point], 2]
    marks: Annotated[Integers, 3]
    share: float
    all_m: Annotated[Vector, Over("points"), 2, 2]


WHOLE = layout_of(Whole)


def test_names_stand_on_flat_memory() -> None:
    memory = RecordMemory(WHOLE)
    whole = memory.flat.view(WHOLE)[0]
    whole.time_us, whole.share = (1 << 62) + 1, 0.25
    whole.points[1].y_m = 7.0
    whole.marks[2] = 5
    assert memory.flat.size == 1 + 4 + 3 + 1
    assert memory.part("time_us")[0] == (1 << 62) + 1
    assert memory.part("all_m").tolist() == [[0.0, 0.0], [0.0, 7.0]]
    assert memory.part("marks").tolist() == [0, 0, 5]
    assert memory.flat[-1] == 0.25


def test_a_copy_has_memory_of_its_own() -> None:
    memory = RecordMemory(WHOLE)
    memory.part("share")[0] = 1.0
    twice = copy.deepcopy([memory, memory])
    assert twice[0] is twice[1]
    memory.part("share")[0] = 2.0
    assert twice[0].part("share")[0] == 1.0
    twice[0].part("share")[0] = 3.0
    assert twice[0].flat[-1] == 3.0
    assert memory.flat[-1] == 2.0


def test_a_record_is_filled_by_every_name_in_order() -> None:
    point = layout_of(Point)
    assert filled(point, x_m=1, y_m=2.0).tolist() == [1.0, 2.0]
    for wrong in ({"x_m": 1.0}, {"y_m": 1.0, "x_m": 2.0}, {"x_m": 1.0, "z_m": 2.0}):
        with pytest.raises(KeyError):
            filled(point, **wrong)


RUN = """
from meshpoint.bus.light_can import load_can
load_can()
import json, sys, numpy as np
from meshpoint.controller.estimate.crossing_filter import CrossingFilter, Pressures
from meshpoint.controller.measure.gate_kernels import gate_edges
from meshpoint.controller.measure.gate import new_gate, teeth_of
from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.estimate.crossing_filter import MAIN_FILTER
from meshpoint.controller.models.swing import Swing, SwingMotion, SwingRates
from meshpoint.controller.models.layshaft import diagonal, first_order_law, following_motion
from meshpoint.controller.plan.gear_predictor import MEETING, trajectory
from meshpoint.controller.plan.target_phase import CONTACT_SERIES, TERMS, cheapest
from meshpoint.kernels.records import filled
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.controller.estimate.teeth import WheelTeeth
from meshpoint.controller.run.warm_up import warm_up
rng = np.random.default_rng(4)
tuning = CrossingFilterTuning()
model = following_motion(30.0, 0.05, 50.0).changed(segments=first_order_law(16.7, 8e5))
switches = np.array([[20e3, 60e3], [1.0, 0.0]])
edges = np.array((np.cumsum(rng.uniform(400.0, 600.0, 200)), np.pi / 45 * np.arange(1, 201)))
pressures = Pressures(np.arange(10e3, 100e3, 10e3), rng.uniform(0.0, 2e5, 9))
shaft = CrossingFilter(tuning)
x = np.array([0.0, 140.0, 0.0, 0.0, 1.0, 0.0])
p = diagonal(1e-2, 5.0, 1e4, 30.0, 0.1, 30.0)
shaft.begin(0.0, x, p)
shaft.take(edges, 1e-3, pressures, switches, model)
teeth = WheelTeeth(45, tuning)
teeth.learner.begin(0.0, x, p)
batch = EdgeBatch(edges[0], edges[1], np.arange(200) // 2, np.arange(200) % 2)
teeth.learner.take(batch, teeth.place(batch), pressures, switches, model)
window = teeth.learner.so_far()
gate, wheel = new_gate(2 * np.pi / 60, 0.5, 300.0, 170.0, 3), teeth_of(60, (58, 59))
missing = np.array([k for k in range(400) if k % 60 not in (58, 59)])
rises = np.array((np.arange(missing.size), 1000 + 500 * missing))
falls = rises + np.array([[0], [250]])
gate.given[:] = rises.shape[1]
found, numbers = np.zeros((2, 800)), np.zeros((3, 800), np.int64)
n = gate_edges(gate.flat, wheel, rises, falls, found, numbers)
motion = SwingMotion(0.5, 20.0, SwingRates(70.0, 3.0, 2.0))
main = CrossingFilter(tuning, MAIN_FILTER)
main.begin(0.0, np.array([1.0, 63.0, 0.0, 0.01, 1.0]), np.diag(np.linspace(0.1, 2.0, 5)))
main.take(edges * [[1.0], [0.9]], 1e-3, Pressures(np.empty(0), np.empty(0)), switches, motion)
swing = Swing(main.x, main.p, motion)
ahead = np.empty((2, 20))
swing.trajectories(np.array([1e-3]), 2e-3, ahead[np.newaxis])
meeting = filled(MEETING, layshaft_us=0.0, first_us=1e3, step_us=2e3, i_gear=0.775,
    reference_rad=0.1)
trajectory(x.copy(), switches, model.flat, meeting, ahead)
contacts = filled(CONTACT_SERIES, wait_s=0.02, step_s=2e-3)
variance = np.interp(np.arange(20.0), np.arange(5) * 4.0, swing.outlook(0.05, 0.01, 5))
terms = filled(TERMS, pitch_rad=0.13, half_gap_rad=0.013, target_rad=0.0, overlap_s=2e-3,
    delay_sd_s=1e-3, miss_s=0.2, block_s=0.1, block_slip_rad_s=1.0, energy_s3_rad2=1e-3,
    aim_s=1e-3, slip_low_rad_s=-1.0, slip_high_rad_s=50.0)
least = cheapest(ahead[0], ahead[1], variance, contacts, terms)
later = shaft.at(edges[0, -1] + 20e3, switches, model)
warm_up(baselines=True)
print(json.dumps([shaft.x.tolist(), shaft.p.tolist(),
    shaft.nis.tolist(), main.x.tolist(), main.p.tolist(),
    swing.theta_sd_ahead(0.03), window.normal.tolist(), window.right.tolist(), n,
    found[:, :n].tolist(), numbers[:2, :n].tolist(), ahead.tolist(), least,
    later.vector.tolist(), later.covariance.tolist()]))
"""


@pytest.mark.long
def test_compiled_and_plain_python_agree() -> None:
    """Filter, its forecast, teeth, gate with missing teeth, plan, and every
    other kernel once: a node that starts calls them all."""

    def run(disabled: str) -> list[np.ndarray]:
        environment = os.environ | {"NUMBA_DISABLE_JIT": disabled}
        command = [sys.executable, "-c", RUN]
        done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, check=True)
        return [np.array(part, dtype=float) for part in json.loads(done.stdout)]

    compiled, plain = run("0"), run("1")
    assert compiled[8] > 300
    assert compiled[2][1] > 90
    for ours, theirs in zip(compiled, plain, strict=True):
        assert np.allclose(ours, theirs, rtol=1e-9, atol=1e-12 * np.abs(theirs).max())
