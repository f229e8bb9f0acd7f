"""`python -m benchmarks.envelope`."""

import sys

from meshpoint.bus.light_can import load_can

if __name__ == "__main__":
    load_can()
    from benchmarks.envelope.command import main

    sys.exit(main())
