"""What a node need not have is not loaded by one that was not asked for it."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

OPTIONAL = (
    "meshpoint.bus.authentication",
    "meshpoint.bus.classic",
    "meshpoint.bus.diagnosis",
    "meshpoint.xcp",
    "meshpoint.dbc.classic",
)
pytestmark = pytest.mark.check

LOADED = "import json, sys; print(json.dumps([*sys.modules]))"
SIMULATE = "from meshpoint.cli.main import main; main({}); "
RUN = ["simulate", "--shifts", "1", "--preset", "thesis", "--json", "run.json"]


@pytest.mark.parametrize(
    ("what", "wanted"),
    [
        ("import meshpoint.controller.run.node, meshpoint.rig_sim.node; ", ()),
        (SIMULATE.format(RUN), ()),
        (
            SIMULATE.format([*RUN, "--profile", "classic"]),
            ("meshpoint.bus.classic", "meshpoint.dbc.classic"),
        ),
    ],
    ids=["nodes", "simulate", "simulate --profile classic"],
)
def test_only_what_was_asked_for_is_loaded(
    what: str, wanted: tuple[str, ...], tmp_path_factory: pytest.TempPathFactory
) -> None:
    done = subprocess.run(
        [sys.executable, "-c", what + LOADED],
        cwd=tmp_path_factory.mktemp("run"), capture_output=True, text=True, check=True,
    )  # fmt: skip
    loaded = set(json.loads(done.stdout.splitlines()[-1]))
    assert "meshpoint.bus.core" in loaded
    assert tuple(name for name in OPTIONAL if name in loaded) == wanted
