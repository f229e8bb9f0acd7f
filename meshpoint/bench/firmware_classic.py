"""The firmware of a board on a classic bus."""

from __future__ import annotations

from typing import Final

from meshpoint.dbc.classic.codecs import CLASSIC_CODECS
from meshpoint.gearbox import GearboxSheet
from meshpoint.rig_sim.command_inbox import CLUTCH, VALVES

ORDERS, TIME = (CLASSIC_CODECS[name].spec.can_id for name in ("ValveOrders", "ValveTime"))
COMMANDS: Final = {ORDERS: frozenset((VALVES, CLUTCH)), TIME: frozenset[int]()}
"""As `FD_COMMANDS` of the rig with a board."""


def classic_options(sheet: GearboxSheet) -> tuple[str, ...]:
    """What it is built with: ETC1 has speeds, for which the teeth of two wheels are counted."""
    wheels = sheet.wheels
    return (
        "-DPROFILE_CLASSIC=1",
        f"-DTEETH_INPUT={wheels.input_.teeth}",
        f"-DTEETH_PROPELLER={wheels.propeller.teeth}",
    )
