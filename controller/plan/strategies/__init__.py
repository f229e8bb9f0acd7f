"""Engagement strategies: when to release the brake, and when the sleeve should meet its gear.

One file for each strategy; `base` says what each must have, `table` names them, and `own` reads one
that a user has written in a file outside this package. How to add one: docs/change.md.
"""
