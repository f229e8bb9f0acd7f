"""The controller on a bus: bytes and a time, no decisions."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from meshpoint.bus.clock import NodeClock
from meshpoint.bus.command_keys import CommandKeys
from meshpoint.bus.core import Core
from meshpoint.bus.driver import OpenBus, run_node
from meshpoint.bus.optional import (
    classic_controller,
    classic_signs,
    diagnosed,
    proven,
    recorded_steps,
)
from meshpoint.bus.profile import WireProfile
from meshpoint.bus.records import Records
from meshpoint.bus.settle import settle
from meshpoint.bus.statistics import NodeStatistics
from meshpoint.controller.core.core import OWN_ADDRESS, ControllerCore
from meshpoint.controller.run.calibration_keeper import CalibrationKeeper, Keep
from meshpoint.controller.run.only_one import SIGNS, OnlyController, OtherControllerError
from meshpoint.controller.run.outage_record import OutageRecord
from meshpoint.controller.run.warm_up import warm_up
from meshpoint.controller.settings.header import RunHeader
from meshpoint.dbc.messages import Estimator

ADDRESSES: Final = frozenset({OWN_ADDRESS})


async def run_controller(
    header: RunHeader,
    open_bus: OpenBus,
    clock: NodeClock,
    *,
    on_event: Callable[[str], None],
    stop: asyncio.Event,
    keep: Keep | None = None,
    keys: CommandKeys | None = None,
    diagnosis: bool = False,
    record: Path | None = None,
    wire: WireProfile = WireProfile.FD,
    address: int = OWN_ADDRESS,
) -> NodeStatistics:
    """Runs a controller until `stop` is set; its last frames switch all valves off.
    OtherControllerError where there is another one on the bus (`controller/run/only_one.py`).

    `keep` gets the calibration whenever more is known, and at the end. With `keys` commands are
    proven to be ours. With `diagnosis` it claims its address, reports its trouble codes and answers
    testers (docs/diagnosis.md). `record`: a folder, that of the run header, for what a replay needs
    to know of link outages, and of every step where `wire` is classic; what of it cannot be written
    is said and counted. `wire`: the frames on the bus. `address`: the controller's on this bus,
    which `open_bus` has put in the DBC's place."""
    warm_up(baselines=header.settings.estimator is not Estimator.CROSSING)
    core = ControllerCore(header)
    kept: Core = core if keep is None else CalibrationKeeper(core, keep, _utc)
    statistics = NodeStatistics()
    records = None if record is None else Records(record)
    if records is not None and wire is WireProfile.FD:
        kept = OutageRecord(kept, records, header.run_hash, lambda: statistics.frames_discarded)
    node = kept if keys is None else proven(kept, keys)
    if diagnosis:
        node = diagnosed(node, header.version, address)
    if wire is WireProfile.CLASSIC:
        node = classic_controller(node, header.sheet)
        if records is not None:
            node = recorded_steps(node, records, header.run_hash, diagnosed=diagnosis)
    signs = classic_signs() if wire is WireProfile.CLASSIC else SIGNS
    only = OnlyController(node, stop.set, signs, is_proven=keys is not None)
    settle()
    await run_node(
        only,
        open_bus,
        clock,
        on_event=on_event,
        stop=stop,
        name="controller",
        own_addresses=ADDRESSES,
        statistics=statistics,
        on_own=only.receive_own,
        records=records,
    )
    if only.conflict:
        raise OtherControllerError(only.conflict)
    return statistics


def _utc(_now_us: int) -> str:
    """The wall clock, for people: the controller's own clock begins anywhere."""
    return datetime.now(UTC).isoformat(timespec="seconds")
