"""`meshpoint captures`: edges captured from real sensors."""
