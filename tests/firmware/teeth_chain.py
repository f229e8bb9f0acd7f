"""Two boards on a table: one plays a rig's shafts on four pins, the other reads them.

    python tests/firmware/teeth_chain.py [--seeds 10] [--bus-load 0.5] [--ppm 0]

Ten shifts of a simulated gearbox from each seed, its frames as they come off the bus; says how many
edges the rig's frames reported, what became of them, and by how much the intervals differ.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from ctypes import c_uint32
from itertools import pairwise
from typing import NamedTuple

from firmware_bench import AT_REST, BY_ID, WRAP

from meshpoint.bench.firmware_rig import EDGES as EDGE_IDS
from meshpoint.bench.schedules import MIXED
from meshpoint.bench.setup import Setup
from meshpoint.bench.simulate import simulate
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import read_alone
from meshpoint.firmware.build import BOTH_IMAGES, IMAGES, library, source_folder
from meshpoint.firmware.native_board import CHANNELS, EDGES, WHEELS, NativeBoard
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Profile

READ_US = 10_000
DELAY_US = 30_000
"""As firmware/teeth.c has it: from a frame that comes at its earliest to its read's edges."""
FOUND_US = 1_100_000
"""When a rig that is heard from the beginning is played."""
NEAR_US = 150.0
"""Two edges of a channel are further apart, and the clock does not change as much between them."""
CHANNEL_OF = {can_id: channel for channel, can_id in enumerate(EDGE_IDS)}
Timed = tuple[int, Frame]


class Read(NamedTuple):
    """What an edge frame reports. Times in us, unbounded: they go on where the clock wraps."""

    channel: int
    read_us: int
    edges_us: list[int]
    """Those that the frame before did not have, in order."""


def reads(frames: Iterable[Frame]) -> list[Read]:
    """What the edge frames among them report."""
    last_us, indices, found = [0] * CHANNELS, [0] * CHANNELS, []
    for frame in frames:
        channel = CHANNEL_OF.get(frame.can_id)
        if channel is None:
            continue
        message = read_alone(BY_ID[frame.can_id], frame)
        at_us = last_us[channel] + (message.read_time_us - last_us[channel]) % WRAP
        fresh = (message.newest_index - indices[channel]) % (1 << 16)
        last_us[channel], indices[channel] = at_us, message.newest_index
        edges_us = []
        for low_us in message.timestamp_low_us[: min(fresh, message.valid_stamps)]:
            at_us -= (at_us - low_us) % (1 << 16)
            edges_us.append(at_us)
        found.append(Read(channel, last_us[channel], edges_us[::-1]))
    return found


def edges_of(channel: int, reported: Iterable[Read]) -> list[int]:
    """All edges of one channel, in order."""
    return [edge_us for read in reported if read.channel == channel for edge_us in read.edges_us]


class TwoBoards:
    """Both run by the same clock, which is right but for `ppm`; it shows `start_us` at power-on."""

    def __init__(self, teeth: NativeBoard, sensor: NativeBoard, start_us: int = 0) -> None:
        self.teeth, self._sensor = teeth, sensor
        self._now_us = self._start_us = start_us
        teeth.power_on(start_us % WRAP)
        sensor.power_on(start_us % WRAP)
        self.toggled_us: list[list[int]] = [[] for _ in range(WHEELS)]
        """Of each pin when it was toggled; unbounded."""
        self.sent: list[Frame] = []

    @property
    def not_shown(self) -> int:
        """How many edges the teeth have been sent that they have not shown."""
        reported, shown = (c_uint32.in_dll(self.teeth.code, f"teeth_{what}").value
                       for what in ("reported", "shown"))  # fmt: skip
        return reported - shown

    def hear(self, frames: Iterable[Timed], ppm: float = 0.0) -> None:
        """The teeth hear frames, each at its time since power-on."""
        for time_us, frame in frames:
            self.advance(round(time_us * (1.0 + ppm * 1e-6)))
            self.teeth.receive(frame)

    def advance_by(self, for_us: int) -> None:
        """Goes on for so long."""
        self.advance(self._now_us - self._start_us + for_us)

    def advance(self, to_us: int) -> None:
        """Goes on to this time since power-on; the sensor reads each 10 ms."""
        to_us += self._start_us
        while self._now_us < to_us:
            next_read_us = self._now_us + READ_US - (self._now_us - self._start_us) % READ_US
            next_us = min(to_us, next_read_us)
            for board in (self.teeth, self._sensor):
                board.advance(next_us - self._now_us)
            self._now_us = next_us
            self._wire()
            if next_us == next_read_us:
                self._sensor.read(AT_REST)
                self.sent += self._sensor.take_sent()

    def _wire(self) -> None:
        """The sensor's inputs are the teeth's pins, which were low at power-on."""
        memory = self.teeth.memory
        for wheel, toggled_us in enumerate(self.toggled_us):
            for place in range(len(toggled_us), memory.toggled_count[wheel]):
                low_us = memory.toggled_us[wheel][place % EDGES]
                toggled_us.append(self._now_us - (self._now_us - low_us) % WRAP)
                self._sensor.capture(2 * wheel + place % 2, [low_us])


