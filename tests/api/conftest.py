"""One recorded run that the tests of this folder read; makes this folder's helper importable."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import meshpoint

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> object:
    from recorded_run import Recorded

    log = tmp_path_factory.mktemp("api") / "run.log"
    with meshpoint.Bench(seed=1, as_built="clean", log=log) as bench:
        learning = bench.learn(10)[0]
        known = bench.reference_known
        aimed = bench.shift(10)
    return Recorded(log, learning, aimed, known)
