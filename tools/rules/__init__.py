"""Rules of this repository that no other linter knows, one module each.

A module has `findings`, which gives one line for each place that breaks its rule. `tools/lint.py`
runs all of them.
"""

from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
PRODUCT: Final = ("controller", "dbc", "firmware", "meshpoint", "rig_sim")
"""Folders that an installation has."""


def name_of(path: Path) -> str:
    """A file's name as it is written here: below the repository."""
    return path.relative_to(ROOT).as_posix()
