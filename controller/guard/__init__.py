"""The guard: forbids dangerous commands, by its own decoding and speeds (docs/guard.md)."""
