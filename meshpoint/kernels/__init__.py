"""The compiled kernels of both nodes: how they are compiled, kept on disk, and given records."""
