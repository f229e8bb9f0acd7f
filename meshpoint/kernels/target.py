"""What kernels are compiled for: a kind of processor, and how far LLVM optimises.

    processor   on x86-64 with AVX2 and FMA (2013 and later) its level x86-64-v3 (System V ABI
                supplement, 3.1.1): all such machines run the same machine code, so that a wheel can
                bring it. Any other machine: the processor itself. NUMBA_CPU_NAME and
                NUMBA_CPU_FEATURES choose another
    level       1. Levels 2 and 3 take a tenth more time to compile all kernels and none of it comes
                back: loops here run over six states or one wheel's edges. NUMBA_OPT chooses another

Neither changes a result. Loads numba, and has to be loaded before numba's code generator is.
"""

# numba is typed only in part.
# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

import os
from typing import Any, Final

import numba
from numba.core.codegen import get_host_cpu_features

COMMON: Final = "x86-64-v3"
"""The level of x86-64 that one set of kernels is compiled for."""
NEEDED: Final = (
    "cx16", "sahf", "popcnt", "sse3", "ssse3", "sse4.1", "sse4.2", "avx", "avx2", "bmi", "bmi2",
    "f16c", "fma", "lzcnt", "movbe", "xsave",
)  # fmt: skip
"""What a processor of this level can do beyond the first x86-64, in LLVM's names."""


def has_common() -> bool:
    """Whether this machine's processor is of that level."""
    found = get_host_cpu_features().split(",")
    return all(f"+{name}" in found for name in NEEDED)


if not {"NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES"} & set(os.environ) and has_common():
    os.environ.update(NUMBA_CPU_NAME=COMMON, NUMBA_CPU_FEATURES="")
os.environ.setdefault("NUMBA_OPT", "1")
_config: Any = numba.core.config
_config.reload_config()
LEVEL: Final = repr(_config.OPT)
"""The level of optimisation, as a name of a kept kernel has it."""
