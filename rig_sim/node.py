"""The rig on a bus: bytes and a time, no decisions."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from secrets import randbits
from typing import Final

from meshpoint.bus.clock import NodeClock
from meshpoint.bus.command_keys import CommandKeys
from meshpoint.bus.core import Core
from meshpoint.bus.driver import OpenBus, run_node
from meshpoint.bus.optional import classic_rig, verified
from meshpoint.bus.profile import WireProfile
from meshpoint.bus.settle import settle
from meshpoint.bus.statistics import NodeStatistics
from meshpoint.gearbox import GearboxSheet
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import RigSettings

ADDRESSES: Final = frozenset({0x80, 0x81, 0x00})
"""Gearbox, reference instrumentation and engine: the rig plays all three."""
TRUCK_ADDRESSES: Final = frozenset({0x0B, 0xEE})
"""Brake controller and tachograph, where it plays the truck's other nodes too."""


async def run_rig(
    sheet: GearboxSheet,
    settings: RigSettings,
    open_bus: OpenBus,
    clock: NodeClock,
    *,
    on_event: Callable[[str], None],
    stop: asyncio.Event,
    keys: CommandKeys | None = None,
    wire: WireProfile = WireProfile.FD,
    around: Callable[[Core], Core] | None = None,
) -> NodeStatistics:
    """Runs a rig until `stop` is set; its last frame shows all valves off. With `keys` it takes
    proven commands alone. `wire`: the frames on the bus. `around`: puts a board's firmware
    between rig and bus."""
    core: Core = RigCore(sheet, settings)
    if around is not None:
        core = around(core)
    if wire is WireProfile.CLASSIC:
        core = classic_rig(core, sheet, has_board=around is not None)
    settle()
    return await run_node(
        core if keys is None else verified(core, keys, randbits),
        open_bus,
        clock,
        on_event=on_event,
        stop=stop,
        name="rig",
        own_addresses=ADDRESSES | TRUCK_ADDRESSES if settings.truck_nodes else ADDRESSES,
    )
