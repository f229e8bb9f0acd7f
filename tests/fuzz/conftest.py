"""Makes the fuzzers and the closed loop's helpers importable."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
for folder in (HERE, HERE.parent / "closed_loop", HERE.parent / "bus"):
    sys.path.insert(0, str(folder))