class Comparison(NamedTuple):
    """What became of a rig's edges. Times in us, each rig's edge in the rig's clock."""

    pairs: list[tuple[int, int]]
    """Edges that were read, and when."""
    missed: list[int]
    extra: list[int]
    """Edges that were read, and are none of the rig's."""

    @property
    def intervals_us(self) -> list[tuple[int, int]]:
        """Between two edges that were both read: as the rig reported it, and as it was read."""
        return [(rig - rig_before, read - read_before)
                for (rig_before, read_before), (rig, read) in pairwise(self.pairs)]  # fmt: skip


def compared(rig_us: Sequence[int], read_us: Sequence[int], shift_us: float) -> Comparison:
    """One channel's edges. shift_us: by which the first one is read later, to within `NEAR_US`."""
    pairs, missed, extra, rest = [], [], [], list(reversed(read_us))
    for edge_us in rig_us:
        while rest and rest[-1] - edge_us < shift_us - NEAR_US:
            extra.append(rest.pop())
        if rest and rest[-1] - edge_us <= shift_us + NEAR_US:
            pairs.append((edge_us, rest.pop()))
            shift_us = pairs[-1][1] - edge_us
        else:
            missed.append(edge_us)
    return Comparison(pairs, missed, extra + rest)


def read_back(
    rig: Sequence[Timed], boards: TwoBoards, ppm: float = 0.0, from_us: int = FOUND_US
) -> list[Comparison]:
    """Of each channel, what came of the edges that are to be shown from a time since power-on. The
    boards have heard the rig's frames, or some of them, and gone on until all was shown."""
    reported, said = reads(frame for _, frame in rig), reads(boards.sent)
    times_us = [
        time_us * (1.0 + ppm * 1e-6) for time_us, frame in rig if frame.can_id in CHANNEL_OF
    ]
    power_on_us = said[0].read_us - READ_US
    shift_us = power_on_us + DELAY_US + min(
        time_us - read.read_us
        for time_us, read in zip(times_us, reported, strict=True) if time_us < from_us
    )  # fmt: skip
    found = []
    for channel in range(CHANNELS):
        rig_us = [edge_us for edge_us in edges_of(channel, reported)
                  if edge_us + shift_us >= power_on_us + from_us]  # fmt: skip
        read_us = [edge_us for edge_us in edges_of(channel, said)
                   if edge_us >= rig_us[0] + shift_us - NEAR_US]  # fmt: skip
        found.append(compared(rig_us, read_us, shift_us))
    return found


def shifts(seed: int, count: int, bus_load: float) -> list[Timed]:
    """The frames of some shifts, as they come off a bus with this load."""
    seen: list[Timed] = []
    setup = Setup(load_sheet("truck12"), ControllerSettings(), seed=seed, shifts=count, pairs=MIXED,
                  profile=Profile.TYPICAL, bus_load=bus_load)  # fmt: skip
    simulate(setup, lambda time_us, frame: seen.append((time_us, frame)))
    while CHANNEL_OF.get(seen[-1][1].can_id) != CHANNELS - 1:
        seen.pop()  # of a read that is not all there
    return seen


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--bus-load", type=float, default=0.5)
    parser.add_argument("--ppm", type=float, default=0.0)
    given = parser.parse_args()
    built = [library(source_folder(), image) for image in (IMAGES["teeth"], BOTH_IMAGES)]
    read = missed = extra = 0
    errors = Counter[int]()
    for seed in range(1, given.seeds + 1):
        frames = shifts(seed, 10, given.bus_load)
        boards = TwoBoards(*map(NativeBoard, built), start_us=WRAP - 2_000_000)
        boards.hear(frames, given.ppm)
        boards.advance_by(2 * DELAY_US)
        for channel in read_back(frames, boards, given.ppm):
            read += len(channel.pairs)
            missed += len(channel.missed)
            extra += len(channel.extra)
            errors.update(abs(was - is_) for was, is_ in channel.intervals_us)
    print(f"{read} edges read back, {missed} not shown, {extra} that are none of the rig's")
    print("intervals that differ by so many us:", dict(sorted(errors.items())))
    return 0


if __name__ == "__main__":
    sys.exit(main())
