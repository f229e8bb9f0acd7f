"""`python -m meshpoint` is the command `meshpoint`."""

import sys

from meshpoint.testbench.cli import main

if __name__ == "__main__":
    sys.exit(main())
