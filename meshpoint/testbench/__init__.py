"""Controller and rig on one bench: virtual time, demo, replay, campaigns, reports, commands."""

import os

# All matrices here are small: a thread pool waits longer than they take, and two processes with a
# pool each wait for each other. It must be said before numpy is loaded.
for _library in ("OPENBLAS", "MKL", "OMP"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
