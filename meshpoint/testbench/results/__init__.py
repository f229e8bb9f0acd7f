"""What a run gives: rows, traces, figures."""
