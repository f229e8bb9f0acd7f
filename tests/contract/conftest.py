"""Makes the closed loop's helper importable: one statement here is about a whole run."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "closed_loop"))
