"""`python -m benchmarks.dataset`."""

import sys

from meshpoint.bus.light_can import load_can

if __name__ == "__main__":
    load_can()
    from benchmarks.dataset.command import main

    sys.exit(main())
