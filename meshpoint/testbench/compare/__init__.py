"""`meshpoint compare`: two logs, records or settings files."""
