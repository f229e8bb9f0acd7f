"""Reads Vector's binary logs (BLF): a header, then containers, mostly compressed, of objects.

Written anew because python-can's reader unpacks a container without a limit and takes a log that
is cut off for a shorter one.
"""

import zlib
from collections.abc import Iterator
from datetime import UTC, datetime
from struct import Struct
from typing import BinaryIO, NamedTuple

from meshpoint.bus.logs.buses import Buses
from meshpoint.bus.logs.entry import DefectError, Entries, Skipped, Unfinished, checked
from meshpoint.dbc.frame import Frame

# Writers put 128 KiB into a container.
MAX_CONTAINER_BYTES = 16 * 1024 * 1024
_CONTAINER_LIMIT = f"the limit is {MAX_CONTAINER_BYTES}"

# signature, header size, application and format versions, file size, unpacked size, objects,
# objects read, start and end as SYSTEMTIME
_FILE_HEADER = Struct("<4sL8xQQLL8H8H")
_OBJECT_HEADER = Struct("<4sHHLL")  # signature, header size, header version, object size, type
_OBJECT_TIME = Struct("<LHHQ")  # unit, client, version, time since the start
_MIN_HEADER_BYTES = _OBJECT_HEADER.size + _OBJECT_TIME.size
_CONTAINER = Struct("<H6xL4x")  # compression, unpacked size
_MESSAGE = Struct("<2xBBL8s")  # flags, DLC, identifier, data
_FD_MESSAGE = Struct("<2xBBL5xB6x64s")  # flags, DLC, identifier, FD flags, data
# DLC, number of data bytes, identifier, flags, offset of further data; then the data
_FD_MESSAGE_64 = Struct("<xBBxL4xL19xB4x")

_UNCOMPRESSED, _ZLIB = 0, 2
_SIGNATURE = b"LOBJ"
_ALIGNMENT = 4
_CONTAINER_TYPE = 10
_ERROR_TYPES = (2, 73, 104)

_LAYOUTS = {
    1: _MESSAGE,
    86: _MESSAGE,
    100: _FD_MESSAGE,
    101: _FD_MESSAGE_64,
}
_UNITS_S = {1: 1e-5, 2: 1e-9}
_EXTENDED_BIT = 0x8000_0000
_ID_MASK = 0x1FFF_FFFF
_REMOTE_BIT = 0x80
_FD_BIT = 0x01
_REMOTE_BIT_64 = 0x0010
_FD_BIT_64 = 0x1000
_LENGTH_OF_DLC = (*range(9), 12, 16, 20, 24, 32, 48, 64)
_MAX_CLASSIC_LENGTH = 8
_MAX_PADDING = 8


class _Object(NamedTuple):
    kind: int
    time: bytes  # the part of its header with the time
    body: bytes
    position: str


def blf_entries(file: BinaryIO, file_bytes: int, buses: Buses) -> Entries:
    """Every frame of a BLF log of `file_bytes` bytes; time in seconds since the epoch, or since
    the start when the log does not show its start. Raises DefectError.
    """
    header = file.read(_FILE_HEADER.size)
    if len(header) < _FILE_HEADER.size or not header.startswith(b"LOGG"):
        raise DefectError("offset 0", "not a BLF log: it does not begin with a LOGG header")
    _, header_bytes, declared_bytes, _, declared_objects, _, *times = _FILE_HEADER.unpack(header)
    if not _FILE_HEADER.size <= header_bytes <= file_bytes:
        raise DefectError("offset 4", f"the header cannot have {header_bytes} bytes")
    file.seek(header_bytes)
    start_s = _epoch_s(times[:8])
    objects = 0
    for item in _objects(file, file_bytes):
        objects += 1
        entry = _entry(item, start_s, buses)
        if entry is not None:
            yield entry
    end = f"offset {file_bytes}"
    if declared_bytes > file_bytes:
        raise DefectError(end, f"cut off: {file_bytes} bytes are left of {declared_bytes}")
    if objects < declared_objects:
        raise DefectError(end, f"{objects} objects are left of {declared_objects} that it declares")
    if declared_bytes and (declared_bytes < file_bytes or objects > declared_objects):
        # The header is written last: what came behind it was on its way.
        cause = (
            f"the header declares {declared_objects} objects in {declared_bytes} bytes, there are "
        )
        yield Unfinished(f"{cause}{objects} in {file_bytes} (interrupted)")


def _objects(file: BinaryIO, file_bytes: int) -> Iterator[_Object]:
    """The objects in all containers; one may begin in a container and end in the next."""
    buffer = bytearray()
    position = ""
    for content, position in _containers(file, file_bytes):
        buffer += content
        start = 0
        while True:
            found = buffer.find(_SIGNATURE, start, start + _MAX_PADDING + len(_SIGNATURE))
            if found < 0 and len(buffer) >= start + _MAX_PADDING + len(_SIGNATURE):
                raise DefectError(position, "no object where one should begin")
            if found < 0 or found + _OBJECT_HEADER.size > len(buffer):
                break
            if buffer[start:found].strip(b"\0"):
                raise DefectError(position, "no object where one should begin")
            _, header_bytes, _, size, kind = _OBJECT_HEADER.unpack_from(buffer, found)
            if not _MIN_HEADER_BYTES <= header_bytes <= size <= MAX_CONTAINER_BYTES:
                raise DefectError(
                    position, f"no object has {size} bytes, {header_bytes} in its header"
                )
            if found + size > len(buffer):
                break
            time = bytes(buffer[found + _OBJECT_HEADER.size : found + header_bytes])
            yield _Object(kind, time, bytes(buffer[found + header_bytes : found + size]), position)
            start = found + size
        del buffer[:start]
    if buffer.strip(b"\0"):
        raise DefectError(position, "the log ends inside an object (interrupted or cut off)")


