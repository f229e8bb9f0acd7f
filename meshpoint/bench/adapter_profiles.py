"""Adapters as they are reported to behave, for virtual time. None was measured on silicon here.

Sources: python-can issue 1881 (hardware time stamps within 5 us, software ones within 900 us),
can-utils issue 51 (USB adapters hand frames over in bundles), candleLight_fw issue 302 (frames are
dropped silently when its queue is full), python-can pull request 1920 (slcan with CAN FD), the
kernel's default of 10 frames in a transmit queue. What no source gives is marked `assumed`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from meshpoint.bench.adapter import AdapterProfile
from meshpoint.dbc.schema import SCHEMA
from meshpoint.gearbox import GearboxSheet

SOFTWARE_US: Final = 900
USB_FULL_SPEED_US: Final = 1_000
USB_HIGH_SPEED_US: Final = 125
PAUSE_EVERY_US: Final = 10_000_000
PAUSE_US: Final = 10_000
CLOCK_PPM: Final = 50.0
ASSUMED: Final = "assumed: a pause of 10 ms each 10 s, a clock 50 ppm off, least delays"

USB: Final = AdapterProfile(
    "USB",
    delay_us=200,
    jitter_us=SOFTWARE_US,
    bundle_us=USB_FULL_SPEED_US,
    stall_every_us=PAUSE_EVERY_US,
    stall_us=PAUSE_US,
    clock_ppm=CLOCK_PPM,
)
"""What adapters on full-speed USB have in common."""

PROFILES: Final[dict[str, AdapterProfile]] = {
    profile.name: profile
    for profile in (
        AdapterProfile("ideal", source="nothing between node and bus"),
        replace(
            USB,
            name="kvaser",
            delay_us=100,
            jitter_us=SOFTWARE_US // 2,
            bundle_us=USB_HIGH_SPEED_US,
            queue_frames=1000,
            source=f"python-can 1881, can-utils 51; high-speed USB. {ASSUMED}",
        ),
        replace(
            USB,
            name="pcan-usb",
            queue_frames=1000,
            source=f"python-can 1881, can-utils 51; bundles of 1 ms. {ASSUMED}",
        ),
        replace(
            USB,
            name="candlelight",
            queue_frames=10,
            clock_ppm=-CLOCK_PPM,
            source="python-can 1881, can-utils 51, candleLight_fw 302 (a full queue swallows "
            f"frames), the kernel's queue of 10. {ASSUMED}",
        ),
        replace(
            USB,
            name="slcan",
            bytes_per_s=11_520,
            overhead_bytes=11,
            bytes_per_data_byte=2,
            source="python-can's slcan: text at 115,200 baud by default, B + identifier + length + "
            f"two digits a byte. {ASSUMED}",
        ),
        replace(
            USB,
            name="slcan-usb",
            bytes_per_s=600_000,
            overhead_bytes=11,
            bytes_per_data_byte=2,
            source="the same text over a USB serial port that ignores the baud rate. Assumed: 600 "
            f"kB/s, half of what full-speed USB carries. {ASSUMED}",
        ),
        AdapterProfile(
            "socketcand",
            is_fd=False,
            source="socketcand's protocol has no CAN FD in python-can 4.6",
        ),
    )
}
"""Each profile by its name."""


def unfit(profile: AdapterProfile, classic: GearboxSheet | None = None) -> str | None:
    """Why our messages cannot go through an adapter; None: they can. Known before anything moves:
    the contract says what is sent how often. classic: the data sheet of a gearbox on a bus of the
    classic profile, whose messages depend on its speeds; None: the FD profile."""
    if classic is None and not profile.is_fd:
        return (
            f"{profile.name} carries classic frames alone, our edge frames have 64 bytes; "
            "--profile classic has frames of 8"
        )
    if not profile.bytes_per_s:
        return None
    wanted = (
        _wanted_bytes_per_s(profile) if classic is None else _classic_bytes_per_s(profile, classic)
    )
    if wanted > profile.bytes_per_s:
        return (
            f"{profile.name} carries {profile.bytes_per_s / 1000:.1f} kB/s, our cyclic messages "
            f"alone are {wanted / 1000:.0f} kB/s as it writes them"
        )
    return None


def _wanted_bytes_per_s(profile: AdapterProfile) -> float:
    return sum(
        message_bytes(profile, spec.length) * 1e6 / spec.cycle_time_us
        for spec in SCHEMA.messages
        if spec.is_cyclic
    )


def _classic_bytes_per_s(profile: AdapterProfile, sheet: GearboxSheet) -> float:
    from meshpoint.bus.classic.traffic import classic_traffic

    frames_per_s = sum(1e9 / message.period_ns for message in classic_traffic(sheet))
    return frames_per_s * message_bytes(profile, 8)


def message_bytes(profile: AdapterProfile, length: int) -> int:
    """A frame's size between computer and adapter."""
    return profile.overhead_bytes + profile.bytes_per_data_byte * length
