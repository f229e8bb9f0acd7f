"""A job of study `hardware`: shifts of one gearbox on a truck with other equipment.

The same work as a run of a campaign of the same seed. A valve is another data sheet, from which rig
and controller are made. What the product has no code for works on the rig's truth: a sleeve parked
before the teeth, and rings on the driven wheels (`equipment_truth`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

from benchmarks.studies.equipment_truth import ParkedSleeve, Parking, WheelRings, WheelRingTeeth
from meshpoint.campaigns.draw import draw, upshifts
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.campaigns.record import Conditions, JudgedShift
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.shift.context import PredictorSource
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.rig_sim.settings import Preset, Profile


class Equipment(StrEnum):
    """What the truck has."""

    TODAY = "today"
    WIDE_VALVE = "wide valve"
    QUICK_VALVE = "quick valve"
    PARKED_SLEEVE = "parked sleeve"
    WHEEL_RINGS = "wheel rings"


class EquippedShifts(NamedTuple):
    """The judged shifts of one run."""

    records: list[JudgedShift]
    aborts: int
    """How often a sleeve was stopped in flight."""


@dataclass(frozen=True)
class EquippedRun:
    """The job: `learning` shifts with the controller's own means, then `shifts` that are judged.

    The sheet is that of the truck, its valves included."""

    equipment: Equipment
    sheet: GearboxSheet
    seed: int
    learning: int
    shifts: int
    profile: Profile
    parking: Parking
    rings: WheelRingTeeth

    def run(self) -> EquippedShifts:
        """Simulates it."""
        count = self.learning + self.shifts
        drawn = draw(self.seed, self.sheet, Preset.TRUCK, upshifts(), count, {}, self.profile)
        bench = ClosedLoop(self.sheet, ControllerSettings(), Preset.TRUCK, drawn)
        for _ in range(self.learning):
            bench.shift()
        bench.change_conditions(drawn.judged)
        source = self._source(bench)
        conditions = Conditions(self.sheet, bench.as_built)
        records, aborts = [], 0
        for number, planned in enumerate(drawn.plan[self.learning :]):
            bench.prepare()
            gear = DRIVE_GEARS[planned.to].main
            # With a source every phase counts as known.
            is_known = bench.controller.observer.references.known(gear)
            bench.controller.sequence.predictor_source = source if is_known else None
            row = bench.shift()
            key = {"sweep": "", "sweep_value": 0.0, "seed": self.seed, "shift": number}
            strategy = str(self.equipment)
            records.append(conditions.record(planned, row, bench.refusal, strategy=strategy, **key))
            aborts += 0 if row is None else row.aborts
        return EquippedShifts(records, aborts)

    def _source(self, bench: ClosedLoop) -> PredictorSource | None:
        controller, truth = bench.controller, bench.rig_truth
        if self.equipment is Equipment.PARKED_SLEEVE:
            return ParkedSleeve(self.sheet, truth, controller.sequence, self.parking, self.seed)
        if self.equipment is Equipment.WHEEL_RINGS:
            return WheelRings(self.sheet, truth, controller.observer, self.rings, self.seed)
        return None


def with_stroke(sheet: GearboxSheet, delay_s: float) -> GearboxSheet:
    """A truck whose valves are so wide that a stroke from neutral takes this long. The valves'
    own delay stays; all of a sleeve's ways go faster."""
    sleeve = sheet.sleeve
    faster = (sleeve.delay_s - sleeve.valve_delay_s) / (delay_s - sleeve.valve_delay_s)
    wider = replace(sleeve, delay_s=delay_s, speed_m_s=faster * sleeve.speed_m_s)
    return replace(sheet, sleeve=wider)


def with_valve_delay(sheet: GearboxSheet, valve_delay_s: float) -> GearboxSheet:
    """A truck whose valves switch so long after their current, as wide as today's."""
    sleeve = sheet.sleeve
    delay_s = sleeve.delay_s - sleeve.valve_delay_s + valve_delay_s
    return replace(sheet, sleeve=replace(sleeve, delay_s=delay_s, valve_delay_s=valve_delay_s))
