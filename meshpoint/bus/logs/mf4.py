"""Reads ASAM MDF 4 bus logs (MF4) with python-can and asammdf, an extra: meshpoint[mf4]."""

from __future__ import annotations

import contextlib
import gc
import io
import itertools
import logging
import sys
from collections.abc import Iterator
from typing import Any, BinaryIO, Final

from meshpoint.bus.light_can import mf4_module
from meshpoint.bus.logs.buses import Buses
from meshpoint.bus.logs.entry import DefectError, Entries, Skipped, checked
from meshpoint.dbc.frame import Frame

AT_A_TIME: Final = 500
"""Messages between two times that asammdf is made quiet."""


def mf4_entries(file: BinaryIO, buses: Buses) -> Entries:
    """Every frame, time in seconds since the epoch; raises DefectError. asammdf reads the whole
    index at once, so a file that is cut off gives nothing."""
    reader, why = None, ""
    with _quiet():
        try:
            reader = mf4_module().MF4Reader(file)
        except (ImportError, NotImplementedError) as error:  # python-can's without asammdf
            raise DefectError("", "MF4 needs asammdf: pip install meshpoint[mf4]") from error
        except Exception as error:  # noqa: BLE001  # asammdf leaks errors of many kinds
            why = f"cannot be read as MF4: {error!r}"
        if why:
            gc.collect()  # a reader that was half made is in a ring of references
    if reader is None:
        raise DefectError("", why)
    for count, message in enumerate(_all_of(iter(reader)), 1):
        if message.is_error_frame:
            yield Skipped.ERROR
        elif message.is_remote_frame:
            yield Skipped.REMOTE
        elif buses.keeps(str(message.channel)):
            frame = Frame(
                message.arbitration_id,
                bytes(message.data),
                bool(message.is_fd),
                bool(message.is_extended_id),
            )
            yield message.timestamp, checked(frame, f"frame {count}")


def _all_of(messages: Iterator[Any]) -> Iterator[Any]:
    """The messages, some at a time; raises DefectError."""
    count, is_more, why = 0, True, ""
    while is_more and not why:
        some: list[Any] = []
        with _quiet():
            try:
                some.extend(itertools.islice(messages, AT_A_TIME))
            except Exception as error:  # noqa: BLE001
                why = f"cannot be read: {error!r}"
        yield from some
        count, is_more = count + len(some), bool(some)
    if why:
        raise DefectError(f"frame {count + 1}", why)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """asammdf writes tracebacks to standard output and standard error for what it stumbles over,
    and leaves objects that cannot be taken down: what came of it is said in one line by who reads
    the log. Its errors are not chained to ours, which would keep such objects beyond this."""
    logger, hook = logging.getLogger("asammdf"), sys.unraisablehook
    was_disabled, logger.disabled = logger.disabled, True
    sys.unraisablehook = lambda _: None
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        logger.disabled, sys.unraisablehook = was_disabled, hook
