"""The thesis reproduced: a study for each figure or table; `registry` says how to add one."""
