"""docker-compose.yml, read as Compose reads it: which services a command line starts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

FILE = Path(__file__).parents[2] / "docker-compose.yml"
SERVICES: dict[str, dict[str, Any]] = yaml.safe_load(FILE.read_text("utf-8"))["services"]
ON_OUR_BUS = {"bus", "rig", "controller"}
ON_VCAN = {"rig-vcan", "controller-vcan", "logger-vcan"}


def started(*named: str, profile: str = "") -> set[str]:
    """What `docker compose [--profile PROFILE] up [NAMED ...]` starts: those named, else those
    without a profile or of this one; and what they depend on."""
    chosen = set(named) or {
        name
        for name, service in SERVICES.items()
        if not service.get("profiles") or profile in service["profiles"]
    }
    while more := {need for name in chosen for need in SERVICES[name].get("depends_on", {})}:
        if more <= chosen:
            break
        chosen |= more
    return chosen


def test_plain_up_starts_rig_controller_and_their_bus() -> None:
    assert started() == ON_OUR_BUS


def test_the_profile_local_adds_the_logger() -> None:
    assert started(profile="local") == ON_OUR_BUS | {"logger"}


def test_the_nodes_on_a_vcan_start_without_those_on_our_bus() -> None:
    assert started(*ON_VCAN, profile="vcan") == ON_VCAN | {"vcan"}


@pytest.mark.parametrize("profile", ["", "local", "vcan"])
def test_what_is_started_depends_on_nothing_of_a_profile_that_is_not(profile: str) -> None:
    for name in started(profile=profile):
        assert SERVICES[name].get("profiles", [profile])[0] == profile
