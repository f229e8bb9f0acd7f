"""A gearbox on the bench before anything shifts: is the bus ready (`meshpoint check`), and what
moves what (`meshpoint commission`)."""
