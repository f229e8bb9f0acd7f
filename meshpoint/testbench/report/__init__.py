"""The HTML report and pictures of a run."""
