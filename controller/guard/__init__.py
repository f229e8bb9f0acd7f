"""The guard: forbids dangerous commands, from its own decoding and its own speeds."""
