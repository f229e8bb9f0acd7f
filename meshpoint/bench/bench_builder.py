"""Controller, rig and operator on one virtual bus, put together here for all who run them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from meshpoint.bench.adapter import AdapterCore
from meshpoint.bench.bench import BENCH_IDS, TICK_US
from meshpoint.bench.loaded_bus import LoadedBus
from meshpoint.bench.setup import Setup
from meshpoint.bench.shared_bus import NEVER_US, Elsewhere, SharedBus
from meshpoint.bench.virtual_time import VirtualTime
from meshpoint.bus.core import Core
from meshpoint.bus.optional import proven, recorded_steps, verified
from meshpoint.bus.profile import WireProfile
from meshpoint.bus.records import Records
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.node import Node

RIG_NODES: Final = frozenset((Node.GEARBOX_IO, Node.ENGINE, Node.REFERENCE))
SPECS: Final = tuple(codec.spec for codec in CODECS.values())
ALL_IDS: Final = frozenset(spec.can_id for spec in SPECS)
RIG_IDS: Final = frozenset(spec.can_id for spec in SPECS if spec.receivers & RIG_NODES)


class Onlooker(NamedTuple):
    """One more node on the bus."""

    core: Core
    reads: frozenset[int]
    """The identifiers of the DBC that its acceptance filter lets through."""
    first_us: int
    """When it steps first, and hears from then on."""


@dataclass(frozen=True)
class VirtualBench:
    """A bench as it was put together."""

    time: VirtualTime
    """Lets time go on."""
    controller: Core
    """The controller as it is on the bus: its `shutdown` ends a run."""
    adapter: AdapterCore | None
    """What lies between it and the bus; None: nothing."""
    loaded: LoadedBus | None
    """The bus where other nodes load it; None: it is our own."""


def virtual_bench(
    setup: Setup,
    controller: Core,
    rig: Core,
    operator: Core,
    *onlookers: Onlooker,
    on_frame: Callable[[int, Frame], None] | None = None,
    on_event: Callable[[int, int, str], None] | None = None,
    records: Records | None = None,
    shared: SharedBus | None = None,
) -> VirtualBench:
    """These cores, with what `setup` has between them and their bus, on that bus.

    on_frame, on_event: as in `VirtualTime`. records: take a classic run's steps, to be verified
    by. shared: the bus, where cores are `Elsewhere`."""
    phases_us = [
        NEVER_US if isinstance(core, Elsewhere) else phase_us
        for core, phase_us in zip((controller, rig, operator), tick_phases(setup.seed), strict=True)
    ]
    if setup.keys is not None:
        controller = proven(controller, setup.keys)
        rig = verified(rig, setup.keys, _random_bits(setup.seed))
    cores = [controller, rig, operator, *(onlooker.core for onlooker in onlookers)]
    if setup.wire is WireProfile.CLASSIC:
        cores = _on_classic_bus(setup, cores, records)
    adapter = None
    if setup.adapter is not None:
        cores[0] = adapter = AdapterCore(cores[0], setup.adapter, setup.seed)
    loaded = None
    if setup.bus_load is not None:
        loaded = LoadedBus(setup.bus_load, setup.seed, setup.bus_queue)
    reads = (ALL_IDS, RIG_IDS, BENCH_IDS, *(onlooker.reads for onlooker in onlookers))
    time = VirtualTime(
        cores,
        [*phases_us, *(onlooker.first_us for onlooker in onlookers)],
        on_frame,
        on_event,
        [ALL_IDS - ids for ids in reads],
        shared if loaded is None else loaded,
    )
    if adapter is not None:
        adapter.now_us = lambda: time.now_us
    return VirtualBench(time, cores[0], adapter, loaded)


def _on_classic_bus(setup: Setup, cores: Sequence[Core], records: Records | None) -> list[Core]:
    from meshpoint.bus.classic.cores import on_classic_bus

    classic = on_classic_bus(setup.sheet, *cores, has_board=setup.firmware is not None)
    if records is not None:
        classic[0] = recorded_steps(classic[0], records, setup.header.run_hash, diagnosed=False)
    return classic


def tick_phases(seed: int) -> list[int]:
    """First step times of controller, rig and operator: real nodes do not tick together."""
    rng = np.random.Generator(np.random.PCG64([seed, 0x7_1C]))
    return [int(phase) for phase in rng.integers(0, TICK_US, 3)]


def _random_bits(seed: int) -> Callable[[int], int]:
    """Draws challenges of a run that can be repeated; live ones are the operating system's."""
    rng = np.random.Generator(np.random.PCG64([seed, 0xC4A1]))
    return lambda bits: int.from_bytes(rng.bytes(bits // 8), "little")
