"""How far LLVM optimises kernels: level 1 unless NUMBA_OPT says otherwise.

Levels 2 and 3 take a tenth more time to compile all kernels and none of it comes back: loops here
run over six states or one wheel's edges. No level changes a result.

Loads numba, and has to be loaded before numba's code generator is.
"""

from __future__ import annotations

import os
from typing import Any, Final

import numba

os.environ.setdefault("NUMBA_OPT", "1")
_config: Any = numba.core.config
_config.reload_config()
LEVEL: Final = repr(_config.OPT)
"""The level, as a name of a kept kernel has it."""
