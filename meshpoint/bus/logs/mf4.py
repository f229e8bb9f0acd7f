"""Reads ASAM MDF 4 bus logs (MF4) with python-can and asammdf, an extra: meshpoint[mf4]."""

from __future__ import annotations

from typing import BinaryIO

from meshpoint.bus.light_can import mf4_module
from meshpoint.bus.logs.buses import Buses
from meshpoint.bus.logs.entry import DefectError, Entries, Skipped, checked
from meshpoint.dbc.frame import Frame


def mf4_entries(file: BinaryIO, buses: Buses) -> Entries:
    """Every frame, time in seconds since the epoch; raises DefectError. asammdf reads the whole
    index at once, so a file that is cut off gives nothing."""
    try:
        reader = mf4_module().MF4Reader(file)
    except (ImportError, NotImplementedError) as error:  # python-can's without asammdf
        raise DefectError("", "MF4 needs asammdf: pip install meshpoint[mf4]") from error
    except Exception as error:  # asammdf leaks errors of many kinds on damaged files
        raise DefectError("", f"cannot be read as MF4: {error!r}") from error
    messages = iter(reader)
    count = 0
    while True:
        try:
            message = next(messages, None)
        except Exception as error:
            raise DefectError(f"frame {count + 1}", f"cannot be read: {error!r}") from error
        if message is None:
            return
        count += 1
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
