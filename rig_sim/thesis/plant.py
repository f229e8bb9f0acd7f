"""The thesis's plant: layshaft with viscous friction and disc brake, main shaft at constant speed.

Linear between events, so it is propagated in closed form from event to event (4.1, 4.13, 4.15),
with no time step. `Plant` is what the rest of the rig asks of a plant; another preset is another
class.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from meshpoint.gearbox.gears import MAIN_GEARS, DogGear, MainGear, Range, Sleeve, Split
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.kernels.structures import RecordArray
from meshpoint.rig_sim.shared.angle_kernels import settled
from meshpoint.rig_sim.shared.angles import Angle, Shafts
from meshpoint.rig_sim.shared.rotation import Drive, Rotation
from meshpoint.rig_sim.thesis.closed_form import (
    ACCELERATED,
    FREE,
    Motion,
    motion_at,
    time_of_exit,
    time_of_stop,
)
from meshpoint.units import US


class Crossing(NamedTuple):
    """Where the phase leaves a span: side +1 is the upper end, -1 the lower."""

    time_us: float
    side: int


class MotionSegment(NamedTuple):
    """A piece of the past, exact: both motions and all shafts' angles at its start and end.

    Shafts are in the order of `sensors.Shaft`; share is their angle over that of the driving
    shaft, which is the layshaft for the first two and the main shaft for the others.
    """

    start_us: float
    duration_s: float
    layshaft: RecordArray[Motion]
    main: RecordArray[Motion]
    before: tuple[Angle, Angle, Angle, Angle]
    after: tuple[Angle, Angle, Angle, Angle]
    shares: tuple[float, float, float, float]


class Plant(Rotation, Protocol):
    """What the world of the preset `thesis` asks of its plant."""

    def crossing(
        self, gear: DogGear, phase_rad: float, span: tuple[float, float], horizon_us: float
    ) -> Crossing | None:
        """When the gear's phase, now `phase_rad`, first leaves the span; None: not by then."""

    def stop_us(self, horizon_us: float) -> float | None:
        """When the layshaft is braked to rest; None: not before the horizon."""

    def move_to(self, time_us: float) -> MotionSegment:
        """Go on to a later instant, exactly, and say what happened on the way."""

    def set_brake(self, on: bool) -> None:
        """The brake valve's input; the caller has waited the valve's delay."""

    def stop(self) -> None:
        """The layshaft has been braked to rest."""

    def lock(self, gear: MainGear, phase_rad: float) -> None:
        """A flank has been reached: the layshaft takes the main shaft's speed, phase stays."""


