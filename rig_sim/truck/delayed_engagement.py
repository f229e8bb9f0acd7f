"""The truck's main sleeves by a pure delay from activation to contact (`sleeve.model` 0)."""

from __future__ import annotations

import math
from collections.abc import Callable

from meshpoint.gearbox.gears import MAIN_SLEEVES, SIDE_OF, DogGear, Sleeve
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.parts.cylinder import Cylinder
from meshpoint.rig_sim.settings import SettingsError
from meshpoint.rig_sim.shared.delayed_engagement import EngagementByDelay
from meshpoint.rig_sim.shared.engagement import GEAR_AT, Tally
from meshpoint.rig_sim.shared.sleeves import SleeveState
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.as_built import AsBuilt
from meshpoint.rig_sim.truck.delays import TruckDelays
from meshpoint.rig_sim.truck.engagement import ROW_OF_SLEEVE, AxisTruth, TruckEngagement
from meshpoint.rig_sim.truck.plant import TruckPlant
from meshpoint.rig_sim.truck.sleeves import DelayedSleeve, axial
from meshpoint.units import SECOND_US


class DelayedEngagement(TruckEngagement[DelayedSleeve], EngagementByDelay[DelayedSleeve]):
    """An activation moves a sleeve that stands by one position, after a drawn delay."""

    def __init__(
        self,
        sheet: GearboxSheet,
        built: AsBuilt,
        plant: TruckPlant,
        delays: TruckDelays,
        engaged: tuple[DogGear, ...],
    ) -> None:
        if sheet.has_dog_splitter:
            raise SettingsError(
                f"sleeve.model = 0 with gearbox {sheet.name}, whose splitter has dog teeth: "
                f"allowed is 1"
            )
        axis = axial(built, sheet.dog.radius_m)
        where = SIDE_OF[engaged[0]]
        sleeves = {
            name: DelayedSleeve(sheet.sleeve, where.direction if name is where.sleeve else 0, axis)
            for name in MAIN_SLEEVES
        }
        super().__init__(sheet, built, plant, delays, sleeves)

    def reset_sleeve(self, name: Sleeve) -> None:
        """A main sleeve stands in neutral at once, all main valves off; nothing is recorded."""
        self._leave_face(name)
        self._energised.clear()
        self._truck.unwatch(ROW_OF_SLEEVE[name])
        self.sleeves[name] = DelayedSleeve(self._sheet.sleeve, 0, self.sleeves[name].axis)

    def expected_contact_us(self, gear: DogGear, fire_us: float) -> tuple[float, float]:
        """The delay's mean after the firing, whatever the sleeve does; and its deviation."""
        mean_s = self._delays.mean_gear_s(gear)
        return fire_us + mean_s * SECOND_US, self._delays.sd_s * SECOND_US

    def change_conditions(self, built: AsBuilt) -> None:
        """A pure delay goes by none."""

    def alter(self, name: Sleeve, change: Callable[[Cylinder], None]) -> None:  # noqa: ARG002
        """A pure delay has no cylinder: nothing, and a line that says so."""
        self._say(self._plant.time_us, f"{name.name} is a pure delay: it has no cylinder")

    def axis(self, name: Sleeve, time_us: float) -> AxisTruth:  # noqa: ARG002
        """A pure delay has no chambers: ValueError."""
        raise ValueError(f"{name.name} is a pure delay (sleeve.model 0): it has no chambers")

    def due(self, time_us: float) -> None:
        """Does what is due now; the plant has been advanced to this time."""
        for name, sleeve in self.sleeves.items():
            if sleeve.overlap_us <= time_us:
                sleeve.overlapped()
                self._watch_gap(name)
            if sleeve.unload_us <= time_us:
                self._unload(name, time_us)
        super().due(time_us)

    def can_release(self, link: int) -> None:  # noqa: ARG002
        """The torque on the teeth no longer holds a sleeve that is to be pulled out."""
        self._truck.g.release_nm[at.MAIN_BOX] = -1.0
        for sleeve in self.sleeves.values():
            if sleeve.waits:
                sleeve.go(self._plant.time_us)

    def script_release(
        self, time_us: float, duration_s: float, names: tuple[Sleeve, ...] = MAIN_SLEEVES
    ) -> None:
        """The bench moves these sleeves to neutral, within this time."""
        before = {name: sleeve.state for name, sleeve in self.sleeves.items()}
        super().script_release(time_us, duration_s, names)
        for name, was in before.items():
            if was in (SleeveState.FACE, SleeveState.ENTER):
                self._give_up(name, was)

    def _delay_s(self, name: Sleeve, direction: int) -> float:
        side = self.sleeves[name].side
        gear = GEAR_AT[name, side or direction]
        self._tallies[name] = Tally()
        self._renew_air(name)
        self._truck.take_air(self._delays.air_share())
        return self._delays.draw_gear_s(gear)

    def _renew_air(self, name: Sleeve) -> None:
        supply_pa = max(self._truck.supply_gauge_pa, 0.0)
        sleeve = self.sleeves[name]
        sleeve.force_n = sleeve.axis.force_n * supply_pa / self._sheet.air.supply_gauge_pa

    def _valve_on(self, name: Sleeve, direction: int, time_us: float) -> None:
        sleeve = self.sleeves[name]
        if sleeve.jammed:
            self._say(time_us, f"activation of {name.name} lost: jammed")
        else:
            was = sleeve.state
            super()._valve_on(name, direction, time_us)
            if was is SleeveState.ENTER and sleeve.state is SleeveState.RETRACT:
                self._truck.unwatch(ROW_OF_SLEEVE[name])

    def _valve_off(self, name: Sleeve, direction: int, time_us: float) -> None:
        sleeve = self.sleeves[name]
        was = sleeve.state
        if sleeve.jammed:
            return
        if sleeve.waits:
            self._wait_no_more(name)
        super()._valve_off(name, direction, time_us)
        if sleeve.state is SleeveState.RETRACT and was is not SleeveState.RETRACT:
            self._give_up(name, was)

    def _unload(self, name: Sleeve, time_us: float) -> None:
        sleeve, truck = self.sleeves[name], self._truck
        limit_nm = math.inf
        if sleeve.axis.hold_per_nm > 0.0:
            limit_nm = sleeve.pressing_n(time_us) / sleeve.axis.hold_per_nm
        if self.scripted or abs(truck.main_box_nm()) <= limit_nm:
            sleeve.go(time_us)
        else:
            sleeve.wait()
            self._wait_for(name, limit_nm)
