"""Makes tools/ importable, and the mutants' folder of it."""

import sys
from pathlib import Path

TOOLS = Path(__file__).parents[2] / "tools"
for folder in (TOOLS, TOOLS / "mutation"):
    sys.path.insert(0, str(folder))
