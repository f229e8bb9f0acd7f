"""Angle and speed of each shaft, tooth errors, brake model (docs/estimation.md)."""
