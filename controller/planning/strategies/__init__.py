"""Engagement strategies: when to let the brake go, and when the sleeve should meet its gear.

One file a strategy; `base` says what each must have, `table` names them, and `own` reads one that a
user has written in a file outside this package.
"""
