"""The shift sequence: phases, their table, and what each does."""
