"""Recorded logs run through the controller again: the same one, or another, whose decisions and
landings are worked out; `meshpoint replay` and `compare`."""
