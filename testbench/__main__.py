"""`python -m testbench` is `meshpoint`."""

import sys

from testbench.cli import main

if __name__ == "__main__":
    sys.exit(main())
