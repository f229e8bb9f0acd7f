"""Exit codes, the same for every command."""

from enum import IntEnum


class Exit(IntEnum):
    """What a command's end means."""

    DONE = 0
    FAILED = 1
    """It ran, and what it ran failed."""
    BAD_INPUT = 2
    NOT_VERIFIABLE = 3
    NOT_DECIDED = 4
    """It ran, and the question it was to answer needs more of it."""
    INTERRUPTED = 130
