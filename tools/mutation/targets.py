"""What is mutated, and by which tests each part has to be caught."""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).parents[2]
NOT_IMPORTED: Final = 77
"""The exit code of a process of its own that has not imported its mutant."""


class Target(NamedTuple):
    """Files that belong together, and the tests that have to catch each mutant of them that is not
    listed as equivalent."""

    name: str
    files: tuple[str, ...]
    """Patterns below the repository."""
    tests: tuple[str, ...]

    def paths(self) -> list[Path]:
        """The files, sorted."""
        return sorted({path for each in self.files for path in ROOT.glob(each)})


_GUARD_TESTS: Final = (
    "tests/controller/test_guard_one_swing.py",
    "tests/controller/test_guard.py",
    "tests/controller/test_guard_rows.py",
    "tests/controller/test_guard_brake.py",
    "tests/controller/test_guard_face_pulse.py",
    "tests/controller/test_guard_sleeves.py",
    "tests/controller/test_guard_standing_sleeve.py",
    "tests/controller/test_guard_clock.py",
    "tests/controller/test_guard_own_clock.py",
    "tests/controller/test_guard_own_speed.py",
    "tests/controller/test_guard_driveline.py",
    "tests/controller/test_guard_engine.py",
    "tests/controller/test_guard_limits.py",
    "tests/controller/test_guard_specification.py",
    "tests/controller/test_guard_ear.py",
    "tests/controller/test_guard_view.py",
    "tests/controller/test_guard_wheels.py",
    "tests/controller/test_shafts_in_mesh.py",
    "tests/controller/test_guard_last_call.py",
    "tests/controller/test_guard_held_gear.py",
    "tests/controller/test_guard_driveline_specification.py",
    "tests/controller/test_staleness.py",
    "tests/controller/test_survivors.py",
    "tests/contract/test_shared_tables.py",
    "tests/gearbox/test_sheet.py",
)
"""The quick ones alone: what they let through shall not wait for a closed loop to find it."""
TARGETS: Final = (
    Target("guard", ("controller/guard/*.py",), _GUARD_TESTS),
    Target(
        "e2e", ("dbc/e2e.py",),
        ("tests/dbc/test_e2e.py", "tests/dbc/test_link.py", "tests/dbc/test_channels.py",
         "tests/controller/test_staleness.py"),
    ),
    Target(
        "link", ("dbc/link.py",),
        ("tests/dbc/test_link.py", "tests/dbc/test_channels.py", "tests/dbc/test_codec.py",
         "tests/dbc/test_messages.py", "tests/controller/test_staleness.py"),
    ),
    Target(
        "valves", ("rig_sim/shared/valve_drivers.py",),
        ("tests/rig_sim/test_valves.py", "tests/rig_sim/test_core.py"),
    ),
)  # fmt: skip


def caught_by(mutated_source: Path) -> Path:
    """Where a process of its own names the test that failed."""
    return mutated_source.with_suffix(".by")
