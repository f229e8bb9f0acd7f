"""A controller that only looks on: what it would have done beside what was done."""
