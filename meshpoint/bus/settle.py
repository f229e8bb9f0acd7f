"""Settles a process before frames come: garbage is collected once and what is left set aside."""

import gc


def settle() -> None:
    """Collects, then freezes what survived.

    With numba loaded a full collection takes 40 ms and more, long enough for a valve's command to
    expire; frozen objects are not looked at again. Call it when everything has been imported,
    built and compiled.
    """
    gc.collect()
    gc.freeze()
