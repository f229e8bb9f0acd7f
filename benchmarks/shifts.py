"""Shifts in virtual time by a controller that somebody looks into."""

from __future__ import annotations

from meshpoint.bench.bench import BenchCore, plan_shifts
from meshpoint.bench.bench_builder import virtual_bench
from meshpoint.bench.pauses import pauses_of
from meshpoint.bench.setup import Setup
from meshpoint.bench.simulate import LAYSHAFT_RAD_S, LIMIT_US_PER_SHIFT
from meshpoint.bus.core import Core
from meshpoint.rig_sim.core import RigCore


def make_shifts(setup: Setup, controller: Core) -> None:
    """Makes the shifts that the setup asks for."""
    plan = plan_shifts(setup.sheet, list(setup.pairs), setup.shifts, LAYSHAFT_RAD_S)
    operator = BenchCore(plan, pauses_of(setup.sheet, setup.profile, setup.preset))
    rig = RigCore(setup.sheet, setup.rig(plan[0]))
    driver = virtual_bench(setup, controller, rig, operator).time
    driver.run(lambda: operator.done, LIMIT_US_PER_SHIFT * setup.shifts)
