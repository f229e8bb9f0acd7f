"""The part of the true state that both presets give in the same way. No side effects."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from meshpoint.gearbox.gears import MainGear, Sleeve
from meshpoint.rig_sim.shared.engagement import Engagement, Violation
from meshpoint.rig_sim.shared.rotation import Drive, Rotation
from meshpoint.rig_sim.shared.script import BenchScript, ScriptStage
from meshpoint.rig_sim.shared.sleeves import SleeveState


class Driven(Rotation, Protocol):
    """Rotating parts that say what moves them."""

    @property
    def drive(self) -> Drive:
        """What moves the layshaft."""


class Whole(Protocol):
    """What is read here of a world."""

    clock_start_us: int
    script: BenchScript

    @property
    def plant(self) -> Driven:
        """The rotating parts."""

    @property
    def engagement(self) -> Engagement[Any]:
        """The main sleeves."""


class CommonTruth:
    """The state of a world up to its last step; see `rig_world.Truth`."""

    def __init__(self, world: Whole) -> None:
        self._whole = world

    @property
    def time_us(self) -> float:
        """Time since power-up of everything else here: the newest event, or grid point."""
        return self._whole.plant.time_us

    @property
    def clock_start_us(self) -> int:
        """Sensor clock at power-up."""
        return self._whole.clock_start_us

    def slip_rad_s(self, gear: MainGear) -> float:
        """Speed of a gear less that of its sleeve."""
        return self._whole.plant.slip_rad_s(gear)

    @property
    def drive(self) -> Drive:
        """What moves the layshaft."""
        return self._whole.plant.drive

    @property
    def brake_gauge_pa(self) -> float:
        """Gauge pressure at the brake."""
        return self._whole.plant.brake_gauge_pa

    @property
    def locked_gear(self) -> MainGear:
        """The main-box gear in mesh, at a flank or between them; or neutral."""
        lock = self._whole.plant.shafts.lock
        return MainGear.NEUTRAL if lock is None else lock.gear

    def phase_rad(self, gear: MainGear) -> float:
        """Phase of a gear against its sleeve."""
        return self._whole.plant.shafts.phase_rad(gear)

    def sleeve_state(self, sleeve: Sleeve) -> SleeveState:
        """State of one of the two main sleeves. KeyError for splitter and range."""
        state: SleeveState = self._whole.engagement.sleeves[sleeve].state
        return state

    @property
    def script(self) -> ScriptStage:
        """Where the bench script stands."""
        return self._whole.script.stage

    @property
    def violations(self) -> Mapping[Violation, int]:
        """How often each of the forbidden things has happened."""
        return dict(self._whole.engagement.violations)
