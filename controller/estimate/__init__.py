"""Angle and speed of each shaft, tooth errors, brake model, phase (docs/estimation.md)."""
