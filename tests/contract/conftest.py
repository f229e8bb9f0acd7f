"""Makes this folder's helper importable, and the closed loop's: one statement is about a run."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "closed_loop"))
sys.path.insert(0, str(Path(__file__).parent))
