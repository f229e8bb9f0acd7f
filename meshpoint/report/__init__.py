"""The HTML report and the pictures of a run; what they show beside its `results`: what the
controller believed, and what another one would have decided."""
