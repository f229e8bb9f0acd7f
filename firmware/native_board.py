"""A board of memory that runs the firmware in this process: pins, clocks and frames by values."""

from __future__ import annotations

import ctypes
import struct
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from meshpoint.dbc.frame import Frame
from meshpoint.firmware.board import CHANNELS, SCANS, Analogue, Failure

EDGES: Final = 256
SENT: Final = 64
CHANGES: Final = 64
WHEELS: Final = 4

_FRAME: Final = struct.Struct("<IB??64sx")
_SCANS: Final = struct.Struct("<" + "4h4HBx" * SCANS)
_SCAN_VALUES: Final = 9
_FLAGS: Final = {
    Failure.BUS_OFF: "is_bus_off", Failure.STUCK: "is_stuck", Failure.DEAF: "is_deaf",
}  # fmt: skip


class Changed(ctypes.Structure):
    """The outputs as they were switched: own time in us, one bit a valve."""

    _fields_ = (("own_us", ctypes.c_uint32), ("driven", ctypes.c_uint16))


class Memory(ctypes.Structure):
    """`struct native` of firmware/native/native.h, which says what each field is."""

    _fields_ = (
        ("sensor_us", ctypes.c_uint32),
        ("own_us", ctypes.c_uint32),
        ("wake_sensor_us", ctypes.c_uint32),
        ("wake_own_us", ctypes.c_uint32),
        ("watchdog_us", ctypes.c_uint32),
        ("poll_us", ctypes.c_uint32),
        ("resets", ctypes.c_uint32),
        ("coils_together", ctypes.c_uint32),
        ("change_count", ctypes.c_uint32),
        ("clutch_orders", ctypes.c_uint32),
        ("sent_count", ctypes.c_uint32),
        ("pulse_count", ctypes.c_uint32),
        ("driven", ctypes.c_uint16),
        ("is_wake_sensor_set", ctypes.c_bool),
        ("is_wake_own_set", ctypes.c_bool),
        ("is_clutch_closed", ctypes.c_bool),
        ("is_bus_off", ctypes.c_bool),
        ("is_sending", ctypes.c_bool),
        ("has_scans", ctypes.c_bool),
        ("bad_wheels", ctypes.c_uint8),
        ("is_stuck", ctypes.c_bool),
        ("is_deaf", ctypes.c_bool),
        ("changes", Changed * CHANGES),
        ("sent", ctypes.c_char * (_FRAME.size * SENT)),
        ("scans", ctypes.c_char * _SCANS.size),
        ("edges_us", ctypes.c_uint32 * EDGES * CHANNELS),
        ("edges_in", ctypes.c_uint32 * CHANNELS),
        ("edges_out", ctypes.c_uint32 * CHANNELS),
        ("toggle_us", ctypes.c_uint32 * WHEELS),
        ("is_toggle_set", ctypes.c_bool * WHEELS),
        ("toggled_us", ctypes.c_uint32 * EDGES * WHEELS),
        ("toggled_count", ctypes.c_uint32 * WHEELS),
    )


class NativeBoard:
    """As `Board`. It has a copy of the library for itself."""

    def __init__(self, library: bytes) -> None:
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            path = Path(folder) / "firmware.so"
            path.write_bytes(library)
            self.code = ctypes.CDLL(str(path))
        self.memory = Memory.in_dll(self.code, "native")
        """What the board's pins and registers are."""
        self._sent = memoryview(self.memory).cast("B")[Memory.sent.offset :]
        self._scans = memoryview(self.memory).cast("B")[Memory.scans.offset :]

    @property
    def is_on(self) -> bool:
        """As `Board`."""
        return bool(self.memory.is_wake_own_set)

    @property
    def sensor_us(self) -> int:
        """As `Board`."""
        return int(self.memory.sensor_us)

    @property
    def own_us(self) -> int:
        """As `Board`."""
        return int(self.memory.own_us)

    @property
    def resets(self) -> int:
        """As `Board`."""
        return int(self.memory.resets)

    @property
    def driven(self) -> int:
        """As `Board`."""
        return int(self.memory.driven)

    @property
    def coils_together(self) -> int:
        """As `Board`."""
        return int(self.memory.coils_together)

    @property
    def clutch(self) -> bool | None:
        """As `Board`."""
        return bool(self.memory.is_clutch_closed) if self.memory.clutch_orders else None

    def set_sensor_us(self, sensor_us: int) -> None:
        """As `Board`."""
        self.memory.sensor_us = sensor_us & 0xFFFF_FFFF

    def fail(self, failure: Failure) -> None:
        """As `Board`."""
        if failure is Failure.FAULT:
            self.code.board_on_fault()
        else:
            setattr(self.memory, _FLAGS[failure], True)

    def mend(self) -> None:
        """As `Board`."""
        for flag in _FLAGS.values():
            setattr(self.memory, flag, False)

    def power_on(self, sensor_us: int) -> None:
        """Starts it, or resets it; the sensor clock shows this then."""
        self.set_sensor_us(sensor_us)
        self.code.native_power_on()

    def advance(self, for_us: int) -> None:
        """Time goes on, with all that is due in it: compare timers, main loop, watchdog."""
        self.code.native_advance(for_us)

    def receive(self, frame: Frame) -> None:
        """A frame from the bus."""
        can_id, data, is_fd, is_extended = frame
        self.code.native_receive(can_id, data, len(data), is_extended, is_fd)

    def capture(self, channel: int, stamps_us: Sequence[int]) -> None:
        """Edges of a channel, the oldest first, each at its low 32 bits of the sensor clock."""
        count = len(stamps_us)
        stamps = struct.pack(f"={count}I", *stamps_us)
        self.code.native_capture(channel, stamps, count)

    def read(self, analogue: Analogue) -> None:
        """The tenth scan has been made: what the board sends each 10 ms is made now."""
        values = [0] * (_SCAN_VALUES * SCANS)
        for place, samples in enumerate(analogue.sleeves):
            values[place::_SCAN_VALUES] = samples
        for place, value in enumerate(
            (*analogue.slow, analogue.bad_sleeves), len(analogue.sleeves)
        ):
            values[place::_SCAN_VALUES] = (value,) * SCANS
        _SCANS.pack_into(self._scans, 0, *values)
        self.memory.has_scans = True
        self.code.board_poll()

    def take_sent(self) -> list[Frame]:
        """The frames that it has sent since the last call."""
        count, self.memory.sent_count = self.memory.sent_count, 0
        return [
            Frame(can_id, data[:length], is_fd, is_extended)
            for can_id, length, is_extended, is_fd, data in _FRAME.iter_unpack(
                self._sent[: count * _FRAME.size]
            )
        ]

    @property
    def wake_us(self) -> int:
        """How long until it may switch an output by itself."""
        memory = self.memory
        by_sensor_us: int = memory.wake_sensor_us - memory.sensor_us
        by_own_us: int = memory.wake_own_us - memory.own_us
        return min(by_sensor_us & 0xFFFF_FFFF, by_own_us & 0xFFFF_FFFF)
