"""The truck's plant run ahead: phase and slip of a gear for any moment of letting the brake go.

One trunk with the brake as commanded but never released, and from nodes of it branches with the
brake let go. What a release changes, beyond the slip it begins with, depends on when it comes only
through speed and temperature; so between two nodes it is interpolated.
"""

from __future__ import annotations

import copy
import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gearbox import MainGear
from rig_sim import truck_layout as at
from rig_sim.truck_plant import TruckPlant

Floats = NDArray[np.float64]
SAMPLE_US: Final = 2_000
NODE_SAMPLES: Final = 20
"""A branch each 40 ms."""
BRANCH_SAMPLES: Final = 200
TRUNK_SAMPLES: Final = 1_000
US: Final = 1e-6
SAME_RAD: Final = 2e-5
"""A forecast that the truth follows this closely still holds."""


class Path:
    """Samples of phase (unwrapped) and slip of one gear, 2 ms apart, made as they are asked for."""

    def __init__(
        self, plant: TruckPlant, gear: MainGear, switches: list[tuple[float, float]], pitch: float
    ) -> None:
        self._plant = plant
        self._gear = gear
        self._switches = switches
        self._pitch = pitch
        self.start_us = plant.time_us
        self.phase = [plant.shafts.phase_rad(gear)]
        self.slip = [plant.slip_rad_s(gear)]

    def extend(self, count: int) -> None:
        """At least `count` samples; a layshaft at rest stays so."""
        while len(self.slip) < count:
            self._run_to(self.start_us + SAMPLE_US * len(self.slip))
            slip, before = self._plant.slip_rad_s(self._gear), self.phase[-1]
            expected = before + (slip + self.slip[-1]) / 2.0 * SAMPLE_US * US
            found = self._plant.shafts.phase_rad(self._gear)
            turns = math.floor((expected - found) / self._pitch + 0.5)
            self.phase.append(found + self._pitch * turns)
            self.slip.append(slip)

    def plant_at(self, sample: int) -> TruckPlant:
        """A copy of the plant at a sample not made before."""
        self.extend(sample + 1)
        return copy.deepcopy(self._plant)

    def at(self, time_us: float) -> tuple[float, float]:
        """Phase and slip at a time, slip linear between samples."""
        index = max(0, int((time_us - self.start_us) // SAMPLE_US))
        self.extend(index + 2)
        after_s = (time_us - self.start_us - SAMPLE_US * index) * US
        slip = self.slip[index]
        fall = (self.slip[index + 1] - slip) / (SAMPLE_US * US)
        phase = self.phase[index] + (slip + fall * after_s / 2.0) * after_s
        return phase, slip + fall * after_s

    def _run_to(self, time_us: float) -> None:
        plant = self._plant
        while plant.time_us < time_us:
            due_us = self._switches[0][0] if self._switches else math.inf
            if due_us <= plant.time_us:
                plant.set_brake(self._switches.pop(0)[1])
                continue
            event = plant.advance(math.inf, min(time_us, due_us))
            if event == at.STOPPED:
                plant.stop()
            elif event == at.LET_GO:
                plant.let_go()


class Branch:
    """What letting go at a node adds to going on at the node's slip: phase and slip by sample."""

    def __init__(self, path: Path) -> None:
        path.extend(BRANCH_SAMPLES)
        times_s = SAMPLE_US * US * np.arange(BRANCH_SAMPLES)
        slip, phase = np.array(path.slip), np.array(path.phase)
        self.slip: Floats = slip - slip[0]
        self.phase: Floats = phase - phase[0] - slip[0] * times_s


class Forecast:
    """Phase and slip of a gear to come. Times in us of the sensor clock, as the controller's."""

    def __init__(
        self, plant: TruckPlant, gear: MainGear, pitch_rad: float, clock_start_us: int
    ) -> None:
        self._plant = plant
        self._gear = gear
        self._pitch = pitch_rad
        self._offset_us = clock_start_us
        self._paths: dict[tuple[tuple[float, float], ...], Path] = {}
        self._branches: dict[tuple[tuple[tuple[float, float], ...], int], Branch] = {}
        self._snapshots: dict[tuple[tuple[tuple[float, float], ...], int], TruckPlant] = {}

    def holds(
        self, gear: MainGear, times: Floats, states: Floats, time_us: float, phase: float
    ) -> bool:
        """Whether the gear is where this forecast has it, and the brake as it had it."""
        path = self._paths.get(self._switches(times, states))
        if gear is not self._gear or path is None:
            return False
        expected, _ = path.at(time_us - self._offset_us)
        error = (expected - phase) / self._pitch
        return abs(error - round(error)) * self._pitch < SAME_RAD

    def at(self, times: Floats, states: Floats, time_us: float) -> tuple[float, float]:
        """Phase (unwrapped) and slip with the brake switched so."""
        return self._path(self._switches(times, states)).at(time_us - self._offset_us)

    def after_release(self, times: Floats, states: Floats, time_us: float) -> tuple[float, float]:
        """The same for switches of which the last is a release that may be moved."""
        trunk, release_us = self._trunk(times, states)
        own_us = time_us - self._offset_us
        if trunk is None:
            return self.at(times, states, time_us)
        path = self._path(trunk)
        if own_us <= release_us:
            return path.at(own_us)
        slip, phase = self._curve(trunk, path, release_us)
        place = (own_us - release_us) / SAMPLE_US
        index = min(int(place), BRANCH_SAMPLES - 2)
        share = place - index
        phase0, slip0 = path.at(release_us)
        slip_rad_s = slip0 + slip[index] + share * (slip[index + 1] - slip[index])
        turned = phase[index] + share * (slip[index] + slip_rad_s - slip0) / 2.0 * SAMPLE_US * US
        return phase0 + slip0 * (own_us - release_us) * US + float(turned), float(slip_rad_s)

    def falls_to(
        self, times: Floats, states: Floats, slip_rad_s: float
    ) -> tuple[float, float] | None:
        """Time and phase at which the slip has fallen to a value, for such switches; None where it
        does not within the length of a branch."""
        trunk, release_us = self._trunk(times, states)
        if trunk is None:
            return self._falls_on(self._path(self._switches(times, states)), slip_rad_s)
        path = self._path(trunk)
        slip0 = path.at(release_us)[1]
        if slip0 <= slip_rad_s:
            return self._falls_on(path, slip_rad_s)
        slip, _ = self._curve(trunk, path, release_us)
        index = int(np.argmax(slip <= slip_rad_s - slip0))
        if index == 0:
            return None
        share = (slip_rad_s - slip0 - slip[index - 1]) / (slip[index] - slip[index - 1])
        time_us = self._offset_us + release_us + (index - 1 + float(share)) * SAMPLE_US
        return time_us, self.after_release(times, states, time_us)[0]

    def _falls_on(self, path: Path, slip_rad_s: float) -> tuple[float, float] | None:
        path.extend(BRANCH_SAMPLES)
        for index, slip in enumerate(path.slip):
            if slip <= slip_rad_s:
                before = path.slip[max(0, index - 1)]
                share = (before - slip_rad_s) / (before - slip) if before > slip else 1.0
                time_us = path.start_us + (max(0, index - 1) + share) * SAMPLE_US
                return time_us + self._offset_us, path.at(time_us)[0]
        return None

    def _switches(self, times: Floats, states: Floats) -> tuple[tuple[float, float], ...]:
        """What is still to come, in the plant's time."""
        own = [
            (time - self._offset_us, state)
            for time, state in zip(times.tolist(), states.tolist(), strict=True)
        ]
        return tuple(switch for switch in own if switch[0] > self._plant.time_us)

    def _trunk(
        self, times: Floats, states: Floats
    ) -> tuple[tuple[tuple[float, float], ...] | None, float]:
        """Switches without the last, the release, and when that comes; None: it is past."""
        switches = self._switches(times, states)
        if not switches:
            return None, 0.0
        return switches[:-1], min(
            switches[-1][0], self._plant.time_us + SAMPLE_US * (TRUNK_SAMPLES - 1)
        )

    def _path(self, switches: tuple[tuple[float, float], ...]) -> Path:
        path = self._paths.get(switches)
        if path is None:
            plant = copy.deepcopy(self._plant)
            path = self._paths[switches] = Path(plant, self._gear, list(switches), self._pitch)
        return path

    def _curve(
        self, trunk: tuple[tuple[float, float], ...], path: Path, release_us: float
    ) -> tuple[Floats, Floats]:
        place = (release_us - path.start_us) / (SAMPLE_US * NODE_SAMPLES)
        node = int(place)
        share = place - node
        first, second = self._branch(trunk, node), self._branch(trunk, node + 1)
        return (
            first.slip + share * (second.slip - first.slip),
            first.phase + share * (second.phase - first.phase),
        )

    def _branch(self, trunk: tuple[tuple[float, float], ...], node: int) -> Branch:
        branch = self._branches.get((trunk, node))
        if branch is None:
            plant = self._snapshot(trunk, node)
            plant.set_brake(0.0)
            branch = Branch(Path(plant, self._gear, [], self._pitch))
            self._branches[trunk, node] = branch
        return branch

    def _snapshot(self, trunk: tuple[tuple[float, float], ...], node: int) -> TruckPlant:
        """The plant at a node: from the last node before it that is known."""
        known = max((n for t, n in self._snapshots if t == trunk and n <= node), default=None)
        plant = copy.deepcopy(self._plant if known is None else self._snapshots[trunk, known])
        left = [switch for switch in trunk if switch[0] > plant.time_us]
        path = Path(plant, self._gear, left, self._pitch)
        samples = NODE_SAMPLES * (node - (known or 0))
        snapshot = path.plant_at(samples)
        self._snapshots[trunk, node] = snapshot
        return copy.deepcopy(snapshot)
