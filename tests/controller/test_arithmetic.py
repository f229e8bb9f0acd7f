"""What a header says of rounding is what decides on bytes."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from meshpoint.controller.settings.header import arithmetic, rounding

X86_64_GLIBC = platform.machine() == "x86_64" and platform.libc_ver()[0] == "glibc"


def rounded_with(**variables: str) -> str:
    """In a process of its own, since libraries look at these when they are loaded."""
    code = "from meshpoint.controller.settings.header import rounding; print(rounding())"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | variables, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout.strip()


def test_the_same_numbers_round_the_same_twice() -> None:
    assert rounding() == rounding()
    assert arithmetic().endswith(rounding())


@pytest.mark.skipif(not X86_64_GLIBC, reason="the kernels named are OpenBLAS's for x86-64")
def test_other_kernels_of_openblas_round_otherwise() -> None:
    assert rounded_with(OPENBLAS_CORETYPE="Prescott") != rounded_with(OPENBLAS_CORETYPE="Nehalem")


@pytest.mark.skipif(not X86_64_GLIBC, reason="glibc alone is told to leave out instructions")
def test_a_c_library_without_fma_rounds_otherwise() -> None:
    """Its functions for a processor without FMA. One that has none rounds the same both times."""
    without = rounded_with(GLIBC_TUNABLES="glibc.cpu.hwcaps=-FMA,-AVX2,-FMA4")
    assert (without != rounded_with(GLIBC_TUNABLES="")) is has_fma()


def has_fma() -> bool:
    return " fma " in Path("/proc/cpuinfo").read_text(encoding="ascii")