class ThesisPlant:
    """Equations 4.1-4.16. State at `time_us`; methods act at that instant, `move_to` goes on."""

    def __init__(self, sheet: GearboxSheet, shafts: Shafts, main_rad_s: float) -> None:
        self._sheet = sheet
        self.shafts = shafts
        self.time_us = 0.0
        self.drive = Drive.COASTING
        self._ratios: dict[DogGear, float] = {g: sheet.main_mesh(g).ratio for g in MAIN_GEARS}
        self._locked_ratio = 1.0
        self._layshaft = RecordArray(Motion(valve_rate=1.0 / sheet.brake.time_constant_s))
        self._main = RecordArray(Motion(speed_rad_s=main_rad_s))
        self._load_inertia()

    @property
    def layshaft_rad_s(self) -> float:
        """Layshaft speed."""
        return self._layshaft.record.speed_rad_s

    @property
    def main_rad_s(self) -> float:
        """Main shaft speed."""
        return self._main.record.speed_rad_s

    @property
    def brake_gauge_pa(self) -> float:
        """Gauge pressure between valve and brake (4.15a)."""
        layshaft = self._layshaft.record
        return layshaft.end_pa + layshaft.diff_pa

    def slip_rad_s(self, gear: DogGear) -> float:
        """Speed of the gear less that of its sleeve; the sleeves turn with the main shaft."""
        return self._ratios[gear] * self.layshaft_rad_s - self.main_rad_s

    def crossing(
        self, gear: DogGear, phase_rad: float, span: tuple[float, float], horizon_us: float
    ) -> Crossing | None:
        """When the gear's phase, now `phase_rad`, first leaves the span; None: not by then."""
        ratio = self._ratios[gear]
        horizon_s = (horizon_us - self.time_us) * US
        layshaft, main = self._layshaft.array[0], self._main.array[0]
        s, side = time_of_exit(layshaft, main, ratio, phase_rad, span, horizon_s)
        return Crossing(self.time_us + s / US, side) if side else None

    def stop_us(self, horizon_us: float) -> float | None:
        """When the layshaft is braked to rest; None: not before the horizon."""
        s = time_of_stop(self._layshaft.array[0], (horizon_us - self.time_us) * US)
        return None if s < 0.0 else self.time_us + s / US

    def move_to(self, time_us: float) -> MotionSegment:
        """Go on to a later instant, exactly, and say what happened on the way."""
        duration_s = (time_us - self.time_us) * US
        now, main_now, shafts = self._layshaft.record, self._main.record, self.shafts
        layshaft, main = RecordArray(now.copy()), RecordArray(main_now.copy())
        before = (shafts.input, shafts.layshaft, shafts.main, shafts.propeller)
        turned, now.speed_rad_s = motion_at(layshaft.array[0], duration_s)
        shafts.layshaft = settled(shafts.layshaft[0], shafts.layshaft[1] + turned)
        turned, main_now.speed_rad_s = motion_at(main.array[0], duration_s)
        shafts.main = settled(shafts.main[0], shafts.main[1] + turned)
        now.diff_pa *= math.exp(-now.valve_rate * duration_s)
        if self.drive is Drive.LOCKED:
            self._follow_main()
        shafts.follow()
        after = (shafts.input, shafts.layshaft, shafts.main, shafts.propeller)
        segment = MotionSegment(
            self.time_us,
            duration_s,
            layshaft,
            main,
            before,
            after,
            (shafts.input_mesh.ratio, 1.0, 1.0, shafts.propeller_mesh.ratio),
        )
        self.time_us = time_us
        return segment

    def set_brake(self, on: bool) -> None:
        """The brake valve's input u (4.1); the caller has waited the valve's delay."""
        pressure, layshaft = self.brake_gauge_pa, self._layshaft.record
        layshaft.end_pa = self._sheet.air.supply_gauge_pa if on else 0.0
        layshaft.diff_pa = pressure - layshaft.end_pa

    def coast(self) -> None:
        """No gear and no bench holds the layshaft: friction and brake alone act (4.13)."""
        self.shafts.lock = None
        self.drive = Drive.COASTING if self.layshaft_rad_s > 0.0 else Drive.STOPPED
        self._layshaft.record.kind = FREE if self.drive is Drive.COASTING else ACCELERATED
        self._layshaft.record.accel_rad_s2 = 0.0

    def stop(self) -> None:
        """The brake has brought the layshaft to rest: its torque is clamped there."""
        self._layshaft.record.speed_rad_s = 0.0
        self.coast()

    def lock(self, gear: MainGear, phase_rad: float) -> None:
        """A flank has been reached: the layshaft takes the main shaft's speed, phase stays."""
        self.shafts.lock_gear(gear, phase_rad)
        self.drive = Drive.LOCKED
        self._locked_ratio = self._ratios[gear]
        self._layshaft.record.kind = ACCELERATED
        self._follow_main()
        self.shafts.follow()

    def script_layshaft(self, accel_rad_s2: float) -> None:
        """The bench drives the layshaft at constant acceleration."""
        self.shafts.lock = None
        self.drive = Drive.SCRIPTED
        self._layshaft.record.kind = ACCELERATED
        self._layshaft.record.accel_rad_s2 = accel_rad_s2

    @property
    def input_rad_s(self) -> float:
        """Input shaft speed."""
        return self.layshaft_rad_s / self._sheet.split_mesh(self.shafts.split).ratio

    def script_input(self, accel_rad_s2: float) -> None:  # noqa: ARG002
        """The input shaft always turns with the layshaft here."""
        raise RuntimeError("preset thesis has no splitter with dog teeth")

    def script_main(self, accel_rad_s2: float) -> None:
        """The bench drives the main shaft at constant acceleration; 0 keeps its speed (4.16)."""
        self._main.record.accel_rad_s2 = accel_rad_s2

    def set_steps(self, split: Split, range_: Range, moving: frozenset[Sleeve]) -> None:  # noqa: ARG002
        """Splitter and range steps; angles are continuous, speeds and inertia follow the ratios."""
        self.shafts.set_steps(split, range_)
        self._load_inertia()

    def _follow_main(self) -> None:
        self._layshaft.record.speed_rad_s = self.main_rad_s / self._locked_ratio
        self._layshaft.record.accel_rad_s2 = self._main.record.accel_rad_s2 / self._locked_ratio

    def _load_inertia(self) -> None:
        inertia_kgm2 = self._sheet.inertia_kgm2(self.shafts.split)
        self._layshaft.record.drag = self._sheet.shafts.friction_nms / inertia_kgm2
        self._layshaft.record.gain = self._sheet.brake_nm_per_pa / inertia_kgm2
