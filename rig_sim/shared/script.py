"""The scripted way back to a gear between two shifts, as the thesis re-initialises its model.

    RELEASE   60 ms   the main sleeves go to neutral
    RAMP      300 ms  constant acceleration of layshaft and main shaft; splitter and range change
                      (or as long as is set)
    SPLITTER          a splitter with dog teeth that changes: input shaft and layshaft keep their
                      speeds, 20 rpm of slip, less where gaps are small, while its sleeve goes in by
                      the contact rule
    ENGAGE            the layshaft keeps its speed, the same slip, while the main sleeve goes in

At full stroke and locked the bench says Ready. Speeds change smoothly and no angle jumps. While the
script runs, valves do not move the sleeves.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final, Protocol

from meshpoint.gearbox.gears import (
    DRIVE_GEARS,
    MAIN_SLEEVES,
    SIDE_OF,
    SLEEVE_OF_MAIN,
    SPLIT_GEAR,
    DogGear,
    DriveGear,
    MainGear,
    Range,
    Sleeve,
    Split,
    SplitGear,
)
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.settings import RETURN_RAMP_S
from meshpoint.rig_sim.shared.engagement import Engagement
from meshpoint.rig_sim.shared.rotation import Rotation
from meshpoint.rig_sim.shared.sleeves import NEVER_US, ShiftingSleeve, SleeveState
from meshpoint.units import RPM, SECOND_US

RELEASE_S: Final = 0.060
SLIP_RAD_S: Final = 20.0 * RPM
LEAST_IN_GAP_S: Final = 0.0045
"""A tooth that is before a gap for less time is passed by: the slip is no more than that allows."""


class DrawsDelays(Protocol):
    """Where the delays of splitter and range come from."""

    def draw_s(self) -> float:
        """The next delay, s."""


class ScriptStage(IntEnum):
    """Where the script stands."""

    IDLE = 0
    RELEASE = 1
    RAMP = 2
    SPLITTER = 3
    ENGAGE = 4


class BenchScript:
    """Runs the script; the plant stands at the instant of every call."""

    def __init__(
        self,
        sheet: GearboxSheet,
        plant: Rotation,
        engagement: Engagement[Any],
        delays: DrawsDelays,
        gear: DriveGear,
    ) -> None:
        self._sheet = sheet
        self._plant = plant
        self._engagement = engagement
        self._delays = delays
        self._gear: DriveGear | None = gear
        self._main_rad_s = plant.main_rad_s
        self._stage_end_us = NEVER_US
        self.ramp_s = RETURN_RAMP_S
        self.stage = ScriptStage.IDLE
        self.splitter = ShiftingSleeve(sheet.sleeve, 1 if gear.split is Split.HIGH else -1)
        self.range_ = ShiftingSleeve(sheet.sleeve, 1 if gear.range_ is Range.HIGH else -1)
        self.steps = {Sleeve.SPLITTER: self.splitter, Sleeve.RANGE: self.range_}
        """By sleeve: those that are no dog teeth's."""
        if sheet.has_dog_splitter:
            del self.steps[Sleeve.SPLITTER]
        self._split: SplitGear | None = None
        """The step into which the bench moves a splitter with dog teeth."""

    @property
    def next_us(self) -> float:
        """When something of the script is due."""
        return min(self._stage_end_us, self.splitter.arrival_us, self.range_.arrival_us)

    def step_sleeve(self, name: Sleeve) -> ShiftingSleeve | None:
        """The splitter's or the range's sleeve, of which there is one each; None: a main sleeve."""
        return self.steps.get(name)

    def start(self, gear_number: int, main_rad_s: float) -> None:
        """Go to this drive gear, 0 for neutral, at this main shaft speed."""
        self._gear = DRIVE_GEARS.get(gear_number)
        self._main_rad_s = main_rad_s
        self.stage = ScriptStage.RELEASE
        self._engagement.scripted = True
        self._plant.script_main(0.0)
        if self._plant.shafts.lock is None:
            self._plant.coast()
        self._split = self._other_split()
        names = MAIN_SLEEVES if self._split is None else (*MAIN_SLEEVES, Sleeve.SPLITTER)
        self._engagement.script_release(self._plant.time_us, RELEASE_S, names)
        self._stage_end_us = self._plant.time_us + RELEASE_S * SECOND_US

    def due(self, time_us: float) -> None:
        """Do what is due now."""
        if min(self.splitter.arrival_us, self.range_.arrival_us) <= time_us:
            self._change_steps(time_us)
        if self._stage_end_us <= time_us:
            {
                ScriptStage.RELEASE: self._ramp,
                ScriptStage.RAMP: self._hold,
                ScriptStage.SPLITTER: self._engage,
                ScriptStage.ENGAGE: self._ready,
            }[self.stage]()

    def watch(self) -> None:
        """After any event: once the gear is locked, wait for its sleeve's full stroke."""
        if self.stage < ScriptStage.SPLITTER or self._stage_end_us != NEVER_US:
            return
        sleeve = self._engagement.sleeves[self._moved]
        if sleeve.state is SleeveState.LOCKED:
            self._stage_end_us = max(sleeve.stroke_end_us, self._plant.time_us)

    def _other_split(self) -> SplitGear | None:
        """The step of the gear, where a splitter with dog teeth does not stand in it."""
        if self._gear is None or not self._sheet.has_dog_splitter:
            return None
        wanted = SPLIT_GEAR[self._gear.split]
        sleeve = self._engagement.sleeves[Sleeve.SPLITTER]
        is_in = sleeve.state is SleeveState.LOCKED and sleeve.side == SIDE_OF[wanted].direction
        return None if is_in else wanted

    @property
    def _main_gear(self) -> MainGear:
        return self._gear.main if self._gear is not None else MainGear.NEUTRAL

    @property
    def _moved(self) -> Sleeve:
        """The sleeve that goes in now."""
        is_step = self.stage is ScriptStage.SPLITTER
        return Sleeve.SPLITTER if is_step else SLEEVE_OF_MAIN[self._main_gear].sleeve

    def _ramp(self) -> None:
        plant, time_us = self._plant, self._plant.time_us
        self.stage = ScriptStage.RAMP
        self._stage_end_us = time_us + self.ramp_s * SECOND_US
        plant.script_main((self._main_rad_s - plant.main_rad_s) / self.ramp_s)
        if self._gear is None:
            return
        ratio = self._sheet.main_mesh(self._gear.main).ratio
        slip_rad_s = min(SLIP_RAD_S, self._sheet.dog.backlash_rad / LEAST_IN_GAP_S)
        target_rad_s = (self._main_rad_s + slip_rad_s) / ratio
        plant.script_layshaft((target_rad_s - plant.layshaft_rad_s) / self.ramp_s)
        if self._split is not None:
            dog = self._sheet.teeth_of(Sleeve.SPLITTER)
            slip_rad_s = min(SLIP_RAD_S, dog.backlash_rad / LEAST_IN_GAP_S)
            wanted = target_rad_s * self._sheet.dog_mesh(self._split).ratio + slip_rad_s
            plant.script_input((wanted - plant.input_rad_s) / self.ramp_s)
        for name, is_high in (
            (Sleeve.SPLITTER, self._gear.split is Split.HIGH),
            (Sleeve.RANGE, self._gear.range_ is Range.HIGH),
        ):
            side, sleeve = 1 if is_high else -1, self.steps.get(name)
            if sleeve is not None and (sleeve.side != side or sleeve.loose):
                sleeve.change_over(time_us, side, self._delays.draw_s())

    def _hold(self) -> None:
        self._plant.script_main(0.0)
        if self._gear is None:
            self._ready()
            return
        self._plant.script_layshaft(0.0)
        if self._split is None:
            self._engage()
            return
        self._plant.script_input(0.0)
        self._move_in(ScriptStage.SPLITTER, self._split)

    def _engage(self) -> None:
        self._move_in(ScriptStage.ENGAGE, self._main_gear)

    def _move_in(self, stage: ScriptStage, gear: DogGear) -> None:
        self.stage, self._stage_end_us = stage, NEVER_US
        self._engagement.script_engage(gear, self._plant.time_us)

    def _ready(self) -> None:
        self.stage = ScriptStage.IDLE
        self._stage_end_us = NEVER_US
        self._engagement.scripted = False
        number = self._gear.number if self._gear is not None else 0
        self._engagement.ready(self._main_gear, number)

    def _change_steps(self, time_us: float) -> None:
        for sleeve in self.steps.values():
            if sleeve.arrival_us <= time_us:
                sleeve.arrive()
        shafts = self._plant.shafts
        split, range_ = shafts.split, shafts.range_
        if Sleeve.SPLITTER in self.steps and not self.splitter.under_way:
            split = Split.HIGH if self.splitter.side > 0 else Split.LOW
        if not self.range_.under_way:
            range_ = Range.HIGH if self.range_.side > 0 else Range.LOW
        moving = frozenset(name for name, sleeve in self.steps.items() if sleeve.under_way)
        self._plant.set_steps(split, range_, moving)
