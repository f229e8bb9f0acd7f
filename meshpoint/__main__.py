"""`python -m meshpoint` is the command `meshpoint`."""

import sys

from meshpoint.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
