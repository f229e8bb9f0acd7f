"""What is in the wheel is the product: nothing by which its own makers test and judge it."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest
import setuptools

ROOT = Path(__file__).parents[2]
BESIDE = {"benchmarks", "examples", "mutation", "planted", "studies", "swarm", "tests", "tools"}


@pytest.fixture(scope="module")
def packages() -> list[str]:
    """As setup.py names them to setuptools."""
    given: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        patch.setattr(setuptools, "setup", lambda **options: given.update(options))
        runpy.run_path(str(ROOT / "setup.py"), run_name="__main__")
    found: list[str] = given["packages"]
    return found


def test_all_of_it_is_meshpoint(packages: list[str]) -> None:
    assert "meshpoint.controller.guard" in packages
    assert {name.split(".")[0] for name in packages} == {"meshpoint"}


def test_studies_swarm_mutants_and_tests_are_not_in_it(packages: list[str]) -> None:
    parts = {part for name in packages for part in name.split(".")}
    assert not parts & BESIDE
