"""`meshpoint simulate`: shifts in virtual time."""
