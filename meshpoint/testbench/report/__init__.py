"""The HTML report and the pictures of a run, drawn from its `results`."""
