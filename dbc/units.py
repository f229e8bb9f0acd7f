"""Units of the wire and what they become inside: the DBC's rpm, bar, mm ... turned into SI."""

from __future__ import annotations

import math
from typing import Final, NamedTuple


class Unit(NamedTuple):
    """SI value = wire value * `factor` + `offset`; `suffix` ends the name of an SI field."""

    suffix: str
    factor: float
    offset: float
    is_integer: bool
    """True where a whole number on the wire stays a whole number inside."""


UNITS: Final[dict[str, Unit]] = {
    "": Unit("", 1.0, 0.0, True),
    "us": Unit("_us", 1.0, 0.0, True),
    "rpm": Unit("_rad_s", math.pi / 30.0, 0.0, False),
    "deg": Unit("_rad", math.pi / 180.0, 0.0, False),
    "bar": Unit("_pa", 1e5, 0.0, False),
    "mm": Unit("_m", 1e-3, 0.0, False),
    "degC": Unit("_k", 1.0, 273.15, False),
    "km/h": Unit("_m_s", 1.0 / 3.6, 0.0, False),
    "m/s2": Unit("_m_s2", 1.0, 0.0, False),
    "J": Unit("_j", 1.0, 0.0, False),
    "%": Unit("_fraction", 1e-2, 0.0, False),
}
"""Every unit a signal of the DBC may have, by its text in the DBC."""
