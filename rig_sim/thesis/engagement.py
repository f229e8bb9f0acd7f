"""The contact rule of the preset `thesis`: a sleeve without mass, teeth without friction."""

from __future__ import annotations

from meshpoint.dbc.messages import EngagementEvent
from meshpoint.gearbox.gears import SLEEVE_OF_MAIN, MainGear, Sleeve
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.shared.delayed_engagement import EngagementByDelay
from meshpoint.rig_sim.shared.sleeves import SleeveAxis, SleeveState
from meshpoint.rig_sim.thesis.delays import Delays
from meshpoint.rig_sim.thesis.plant import Crossing, Plant


class ThesisEngagement(EngagementByDelay[SleeveAxis]):
    """The contact rule of the preset `thesis`: a sleeve without mass, teeth without friction."""

    def __init__(
        self, sheet: GearboxSheet, plant: Plant, delays: Delays, engaged: MainGear
    ) -> None:
        where = SLEEVE_OF_MAIN[engaged]
        sleeves = {
            sleeve: SleeveAxis(sheet.sleeve, where.direction if sleeve is where.sleeve else 0)
            for sleeve in (Sleeve.FIRST_SECOND, Sleeve.CRAWL_THIRD)
        }
        super().__init__(sheet, plant, sleeves)
        self._thesis = plant
        self._delays = delays

    def crossing(self, horizon_us: float) -> tuple[Crossing, Sleeve] | None:
        """The first sleeve whose gear's tooth leaves the face or the gap before the horizon."""
        found: list[tuple[Crossing, Sleeve]] = []
        for name, sleeve in self.sleeves.items():
            if sleeve.state not in (SleeveState.FACE, SleeveState.ENTER) or name in self._blocked:
                continue
            gear = self.gear_at(name)
            phase = self._plant.shafts.phase_rad(gear)
            span = (-self._half_rad, self._half_rad)
            if sleeve.state is SleeveState.FACE:
                phase += self._pitch_rad if phase < 0.0 else 0.0
                span = (self._half_rad, self._pitch_rad - self._half_rad)
            crossing = self._thesis.crossing(gear, phase, span, horizon_us)
            if crossing is not None:
                found.append((crossing, name))
        return min(found, default=None, key=lambda entry: (entry[0].time_us, entry[1]))

    def crossed(self, name: Sleeve, side: int) -> None:
        """The plant stands where the tooth leaves the face (to a gap) or the gap (to a flank)."""
        sleeve, gear, time_us = self.sleeves[name], self.gear_at(name), self._plant.time_us
        slip = self._plant.slip_rad_s(gear)
        if sleeve.state is SleeveState.ENTER:
            self._lock(name, side * self._half_rad)
        elif self._another_meshed(name):
            self._block(name, time_us)
        else:
            sleeve.enter(time_us)
            self._note(EngagementEvent.TOOTH_PASSED, gear, -side * self._half_rad, slip)

    def _delay_s(self, name: Sleeve, direction: int) -> float:  # noqa: ARG002
        return self._delays.draw_s()

    def _contact(self, name: Sleeve, time_us: float) -> None:
        gear = self.gear_at(name)
        phase, slip = self._plant.shafts.phase_rad(gear), self._plant.slip_rad_s(gear)
        sleeve = self.sleeves[name]
        blocked = self._another_meshed(name)
        if abs(phase) < self._half_rad and not blocked:
            sleeve.enter(time_us)
            self._meets(EngagementEvent.GAP_CONTACT, gear, phase, slip)
            return
        sleeve.rest_on_tooth(time_us)
        self._meets(EngagementEvent.TOOTH_CONTACT, gear, phase, slip)
        if blocked:
            self._block(name, time_us)

    def _lock(self, name: Sleeve, phase_rad: float) -> None:
        gear = self.gear_at(name)
        slip = self._plant.slip_rad_s(gear)
        self._thesis.lock(MainGear(gear), phase_rad)
        self.sleeves[name].lock()
        self._note(EngagementEvent.LOCKED, gear, phase_rad, slip)
        self._count_brake_in_gear(self._plant.time_us)

    def _unmesh(self, name: Sleeve) -> None:
        gear = self.gear_at(name)
        phase, slip = self._plant.shafts.phase_rad(gear), self._plant.slip_rad_s(gear)
        self._note(EngagementEvent.RELEASED, gear, phase, slip)
        self.sleeves[name].unmesh()
        self._plant.coast()
