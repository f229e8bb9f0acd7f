"""What the room says of a sleeve. Times are integer microseconds of the sensor clock."""

from __future__ import annotations

from typing import NamedTuple

from meshpoint.controller.settings.valve_name import ValveName


class Place(NamedTuple):
    """A sleeve at an instant."""

    m: float
    """From neutral, in the sensor's direction, its offset and gain taken out."""
    speed_m_s: float
    is_moving: bool


class Stroke(NamedTuple):
    """A stroke until it meets the gear's teeth."""

    contact_us: int
    sd_us: float
    freedom: float
    """From how many contacts the scatter is known: degrees of freedom of the contact's Student
    law."""
    contact_speed_m_s: float


class Halt(NamedTuple):
    """A sleeve stopped in flight: the valve that drives it goes off at the abort, the opposite one
    comes on then and goes off at `off_us`."""

    at_us: int
    off_us: int
    m: float
    """Where it will stand."""
    sd_m: float


class Pulse(NamedTuple):
    """One valve on, then off, so that the sleeve comes to rest in neutral."""

    valve: ValveName
    on_us: int
    off_us: int
    m: float
    """Where it comes to rest."""
