"""The truck's plant run ahead: phase and slip of a gear for any moment of releasing the brake.

One trunk with the brake as commanded but never released, and from its samples branches with the
brake released. What a release changes, beyond the slip it begins with, is interpolated between the
branches of two samples: of neighbours while the brake still fills, wider ones later.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from meshpoint.gearbox import MainGear
from meshpoint.kernels.records import Vector
from meshpoint.rig_sim.truck.plant import Snapshot, TruckPlant

Switches = tuple[tuple[float, float], ...]
"""When the brake's pressure begins to react, in the plant's time, and u from then on."""
FORECAST_SAMPLE_US: Final = 4_000
BRANCH_SAMPLES: Final = 100
"""0.4 s: further than a plan looks."""
SOON_SAMPLES: Final = 25
"""0.1 s: as far as a release is looked for; a branch that a plan follows is run on from there."""
TRUNK_SAMPLES: Final = 500
FILLING_US: Final = 250_000
"""So long after it was switched on the brake's pressure stands, and a release changes what it
changes whenever it comes, but for friction."""
COARSE: Final = 20
SAMPLE_S: Final = FORECAST_SAMPLE_US * 1e-6
SAME_RAD: Final = 2e-4
"""A forecast that the truth follows this closely still holds."""


class Path:
    """Phase (unwrapped) and slip of one gear each 4 ms, run on only as far as they are asked for.

    `plant` is a copy that all paths run in turn; each keeps where it stands, and one from which
    branches may begin (`keeps`) where it stood at every sample. One that is a branch itself
    switches nothing after its start."""

    def __init__(
        self,
        plant: TruckPlant,
        start: Snapshot,
        gear: MainGear,
        switches: Switches,
        pitch: float,
        keeps: bool = True,
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
        self._keeps = keeps
        self._snapshots = [start]

    def extend(self, count: int) -> None:
        """At least `count` samples."""
        if len(self.slip) >= count:
            return
        plant = self._plant
        plant.restore(self._snapshots[-1])
        while self._keeps and len(self.slip) < count:
            self._run_to(self.start_us + FORECAST_SAMPLE_US * len(self.slip))
            self._add(plant.slip_rad_s(self._gear), plant.shafts.phase_rad(self._gear))
            self._snapshots.append(plant.snapshot())
        if not self._keeps:
            self._run_alone(range(len(self.slip), count))
            self._snapshots = [plant.snapshot()]

    def _add(self, slip: float, found: float) -> None:
        """A sample's slip, and its phase within half a pitch; a layshaft at rest has neither."""
        if self._is_at_rest:
            slip = -self._plant.main_rad_s
        expected = self.phase[-1] + (slip + self.slip[-1]) / 2.0 * SAMPLE_S
        found = expected if self._is_at_rest else found
        turns = math.floor((expected - found) / self._pitch + 0.5)
        self.phase.append(found + self._pitch * turns)
        self.slip.append(slip)

    def _run_alone(self, numbers: range) -> None:
        """Samples of a path that switches nothing but at its start, all in one go."""
        plant, gear = self._plant, self._gear
        while self._switches:
            plant.set_brake(self._switches.pop(0)[1])
        samples, rests = plant.sample(gear, FORECAST_SAMPLE_US, self.start_us, numbers)
        ratio = plant.ratio(gear)
        for layshaft, main, phase in samples.tolist():
            self._is_at_rest = math.isnan(layshaft)
            self._add(ratio * layshaft - main, phase)
        self._is_at_rest = rests

    def snapshot(self, sample: int) -> Snapshot:
        """The plant at a sample."""
        self.extend(sample + 1)
        return self._snapshots[sample]

    def at(self, time_us: float) -> tuple[float, float]:
        """Phase and slip at a time, slip linear between samples."""
        index = max(0, int((time_us - self.start_us) // FORECAST_SAMPLE_US))
        self.extend(index + 2)
        after_s = (time_us - self.start_us - FORECAST_SAMPLE_US * index) * 1e-6
        slip = self.slip[index]
        fall = (self.slip[index + 1] - slip) / SAMPLE_S
        phase = self.phase[index] + (slip + fall * after_s / 2.0) * after_s
        return phase, slip + fall * after_s

    def many(self, time_us: Vector) -> tuple[Vector, Vector]:
        """The same at ascending times."""
        index = np.maximum(0, (time_us - self.start_us) // FORECAST_SAMPLE_US).astype(np.int64)
        self.extend(int(index[-1]) + 2)
        return _between(np.array(self.phase), np.array(self.slip), index, time_us - self.start_us)

    def _run_to(self, time_us: float) -> None:
        plant = self._plant
        while not self._is_at_rest and plant.time_us < time_us:
            due_us = self._switches[0][0] if self._switches else math.inf
            if due_us <= plant.time_us:
                plant.set_brake(self._switches.pop(0)[1])
                continue
            self._is_at_rest = plant.advance_alone(min(time_us, due_us))


def _between(
    phase: Vector, slip: Vector, index: NDArray[np.int64], after_us: Vector
) -> tuple[Vector, Vector]:
    """Phase and slip between samples, of which `index` are those before; slip is linear there."""
    after_s = (after_us - FORECAST_SAMPLE_US * index) * 1e-6
    before = slip[index]
    fall = (slip[index + 1] - before) / SAMPLE_S
    return phase[index] + (before + fall * after_s / 2.0) * after_s, before + fall * after_s


class Branch:
    """What releasing at a sample adds to going on at its slip: phase and slip by sample."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._run(SOON_SAMPLES)

    def reach(self, count: int) -> None:
        """At least `count` samples."""
        if count > len(self.slip_list):
            self._run(BRANCH_SAMPLES)

    def _run(self, count: int) -> None:
        self._path.extend(count)
        slip, phase = np.array(self._path.slip), np.array(self._path.phase)
        self.slip: Vector = slip - slip[0]
        self.phase: Vector = phase - phase[0] - slip[0] * SAMPLE_S * np.arange(count)
        self.slip_list: list[float] = self.slip.tolist()
        self.phase_list: list[float] = self.phase.tolist()


class Forecast:
    """Phase and slip of a gear to come. Times in us of the sensor clock, as the controller's.

    `brake`: its switches (2, n), times and what holds from each on, as `BrakeInput` has them."""

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

    def holds(self, gear: MainGear, brake: Vector, time_us: float, phase: float) -> bool:
        """Whether the gear is where this forecast has it, and the brake as it had it."""
        switches = self._switches(brake)
        if gear is not self._gear:
            return False
        if switches in self._paths:
            expected, _ = self.at(brake, time_us)
        elif switches and switches[-1][1] == 0.0 and switches[:-1] in self._paths:
            expected, _ = self.after_release(brake, time_us)
        else:
            return False
        error = (expected - phase) / self._pitch
        return abs(error - round(error)) * self._pitch < SAME_RAD

    def at(self, brake: Vector, time_us: float) -> tuple[float, float]:
        """Phase (unwrapped) and slip with the brake switched so."""
        return self._path(self._switches(brake)).at(time_us - self._offset_us)

    def after_release(self, brake: Vector, time_us: float) -> tuple[float, float]:
        """The same for switches of which the last is a release that may be moved.

        What `trajectory` has for this one time, to the bit: a root is looked for one time after the
        other, where arrays of one cost several times the arithmetic."""
        switches = self._switches(brake)
        own_us = float(time_us) - self._offset_us
        if not switches:
            return self._path(switches).at(own_us)
        path, release_us = self._trunk(switches)
        if own_us <= release_us:
            return path.at(own_us)
        phase0, slip0 = path.at(release_us)
        after_us = own_us - release_us
        index = int(min(after_us // FORECAST_SAMPLE_US, BRANCH_SAMPLES - 2))
        first, second, share = self._neighbours(switches[:-1], path, release_us, index + 2)
        slip, after = (
            first.slip_list[i] + share * (second.slip_list[i] - first.slip_list[i])
            for i in (index, index + 1)
        )
        turned = first.phase_list[index]
        turned += share * (second.phase_list[index] - turned)
        after_s = (after_us - FORECAST_SAMPLE_US * index) * 1e-6
        fall = (after - slip) / SAMPLE_S
        turned += (slip + fall * after_s / 2.0) * after_s
        return phase0 + slip0 * after_us * 1e-6 + turned, slip0 + (slip + fall * after_s)

    def trajectory(self, brake: Vector, at_us: Vector, is_released: bool) -> tuple[Vector, Vector]:
        """Phase and slip at ascending times; `is_released`: the last switch is a release that may
        be moved, else all switches are as commanded."""
        switches = self._switches(brake)
        own_us = at_us - self._offset_us
        if not is_released or not switches:
            return self._path(switches).many(own_us)
        path, release_us = self._trunk(switches)
        before = own_us <= release_us
        phase, slip = np.empty(own_us.size), np.empty(own_us.size)
        if before.any():
            phase[before], slip[before] = path.many(own_us[before])
        after_us = own_us[~before] - release_us
        index = np.minimum(after_us // FORECAST_SAMPLE_US, BRANCH_SAMPLES - 2).astype(np.int64)
        count = int(index[-1]) + 2 if index.size else 0
        less_slip, less_phase = self._curve(switches[:-1], path, release_us, count)
        turned, less = _between(less_phase, less_slip, index, after_us)
        phase0, slip0 = path.at(release_us)
        phase[~before] = phase0 + slip0 * after_us * 1e-6 + turned
        slip[~before] = slip0 + less
        return phase, slip

    def _switches(self, brake: Vector) -> Switches:
        """What was still to come when this forecast was made."""
        start_us = self._start.time_us + self._offset_us
        return tuple(
            (time - self._offset_us, state)
            for time, state in zip(*brake.tolist(), strict=True)
            if time > start_us
        )

    def _trunk(self, switches: Switches) -> tuple[Path, float]:
        """The path without the release, and when that comes, no later than the trunk is long."""
        path = self._path(switches[:-1])
        return path, min(switches[-1][0], path.start_us + FORECAST_SAMPLE_US * TRUNK_SAMPLES)

    def _path(self, switches: Switches) -> Path:
        path = self._paths.get(switches)
        if path is None:
            path = Path(self._plant, self._start, self._gear, switches, self._pitch)
            self._paths[switches] = path
        return path

    def _curve(
        self, trunk: Switches, path: Path, release_us: float, count: int
    ) -> tuple[Vector, Vector]:
        first, second, share = self._neighbours(trunk, path, release_us, count)
        slip, phase = first.slip[:count], first.phase[:count]
        return (
            slip + share * (second.slip[:count] - slip),
            phase + share * (second.phase[:count] - phase),
        )

    def _neighbours(
        self, trunk: Switches, path: Path, release_us: float, count: int
    ) -> tuple[Branch, Branch, float]:
        """The branches before and after a release, and how far on it is from one to the other.

        count: how many samples of them are asked for."""
        filled_us = (trunk[-1][0] if trunk else path.start_us) + FILLING_US
        apart = COARSE if release_us > filled_us else 1
        place = (release_us - path.start_us) / (FORECAST_SAMPLE_US * apart)
        node = int(place)
        first = self._branch(trunk, path, apart * node)
        second = self._branch(trunk, path, apart * (node + 1))
        first.reach(count)
        second.reach(count)
        return first, second, place - node

    def _branch(self, trunk: Switches, path: Path, sample: int) -> Branch:
        branch = self._branches.get((trunk, sample))
        if branch is None:
            start = path.snapshot(sample)
            let_go = ((start.time_us, 0.0),)
            branch = Branch(Path(self._plant, start, self._gear, let_go, self._pitch, keeps=False))
            self._branches[trunk, sample] = branch
        return branch
