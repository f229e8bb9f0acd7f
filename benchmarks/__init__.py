"""Timings beside named peers, in one run, interleaved, medians; ratios are what counts. And what is
measured for longer: `studies`, `swarm`."""
