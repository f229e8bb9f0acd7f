"""Controller and rig on one bench.

A room for each task holds its command (`simulate/command.py`; `live/` those of nodes) and what that
alone needs. What commands share is in `command_line`; what several tasks need is in `loop` (virtual
time, live runs), `logs`, `results` and `report`. `table.py` lists the commands, `cli.py` runs one.
"""
