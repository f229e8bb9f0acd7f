"""Worlds in which anything may fail: drawn by seed, checked at every step against plant truth."""
