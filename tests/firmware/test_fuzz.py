"""Random and damaged frames, edges and clocks, under address and undefined-behaviour sanitizers."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from meshpoint.firmware.build import (
    BOTH_IMAGES,
    IMAGES,
    compiled,
    source_folder,
    sources,
)

SANITIZED = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


CLASSIC = (*BOTH_IMAGES, "-DPROFILE_CLASSIC=1", "-DTEETH_INPUT=40", "-DTEETH_PROPELLER=42")
OPTIONS = {**IMAGES, "classic": CLASSIC}


@pytest.fixture(scope="module", params=OPTIONS)
def fuzzer(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    if shutil.which("cc") is None:
        pytest.skip("no cc here: the compiler of meshpoint[firmware] has no address sanitizer")
    path = tmp_path_factory.mktemp("fuzz") / "fuzz"
    folder = source_folder()
    compiled(
        [*sources(folder), folder / "native" / "fuzz.c"], path, SANITIZED, OPTIONS[request.param]
    )
    return path


def run(fuzzer: Path, frames: int, seed: int) -> str:
    done = subprocess.run(
        [fuzzer, str(frames), str(seed)], capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_20_000_frames_do_no_harm(fuzzer: Path) -> None:
    assert run(fuzzer, 20_000, seed=1).startswith("20000 frames")


@pytest.mark.long
def test_a_million_frames_do_no_harm(fuzzer: Path) -> None:
    assert run(fuzzer, 1_000_000, seed=7).startswith("1000000 frames")
