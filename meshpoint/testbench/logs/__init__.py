"""Recorded logs and captures, run through the controller again: replay, captures."""
