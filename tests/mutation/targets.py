"""What is mutated, and by which tests each part has to be caught."""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).parents[2]
NOT_IMPORTED: Final = 77
"""The exit code of a process of its own that has not imported its mutant."""


class Target(NamedTuple):
    """Files that belong together, and the tests that hold them."""

    name: str
    files: tuple[str, ...]
    """Patterns below the repository."""
    tests: tuple[str, ...]
    must: bool
    """Whether every mutant has to be caught or listed as equivalent."""
    near: tuple[str, ...] = ()
    """Those of the tests that are tried first; the others try what these let through."""
    kernels: tuple[str, ...] = ()
    """Those that are tried first where a kernel, or a constant of one, is mutated: without the
    compiler, so the short ones."""

    def paths(self) -> list[Path]:
        """The files, sorted."""
        return sorted({path for each in self.files for path in ROOT.glob(each)})


_GUARD_TESTS: Final = (
    "tests/controller/test_guard.py",
    "tests/controller/test_guard_rows.py",
    "tests/controller/test_guard_brake.py",
    "tests/controller/test_guard_clock.py",
    "tests/controller/test_guard_own_clock.py",
    "tests/controller/test_guard_own_speed.py",
    "tests/controller/test_guard_driveline.py",
    "tests/controller/test_guard_engine.py",
    "tests/controller/test_guard_limits.py",
    "tests/controller/test_guard_exactly.py",
    "tests/controller/test_guard_ear.py",
    "tests/controller/test_guard_view.py",
    "tests/controller/test_guard_wheels.py",
    "tests/controller/test_shafts_in_mesh.py",
    "tests/controller/test_guard_last_call.py",
    "tests/controller/test_guard_held_gear.py",
    "tests/controller/test_driveline_exactly.py",
    "tests/controller/test_staleness.py",
    "tests/controller/test_survivors.py",
    "tests/contract/test_shared_tables.py",
    "tests/gearbox/test_sheet.py",
)
"""The quick ones alone: what they let through shall not wait for a closed loop to find it."""
_KERNEL_TESTS: Final = tuple(
    f"tests/controller/test_{name}.py"
    for name in (
        "kernels", "motion", "crossing", "swing", "lash", "lash_course", "edges", "edge_gate",
        "edge_gate_foreign", "edge_speed", "sensor_count", "predictor", "strategy",
        "estimation_exactly", "lash_exactly", "lash_start_exactly",
        "aiming_exactly", "motion_kernels_exactly", "linear_kernels_exactly", "swing_exactly",
        "lash_motion_exactly", "lash_course_exactly", "crossing_exactly", "swing_filter_exactly",
        "loaded_exactly", "lash_cloud_exactly", "plan_kernels_exactly", "gate_exactly",
        "gate_found_exactly", "gate_search_exactly", "chain_exactly", "gate_limits_exactly",
        "cloud_redraw", "halton",
    )
)  # fmt: skip
_NEAR: Final = ("tests/controller", "tests/testbench/test_reference.py")
"""The pages of the second are made of the settings, so they hold each default and each range."""
TARGETS: Final = (
    Target("guard", ("controller/guard/*.py",), _GUARD_TESTS, must=True),
    Target(
        "e2e", ("dbc/e2e.py",),
        ("tests/dbc/test_e2e.py", "tests/dbc/test_link.py", "tests/dbc/test_channels.py",
         "tests/controller/test_staleness.py"),
        must=True,
    ),
    Target(
        "link", ("dbc/link.py",),
        ("tests/dbc/test_link.py", "tests/dbc/test_channels.py", "tests/dbc/test_codec.py",
         "tests/dbc/test_messages.py", "tests/controller/test_staleness.py"),
        must=True,
    ),
    Target(
        "valves", ("rig_sim/shared/valve_drivers.py",),
        ("tests/rig_sim/test_valves.py", "tests/rig_sim/test_core.py"),
        must=True,
    ),
    Target(
        "controller", ("controller/**/*.py",),
        (*_NEAR, "tests/closed_loop", "tests/campaign/test_open_loop.py",
         "tests/testbench/test_own_strategy.py"),
        must=False, near=_NEAR, kernels=_KERNEL_TESTS,
    ),
)  # fmt: skip
"""The last one is looked at by samples: `--sample`; what belongs to an earlier one is left out."""


def caught_by(mutated_source: Path) -> Path:
    """Where a process of its own names the test that failed."""
    return mutated_source.with_suffix(".by")


def files_of(target: Target) -> list[Path]:
    """Its files, without those of the targets before it."""
    taken: set[Path] = set()
    for each in TARGETS:
        if each.name == target.name:
            break
        taken.update(each.paths())
    return [path for path in target.paths() if path not in taken]
