"""The truck's plant run ahead: phase and slip of a gear for any moment of letting the brake go.

One trunk with the brake as commanded but never released, and from its samples branches with the
brake let go. What a release changes, beyond the slip it begins with, is interpolated between the
branches of two samples: of neighbours while the brake still fills, wider ones later.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gearbox import MainGear
from rig_sim import truck_layout as at
from rig_sim.truck_plant import Snapshot, TruckPlant

Floats = NDArray[np.float64]
Switches = tuple[tuple[float, float], ...]
"""When the brake's pressure begins to react, in the plant's time, and u from then on."""
SAMPLE_US: Final = 4_000
BRANCH_SAMPLES: Final = 75
TRUNK_SAMPLES: Final = 500
FILLING_US: Final = 250_000
"""So long after it was switched on the brake's pressure stands, and a release changes what it
changes whenever it comes, but for friction."""
COARSE: Final = 20
SAMPLE_S: Final = SAMPLE_US * 1e-6
SAME_RAD: Final = 2e-4
"""A forecast that the truth follows this closely still holds."""


class Path:
    """Phase (unwrapped) and slip of one gear each 4 ms, run on only as far as they are asked for.

    `plant` is a copy that all paths run in turn; each keeps where it stands."""

    def __init__(
        self, plant: TruckPlant, start: Snapshot, gear: MainGear, switches: Switches, pitch: float
    ) -> None:
        self._plant = plant
        self._gear = gear
        self._switches = list(switches)
        self._pitch = pitch
        self._is_at_rest = False
        self.start_us = start.time_us
        plant.restore(start)
        self.phase = [plant.shafts.phase_rad(gear)]
        self.slip = [plant.slip_rad_s(gear)]
        self._snapshots = [start]

    def extend(self, count: int) -> None:
        """At least `count` samples."""
        if len(self.slip) >= count:
            return
        plant = self._plant
        plant.restore(self._snapshots[-1])
        while len(self.slip) < count:
            self._run_to(self.start_us + SAMPLE_US * len(self.slip))
            slip = -plant.main_rad_s if self._is_at_rest else plant.slip_rad_s(self._gear)
            expected = self.phase[-1] + (slip + self.slip[-1]) / 2.0 * SAMPLE_S
            found = expected if self._is_at_rest else plant.shafts.phase_rad(self._gear)
            turns = math.floor((expected - found) / self._pitch + 0.5)
            self.phase.append(found + self._pitch * turns)
            self.slip.append(slip)
            self._snapshots.append(plant.snapshot())

    def snapshot(self, sample: int) -> Snapshot:
        """The plant at a sample."""
        self.extend(sample + 1)
        return self._snapshots[sample]

    def at(self, time_us: float) -> tuple[float, float]:
        """Phase and slip at a time, slip linear between samples."""
        index = max(0, int((time_us - self.start_us) // SAMPLE_US))
        self.extend(index + 2)
        after_s = (time_us - self.start_us - SAMPLE_US * index) * 1e-6
        slip = self.slip[index]
        fall = (self.slip[index + 1] - slip) / SAMPLE_S
        phase = self.phase[index] + (slip + fall * after_s / 2.0) * after_s
        return phase, slip + fall * after_s

    def falls_to(self, slip_rad_s: float) -> tuple[float, float] | None:
        """Time at which the slip has fallen to a value, and the phase then."""
        self.extend(BRANCH_SAMPLES)
        below = np.flatnonzero(np.array(self.slip) <= slip_rad_s)
        if not below.size:
            return None
        index = max(1, int(below[0]))
        before, after = self.slip[index - 1], self.slip[index]
        share = (before - slip_rad_s) / (before - after) if before > after else 1.0
        time_us = self.start_us + (index - 1 + share) * SAMPLE_US
        return time_us, self.at(time_us)[0]

    def _run_to(self, time_us: float) -> None:
        plant = self._plant
        while not self._is_at_rest and plant.time_us < time_us:
            due_us = self._switches[0][0] if self._switches else math.inf
            if due_us <= plant.time_us:
                plant.set_brake(self._switches.pop(0)[1])
                continue
            event = plant.advance(math.inf, min(time_us, due_us))
            self._is_at_rest = event == at.STOPPED


class Branch:
    """What letting go at a sample adds to going on at its slip: phase and slip by sample."""

    def __init__(self, path: Path) -> None:
        path.extend(BRANCH_SAMPLES)
        slip, phase = np.array(path.slip), np.array(path.phase)
        self.slip: Floats = slip - slip[0]
        self.phase: Floats = phase - phase[0] - slip[0] * SAMPLE_S * np.arange(BRANCH_SAMPLES)


class Forecast:
    """Phase and slip of a gear to come. Times in us of the sensor clock, as the controller's."""

    def __init__(
        self,
        plant: TruckPlant,
        start: Snapshot,
        gear: MainGear,
        pitch_rad: float,
        clock_start_us: int,
    ) -> None:
        self._plant = plant
        self._start = start
        self._gear = gear
        self._pitch = pitch_rad
        self._offset_us = clock_start_us
        self._paths: dict[Switches, Path] = {}
        self._branches: dict[tuple[Switches, int], Branch] = {}

    def holds(
        self, gear: MainGear, times: Floats, states: Floats, time_us: float, phase: float
    ) -> bool:
        """Whether the gear is where this forecast has it, and the brake as it had it."""
        switches = self._switches(times, states)
        if gear is not self._gear:
            return False
        if switches in self._paths:
            expected, _ = self.at(times, states, time_us)
        elif switches and switches[-1][1] == 0.0 and switches[:-1] in self._paths:
            expected, _ = self.after_release(times, states, time_us)
        else:
            return False
        error = (expected - phase) / self._pitch
        return abs(error - round(error)) * self._pitch < SAME_RAD

    def at(self, times: Floats, states: Floats, time_us: float) -> tuple[float, float]:
        """Phase (unwrapped) and slip with the brake switched so."""
        return self._path(self._switches(times, states)).at(time_us - self._offset_us)

    def after_release(self, times: Floats, states: Floats, time_us: float) -> tuple[float, float]:
        """The same for switches of which the last is a release that may be moved."""
        switches = self._switches(times, states)
        if not switches:
            return self.at(times, states, time_us)
        path, release_us = self._trunk(switches)
        own_us = time_us - self._offset_us
        if own_us <= release_us:
            return path.at(own_us)
        slip, phase = self._curve(switches[:-1], path, release_us)
        after_s = (own_us - release_us) * 1e-6
        index = min(int(after_s / SAMPLE_S), BRANCH_SAMPLES - 2)
        share = after_s / SAMPLE_S - index
        phase0, slip0 = path.at(release_us)
        less = slip[index] + share * (slip[index + 1] - slip[index])
        turned = phase[index] + share * SAMPLE_S * (slip[index] + less) / 2.0
        return phase0 + slip0 * after_s + float(turned), slip0 + float(less)

    def falls_to(
        self, times: Floats, states: Floats, slip_rad_s: float
    ) -> tuple[float, float] | None:
        """Time and phase at which the slip has fallen to a value, for such switches; None where it
        does not within the length of a branch."""
        switches = self._switches(times, states)
        if not switches:
            return self._in_sensor_time(self._path(()).falls_to(slip_rad_s))
        path, release_us = self._trunk(switches)
        slip0 = path.at(release_us)[1]
        if slip0 <= slip_rad_s:
            return self._in_sensor_time(path.falls_to(slip_rad_s))
        slip, _ = self._curve(switches[:-1], path, release_us)
        index = int(np.argmax(slip <= slip_rad_s - slip0))
        if index == 0:
            return None
        share = (slip_rad_s - slip0 - slip[index - 1]) / (slip[index] - slip[index - 1])
        time_us = self._offset_us + release_us + (index - 1 + float(share)) * SAMPLE_US
        return time_us, self.after_release(times, states, time_us)[0]

    def _in_sensor_time(self, found: tuple[float, float] | None) -> tuple[float, float] | None:
        return None if found is None else (found[0] + self._offset_us, found[1])

    def _switches(self, times: Floats, states: Floats) -> Switches:
        """What was still to come when this forecast was made."""
        start_us = self._start.time_us + self._offset_us
        return tuple(
            (time - self._offset_us, state)
            for time, state in zip(times.tolist(), states.tolist(), strict=True)
            if time > start_us
        )

    def _trunk(self, switches: Switches) -> tuple[Path, float]:
        """The path without the release, and when that comes, no later than the trunk is long."""
        path = self._path(switches[:-1])
        return path, min(switches[-1][0], path.start_us + SAMPLE_US * TRUNK_SAMPLES)

    def _path(self, switches: Switches) -> Path:
        path = self._paths.get(switches)
        if path is None:
            path = Path(self._plant, self._start, self._gear, switches, self._pitch)
            self._paths[switches] = path
        return path

    def _curve(self, trunk: Switches, path: Path, release_us: float) -> tuple[Floats, Floats]:
        filled_us = (trunk[-1][0] if trunk else path.start_us) + FILLING_US
        apart = COARSE if release_us > filled_us else 1
        place = (release_us - path.start_us) / (SAMPLE_US * apart)
        node = int(place)
        share = place - node
        first = self._branch(trunk, path, apart * node)
        second = self._branch(trunk, path, apart * (node + 1))
        return (
            first.slip + share * (second.slip - first.slip),
            first.phase + share * (second.phase - first.phase),
        )

    def _branch(self, trunk: Switches, path: Path, sample: int) -> Branch:
        branch = self._branches.get((trunk, sample))
        if branch is None:
            start = path.snapshot(sample)
            let_go = ((start.time_us, 0.0),)
            branch = Branch(Path(self._plant, start, self._gear, let_go, self._pitch))
            self._branches[trunk, sample] = branch
        return branch
