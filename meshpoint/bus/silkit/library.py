"""Vector SIL Kit through `silkit-py`: participants, and frames in its form.

The package is experimental, so the extra pins it. It needs Python 3.12 or newer, and brings
library, registry and system controller."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from meshpoint.bus.simulated.frame_bits import WireFrame, check_frame

REGISTRY: Final = "silkit://localhost:8500"
"""Where SIL Kit's own tools expect a registry."""
NETWORK: Final = "CAN1"
MODULE: Final = "SilKit_py"
UNANSWERED: Final = "Timeout during connection handshake"
"""So ended 10 of 480 tries to join while another participant left, after 5 s, beside other work;
the next try succeeds."""

# SilKit_CanFrameFlag in silkit/capi/Can.h; plain integers, as send_frame takes them.
RTR: Final = 1 << 4
IDE: Final = 1 << 9
FDF: Final = 1 << 12
BRS: Final = 1 << 13
ESI: Final = 1 << 14
XLF: Final = 1 << 15


class SilKitError(Exception):
    """SIL Kit is not there, or refuses; one line for the user."""


class Heard(NamedTuple):
    """A frame as SIL Kit passes it on."""

    can_id: int
    data: bytes
    flags: int
    dlc: int


def library(name: str = MODULE) -> Any:
    """The package, or a module of it. SilKitError where it is not installed, with what installs
    it."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise SilKitError(
            f"{MODULE} is not installed: pip install 'meshpoint[silkit]', in Python 3.12 or newer"
        ) from error


def join(name: str, registry: str) -> Any:
    """A participant of this name, by its registry; it leaves when nothing refers to it any more.

    SilKitError where no registry is there, or it refuses the name."""
    silkit = library()
    settings = silkit.participant_configuration_from_String("")
    return joined(lambda: silkit.create_participant(settings, name, registry), name, registry)


def joined(attempt: Callable[[], Any], name: str, registry: str) -> Any:
    """What `attempt` returns, which joins; a registry that does not answer is asked once more.

    SilKitError where no registry is there, or it refuses the name."""
    try:
        try:
            return attempt()
        except RuntimeError as error:
            if UNANSWERED not in str(error):
                raise
            return attempt()
    except RuntimeError as error:
        said = " ".join(str(error).split())
        raise SilKitError(f"SIL Kit, participant {name}, registry {registry}: {said}") from error


def send(controller: Any, frame: WireFrame) -> None:
    """Hands a frame to a CAN controller of silkit-py."""
    controller.send_frame(frame.can_id, frame.data, flags_of(frame), frame.dlc)


def flags_of(frame: WireFrame) -> int:
    """A frame's flags as SIL Kit has them."""
    return (
        (IDE if frame.is_extended else 0)
        | (FDF if frame.is_fd else 0)
        | (BRS if frame.bitrate_switch else 0)
        | (ESI if frame.error_state else 0)
        | (RTR if frame.is_remote else 0)
    )


def heard(event: Any) -> Heard:
    """What a frame handler gets, copied: SIL Kit's own is gone when the handler ends."""
    frame = event.frame
    return Heard(frame.can_id, frame.data, frame.flags, frame.dlc)


def wire_frame(frame: Heard) -> WireFrame:
    """A frame that was heard. ValueError for CAN XL, and for what no CAN bus could carry: SIL Kit
    passes everything on."""
    can_id, data, flags, dlc = frame
    if flags & XLF:
        raise ValueError("CAN XL, allowed are classic CAN and CAN FD")
    is_fd, is_extended, is_remote = bool(flags & FDF), bool(flags & IDE), bool(flags & RTR)
    wired = WireFrame(
        can_id, data, is_fd, is_extended, bool(flags & BRS), is_remote, bool(flags & ESI),
        dlc if is_remote else None,
    )  # fmt: skip
    check_frame(wired)
    return wired
