"""A participant on a CAN network that nobody coordinates, by SIL Kit's C interface.

Not by silkit-py's objects: those hold Python's lock while SIL Kit waits for its own thread to end,
and that thread waits for the lock wherever a frame arrives meanwhile. On a network with traffic a
participant never came back from leaving. ctypes gives the lock away for each call.

Structures: silkit/capi/Can.h, Types.h and InterfaceIdentifiers.h of SIL Kit 5."""

from __future__ import annotations

import ctypes as c
import functools
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from can.util import len2dlc

from meshpoint.bus.silkit.library import Heard, SilKitError, flags_of, joined, library
from meshpoint.bus.simulated.frame_bits import WireFrame

FRAME_OF_VERSION_1: Final = int.from_bytes(b"SK\x01\x01\x01\0\0\0", "big")
"""Service CAN, data type frame, version: what the header of a frame says."""
RECEIVED: Final = 2
"""Direction of a frame that another participant sent."""


class _Header(c.Structure):
    _fields_ = (("version", c.c_uint64), ("reserved", c.c_uint64 * 3))


class _Frame(c.Structure):
    _fields_ = (
        ("header", _Header),
        ("can_id", c.c_uint32),
        ("flags", c.c_uint32),
        ("dlc", c.c_uint16),
        ("sdt", c.c_uint8),
        ("vcid", c.c_uint8),
        ("af", c.c_uint32),
        ("data", c.c_void_p),
        ("size", c.c_size_t),
    )


class _FrameEvent(c.Structure):
    _fields_ = (
        ("header", _Header),
        ("time_ns", c.c_uint64),
        ("frame", c.POINTER(_Frame)),
        ("direction", c.c_uint8),
        ("context", c.c_void_p),
    )


_HANDLER: Final = c.CFUNCTYPE(None, c.c_void_p, c.c_void_p, c.POINTER(_FrameEvent))
_POINTER: Final = c.POINTER(c.c_void_p)
_CALLS: Final[dict[str, tuple[Any, ...]]] = {
    "SilKit_ParticipantConfiguration_FromString": (_POINTER, c.c_char_p),
    "SilKit_ParticipantConfiguration_Destroy": (c.c_void_p,),
    "SilKit_Participant_Create": (_POINTER, c.c_void_p, c.c_char_p, c.c_char_p),
    "SilKit_Participant_Destroy": (c.c_void_p,),
    "SilKit_CanController_Create": (_POINTER, c.c_void_p, c.c_char_p, c.c_char_p),
    "SilKit_CanController_AddFrameHandler": (
        c.c_void_p, c.c_void_p, _HANDLER, c.c_uint8, c.POINTER(c.c_uint64),
    ),
    "SilKit_CanController_Start": (c.c_void_p,),
    "SilKit_CanController_SendFrame": (c.c_void_p, c.POINTER(_Frame), c.c_void_p),
}  # fmt: skip
"""The calls and their arguments; each returns a code, of which 0 is success."""


class Participant:
    """A participant with one CAN controller, on one network, until `leave`.

    take: called with each frame that others send, in SIL Kit's own thread.

    SilKitError where silkit-py is not installed, where no registry is there or it refuses the name.
    """

    def __init__(
        self, name: str, registry: str, network: str, take: Callable[[Heard], None]
    ) -> None:
        def on_frame(_context: Any, _controller: Any, event: Any) -> None:
            take(_heard(event.contents.frame.contents))

        self._participant: c.c_void_p | None = _join(name, registry)
        self._controller = c.c_void_p()
        self._on_frame = _HANDLER(on_frame)
        try:
            self._listen(network)
        except RuntimeError as error:
            self.leave()
            raise SilKitError(f"SIL Kit, participant {name}, network {network}: {error}") from error

    def _listen(self, network: str) -> None:
        _call(
            "SilKit_CanController_Create",
            c.byref(self._controller), self._participant, b"can", network.encode(),
        )  # fmt: skip
        _call(
            "SilKit_CanController_AddFrameHandler",
            self._controller, None, self._on_frame, RECEIVED, c.byref(c.c_uint64()),
        )  # fmt: skip
        _call("SilKit_CanController_Start", self._controller)

    def send(self, frame: WireFrame) -> None:
        """Hands a frame to all others on the network."""
        data = frame.data
        dlc = len2dlc(len(data)) if frame.dlc is None else frame.dlc
        wired = _Frame(_Header(FRAME_OF_VERSION_1), frame.can_id, flags_of(frame), dlc)
        kept = c.create_string_buffer(data, len(data))
        wired.data, wired.size = c.addressof(kept), len(data)
        _call("SilKit_CanController_SendFrame", self._controller, c.byref(wired), None)

    def leave(self) -> None:
        """Leaves the network; frames that arrive meanwhile are still taken."""
        leaving, self._participant = self._participant, None
        if leaving is not None:
            _call("SilKit_Participant_Destroy", leaving)


def _heard(frame: Any) -> Heard:
    """Copied: SIL Kit's own is gone when the handler ends."""
    data = c.string_at(frame.data, frame.size) if frame.size else b""
    return Heard(frame.can_id, data, frame.flags, frame.dlc)


def _join(name: str, registry: str) -> c.c_void_p:
    settings, participant = c.c_void_p(), c.c_void_p()
    where = name.encode(), registry.encode()
    _call("SilKit_ParticipantConfiguration_FromString", c.byref(settings), b"")
    try:
        joined(
            lambda: _call("SilKit_Participant_Create", c.byref(participant), settings, *where),
            name, registry,
        )  # fmt: skip
    finally:
        _call("SilKit_ParticipantConfiguration_Destroy", settings)
    return participant


def _call(name: str, *arguments: Any) -> None:
    """RuntimeError where SIL Kit refuses, as of silkit-py."""
    silkit = _interface()
    if getattr(silkit, name)(*arguments):
        said = silkit.SilKit_GetLastErrorString() or b"no reason given"
        raise RuntimeError(said.decode(errors="replace"))


@functools.cache
def _interface() -> c.CDLL:
    """The library that silkit-py brings, with its calls declared."""
    folder = Path(str(library().__file__)).parent
    names = {"win32": "SilKit.dll", "darwin": "libSilKit.dylib"}
    silkit = c.CDLL(str(folder / names.get(sys.platform, "libSilKit.so")))
    for name, arguments in _CALLS.items():
        function = getattr(silkit, name)
        function.argtypes, function.restype = arguments, c.c_int32
    silkit.SilKit_GetLastErrorString.restype = c.c_char_p
    return silkit
