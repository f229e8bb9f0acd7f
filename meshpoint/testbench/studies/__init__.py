"""The thesis reproduced: one study a figure or table, ours beside the thesis's statement."""
