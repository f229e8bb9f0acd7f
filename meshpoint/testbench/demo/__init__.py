"""`meshpoint demo`: both nodes live, both strategies, and the report of it."""
