"""Which versions of other packages meshpoint is tested with, for `pip install -c`.

`python -m meshpoint.constraints` prints the path of the file. It loads nothing else, so that it
works where meshpoint is installed and what it needs is not yet.
"""

from __future__ import annotations

import sys
from pathlib import Path

PATH = Path(__file__).with_name("constraints.txt")
"""A pin for each package that meshpoint cannot do without, made by tools/lock-packages."""

if __name__ == "__main__":
    sys.stdout.write(f"{PATH}\n")
