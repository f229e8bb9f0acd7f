"""Controller and rig on one bench: virtual time, demo, replay, campaigns, the command line."""

import os

# Before numpy is loaded: the matrices here are small, threads of a BLAS would only wait for each
# other (20 ms a solve on a busy machine), and how sums are split among them must change no result.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
