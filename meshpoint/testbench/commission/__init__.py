"""Commissioning: what moves what, found out one output at a time, before anything shifts."""
