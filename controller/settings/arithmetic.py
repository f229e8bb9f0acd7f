"""What the last bit of a result depends on beside the code: libraries, processor, C library.

Not on Python's minor version, as long as nothing adds floats by `sum`, which is compensated from
3.12 on. OpenBLAS has other kernels for other processors, and the C library takes FMA where there is
one; both then round otherwise.
"""

from __future__ import annotations

import hashlib
import math
import platform
from functools import cache
from importlib.metadata import version
from typing import Final

import numpy as np

LIBRARIES: Final = ("numpy", "scipy", "numba")
SIZES: Final = (4, 7, 30)
"""Of the matrices tried: OpenBLAS works on blocks, and on what is left over."""
ELEMENTARY: Final = (math.exp, math.sin, math.cos)
NUMBERS: Final = 3_000
"""Of a thousand values of these functions one is rounded otherwise without FMA (glibc 2.36)."""


@cache
def arithmetic() -> str:
    """The libraries that compute, the C library, and a digest of what they make here of fixed
    numbers; equal where the same steps give the same bytes."""
    parts = [f"{name} {version(name)}" for name in LIBRARIES]
    parts.append(" ".join(platform.libc_ver()).strip() or platform.system())
    return ", ".join((*parts, f"rounding {rounding()}"))


def rounding() -> str:
    """The digest, eight characters; 2 ms."""
    hashed = hashlib.sha256()
    numbers = np.arange(1.0, NUMBERS + 1.0) * 0.618034 % 1.0 * 10.0
    for function in ELEMENTARY:
        hashed.update(np.array(list(map(function, numbers.tolist()))).tobytes())
    hashed.update(np.exp(numbers).tobytes())
    for size in SIZES:
        matrix = np.resize(numbers, (size, size + 1))[:, :size] + np.eye(size)
        product = matrix @ matrix.T
        for made in (
            product,
            matrix @ numbers[:size],
            numbers[:size] @ numbers[-size:],
            np.linalg.inv(matrix),
            np.linalg.cholesky(product),
        ):
            hashed.update(made.tobytes())
    return hashed.hexdigest()[:8]
