"""The truck's other nodes on the bus: each message at its cycle time, from the rig's truth.

All that chance decides comes from a stream of its own, so a rig that plays these nodes too draws
the same gearbox, and runs the same, as one that does not.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from meshpoint.dbc.fields import FieldKind, make_enums
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import Codec, make_codec
from meshpoint.dbc.truck import TRUCK_SCHEMA
from meshpoint.rig_sim.shared.world import READ_US, Truth
from meshpoint.rig_sim.truck_nodes.brakes import BrakeController, Values
from meshpoint.rig_sim.truck_nodes.output_shaft import OutputShaft

STREAM: Final = 0x7A11
"""Keeps these draws apart from those of the gearbox, its start and its delays."""
DELAY_US: Final = 5_000
"""A value is up to this much old when its frame is handed to the bus: the node's tasks."""
ENUMS: Final = make_enums(TRUCK_SCHEMA)


class Cyclic:
    """One message, sent once in its cycle, at a phase of its own."""

    def __init__(
        self, codec: Codec, source: Callable[[int], Values], rng: np.random.Generator
    ) -> None:
        self._codec, self._source = codec, source
        self._cycle_us = codec.spec.cycle_time_us
        self._phase_us = int(rng.integers(self._cycle_us))

    def is_due(self, read_us: int) -> bool:
        """Whether it falls into the time from this read to the next."""
        return (self._phase_us - read_us) % self._cycle_us < READ_US

    def frame(self, at_us: int) -> Frame:
        """The frame of what its node knew at an instant."""
        codec, buffer = self._codec, bytearray(self._codec.spec.length)
        codec.encode(buffer, 0, self._message(self._source(at_us)))
        return Frame(codec.spec.can_id, bytes(buffer), codec.spec.is_fd)

    def _message(self, values: Values) -> Any:
        """What it says, floats kept within what the signal can carry."""
        kept = dict(values)
        for field in self._codec.fields:
            value = kept.get(field.name)
            if value is not None and field.kind is FieldKind.FLOAT:
                (signal,) = field.signals
                low, high = field.si_value(signal.raw_min), field.si_value(signal.raw_max)
                kept[field.name] = min(max(value, low), high)
        return self._codec.message_type(**kept)


class TruckNodes:
    """Brake controller, tachograph, and the engine's speed of the vehicle."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.Generator(np.random.PCG64([seed, STREAM]))
        self._brakes, self._shaft = BrakeController(self._rng), OutputShaft(self._rng)
        sources = {
            "EBC1": self._brakes.ebc1,
            "EBC2": self._brakes.ebc2,
            "HRW": self._brakes.hrw,
            "VDC2": self._brakes.vdc2,
            "TCO1": self._shaft.tco1,
            "CCVS1": self._shaft.ccvs1,
        }
        self._cyclic = [
            Cyclic(make_codec(spec, ENUMS), sources[spec.name], self._rng)
            for spec in sorted(TRUCK_SCHEMA.messages, key=lambda spec: spec.can_id)
        ]

    def frames(self, truth: Truth, read_us: int) -> list[Frame]:
        """Call at each read, when the truth is that of the read: the frames that are due, in the
        order of their priority."""
        vehicle = truth.vehicle
        self._brakes.turn(read_us, vehicle)
        self._shaft.turn(read_us, truth.speeds_rad_s[-1], vehicle)
        due = [each for each in self._cyclic if each.is_due(read_us)]
        return [each.frame(read_us - int(self._rng.integers(DELAY_US + 1))) for each in due]
