"""The controller on a bus: bytes and a time, no decisions."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Final

from bus.clock import NodeClock
from bus.driver import OpenBus, run_node
from bus.settle import settle
from bus.statistics import NodeStatistics
from controller.core import OWN_ADDRESS, ControllerCore
from controller.header import RunHeader
from controller.warm_up import warm_up

ADDRESSES: Final = frozenset({OWN_ADDRESS})


async def run_controller(
    header: RunHeader,
    open_bus: OpenBus,
    clock: NodeClock,
    *,
    on_event: Callable[[str], None],
    stop: asyncio.Event,
) -> NodeStatistics:
    """Runs a controller until `stop` is set; its last frames switch all valves off."""
    warm_up()
    core = ControllerCore(header)
    settle()
    return await run_node(
        core,
        open_bus,
        clock,
        on_event=on_event,
        stop=stop,
        name="controller",
        own_addresses=ADDRESSES,
    )
