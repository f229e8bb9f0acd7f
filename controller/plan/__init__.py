"""When to release the brake and when to fire: predictions, and a file for each strategy.

`strategy` says what each must have, `strategist` names them, and `own_strategy` reads one that a
user has written in a file outside this package. How to add one: docs/change.md.
"""