def _containers(file: BinaryIO, file_bytes: int) -> Iterator[tuple[bytes, str]]:
    """The content of each container, and where it is."""
    while True:
        offset = file.tell()
        position = f"offset {offset}"
        header = file.read(_OBJECT_HEADER.size)
        if len(header) < _ALIGNMENT and not header.strip(b"\0"):
            return
        if not header.strip(b"\0"):
            raise DefectError(position, "zeros where a container should begin (a hole in the log)")
        if len(header) < _OBJECT_HEADER.size:
            raise DefectError(position, "the log ends inside a container (interrupted or cut off)")
        signature, _, _, size, kind = _OBJECT_HEADER.unpack(header)
        if signature != _SIGNATURE or size < _OBJECT_HEADER.size:
            raise DefectError(position, "no container where one should begin")
        if offset + size > file_bytes:
            raise DefectError(position, "the log ends inside a container (interrupted or cut off)")
        if kind != _CONTAINER_TYPE:
            raise DefectError(position, f"an object of type {kind} where a container should begin")
        if size > MAX_CONTAINER_BYTES:
            raise DefectError(position, f"container of {size} bytes, limit {MAX_CONTAINER_BYTES}")
        yield _unpacked(file.read(size - _OBJECT_HEADER.size), position), position
        file.seek(offset + size + size % _ALIGNMENT)


def _unpacked(container: bytes, position: str) -> bytes:
    if len(container) < _CONTAINER.size:
        raise DefectError(position, "container without a header")
    method, unpacked_bytes = _CONTAINER.unpack_from(container)
    content = container[_CONTAINER.size :]
    if unpacked_bytes > MAX_CONTAINER_BYTES:
        raise DefectError(position, f"container of {unpacked_bytes} bytes, {_CONTAINER_LIMIT}")
    if method == _ZLIB:
        unpacker = zlib.decompressobj()
        try:
            content = unpacker.decompress(content, MAX_CONTAINER_BYTES)
        except zlib.error as error:
            raise DefectError(position, f"container cannot be unpacked: {error}") from error
        if not unpacker.eof:
            raise DefectError(position, "packed data go on behind the container's end")
    elif method != _UNCOMPRESSED:
        raise DefectError(
            position, f"unknown compression {method}; known are 0 (none) and 2 (zlib)"
        )
    if len(content) != unpacked_bytes:
        raise DefectError(
            position, f"container holds {len(content)} bytes, declared are {unpacked_bytes}"
        )
    return content


def _entry(item: _Object, start_s: float, buses: Buses) -> tuple[float, Frame] | Skipped | None:
    """The frame in an object; None for one that has to do with something else."""
    if item.kind in _ERROR_TYPES:
        return Skipped.ERROR
    layout = _LAYOUTS.get(item.kind)
    if layout is None:
        return None
    if len(item.body) < layout.size:
        raise DefectError(
            item.position, f"frame object of {len(item.body)} bytes, not {layout.size}"
        )
    fields = layout.unpack_from(item.body)
    if layout is _FD_MESSAGE_64:
        dlc, data_bytes, can_id, fd_flags, data_end = fields
        end = data_end or len(item.body)
        data = item.body[layout.size : end][:data_bytes]
        is_fd, is_remote = bool(fd_flags & _FD_BIT_64), bool(fd_flags & _REMOTE_BIT_64)
    elif layout is _FD_MESSAGE:
        flags, dlc, can_id, fd_flags, data = fields
        is_fd, is_remote = bool(fd_flags & _FD_BIT), bool(flags & _REMOTE_BIT)
    else:
        flags, dlc, can_id, data = fields
        is_fd, is_remote = False, bool(flags & _REMOTE_BIT)
    if is_remote:
        return Skipped.REMOTE
    if dlc >= len(_LENGTH_OF_DLC):
        raise DefectError(item.position, f"data length code {dlc} is outside 0..15")
    length = _LENGTH_OF_DLC[dlc] if is_fd else min(dlc, _MAX_CLASSIC_LENGTH)
    frame = Frame(
        can_id & _ID_MASK,
        # loggers leave out zeros at the end (python-can issue 1905)
        data[:length].ljust(length, b"\0"),
        is_fd,
        bool(can_id & _EXTENDED_BIT),
    )
    time_s, frame = start_s + _time_s(item), checked(frame, item.position)
    bus = item.body[0] if layout is _FD_MESSAGE_64 else int.from_bytes(item.body[:2], "little")
    return (time_s, frame) if buses.keeps(str(bus)) else None


def _time_s(item: _Object) -> float:
    unit, _, _, time = _OBJECT_TIME.unpack_from(item.time)
    if unit not in _UNITS_S:
        raise DefectError(
            item.position, f"unknown time unit {unit}; known are 1 (10 us) and 2 (1 ns)"
        )
    return float(time * _UNITS_S[unit])


def _epoch_s(systemtime: list[int]) -> float:
    """The SYSTEMTIME of the header (year, month, weekday, day, hour ... ms) as seconds; 0 when
    there is none."""
    year, month, _, day, hour, minute, second, millisecond = systemtime
    try:
        start = datetime(year, month, day, hour, minute, second, millisecond * 1000, tzinfo=UTC)
    except ValueError:
        return 0.0
    return start.timestamp()
