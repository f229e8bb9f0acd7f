"""docs/reference/vectors.md: whole frames to hold another sensor or valve side against."""

from __future__ import annotations

from typing import Final

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import (
    EEC1,
    TC1,
    TSC1,
    ClutchAction,
    ClutchCommand,
    EdgesLayshaftRise,
    GearboxSensors,
    Message,
    SleevesMain,
    TscOverrideMode,
    ValveAction,
    ValveCommand,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.rig_sim.shared.valve_drivers import EXPIRY_US, MAX_AHEAD_US, MAX_LATE_US
from meshpoint.units import BAR, MM, RPM

START_US: Final = 0xFFFF_F000
"""Sensor clock of the first vector: it wraps within the next one."""
PERIOD_US: Final = 997
STAMPS: Final = 27
ALL: Final = (Node.GEARBOX_IO, Node.ENGINE, Node.BENCH, Node.TRANSMISSION_CONTROL)


def vectors() -> list[tuple[str, Message]]:
    """Frames in the order in which they are sent, and what each of them says, in words."""
    newest = [(START_US - 250 - k * PERIOD_US) & 0xFFFF for k in range(STAMPS)]
    return [
        (
            f"read at {START_US}; edge 5 was the newest, 250 us before, the others each "
            f"{PERIOD_US} us earlier; only 5 have come since power-up",
            EdgesLayshaftRise(START_US, 5, 5, False, False, False, (*newest[:5], *[0] * 22)),
        ),
        (
            "10 ms later, beyond the clock's wrap: ten more edges",
            EdgesLayshaftRise(
                (START_US + 10_000) & 0xFFFF_FFFF, 15, 15, False, False, False,
                tuple((START_US + 10_000 - 280 - k * PERIOD_US) & 0xFFFF for k in range(15))
                + (0,) * 12,
            ),
        ),
        (
            "no edge for longer than 65,535 us: stopped",
            EdgesLayshaftRise(100_000, 15, 15, False, True, False, (4_000,) + (0,) * 26),
        ),
        (
            "brake valve open to the air, 9.513 bar supply (absolute), oil 80 deg C, clutch closed",
            GearboxSensors(100_000, 1.013 * BAR, 9.513 * BAR, 353.15, 1.0),
        ),
        (
            "first gear 12 mm in, the other sleeve in neutral, no sensor fault",
            SleevesMain(100_000, 0, (-12.0 * MM,) * 10, (0.0,) * 10),
        ),
        (
            "brake driven, MainSecond waits for its activation",
            ValveStatus(
                sample_time_us=100_000, brake_energised=True, main_second_pending=True,
                refused_count=0, expired_count=0,
            ),
        ),
        (
            "engine at 1,200 rpm, actual torque 25 %",
            EEC1(engine_speed_rad_s=1200.0 * RPM, actual_engine_torque_fraction=0.25),
        ),
        (
            "brake on now; MainSecond on at 104,000 us",
            ValveCommand(
                brake_action=ValveAction.ON_NOW,
                main_second_action=ValveAction.ON_AT,
                main_second_time_us=104_000,
            ),
        ),
        ("all valves off", ValveCommand()),
        ("clutch open", ClutchCommand(action=ClutchAction.OPEN)),
        ("gear 10 is asked for", TC1(requested_gear=10)),
        (
            "the engine is asked for 1,400 rpm",
            TSC1(
                override_control_mode=TscOverrideMode.SPEED_CONTROL,
                requested_speed_rad_s=1400.0 * RPM,
            ),
        ),
    ]  # fmt: skip


VALVE_SIDE: Final = (
    ("OnAt, activation 4 ms ahead", "waits; on at the activation, to within 100 us"),
    (f"OnAt, first received {MAX_LATE_US // 1000} ms after its activation", "on at once"),
    (
        f"OnAt, first received {MAX_LATE_US // 1000} ms and 1 us after its activation",
        "refused: slot empty, valve as it is, RefusedCount + 1 once",
    ),
    (f"OnAt, {MAX_AHEAD_US // 1000} ms ahead", "waits"),
    (f"OnAt, {MAX_AHEAD_US // 1000} ms and 1 us ahead", "refused, counted once"),
    ("the same OnAt again, while it waits", "nothing changes"),
    ("the same OnAt again, after it has passed and the valve is off", "stays off"),
    ("OnAt with another time, while one waits", "the new one waits"),
    ("OffNow, while one waits", "off, slot empty"),
    ("a frame with a wrong CRC, or a repeated counter", "as not received: does not renew expiry"),
    (
        f"no valid frame for {EXPIRY_US // 1000} ms",
        "all off, all slots empty, ExpiredCount + 1",
    ),
)
"""What a valve side is sent, and what it does: each has a test of the rig's valve drivers."""


def encoded() -> list[tuple[str, str, Frame]]:
    """Name, words and frame of each vector; counters rise with each frame of an identifier."""
    sender = Transmitter(*ALL)
    return [(type(message).__name__, words, sender.encode(message)) for words, message in vectors()]


def rows() -> list[tuple[str, str, str, str, str]]:
    """Of the page's table of frames."""
    found = []
    for name, words, frame in encoded():
        data_id = CODECS[name].spec.data_id
        found.append(
            (
                name,
                words,
                f"`{frame.can_id:08X}`",
                "-" if data_id is None else f"`{data_id:04X}`",
                f"`{'##1' if frame.is_fd else '#'}{frame.data.hex().upper()}`",
            )
        )
    return found
