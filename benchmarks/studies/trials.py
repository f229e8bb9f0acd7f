"""Engagements of a truck gearbox one after the other, each with a phase and a slip of its own.

Without frames and without a controller: for each trial the sleeve is set to neutral, the gear is
given its phase and slip, and the sleeve's valve is opened. For studies of the dog teeth alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from meshpoint.dbc.messages import EngagementEvent
from meshpoint.gearbox.gears import SLEEVE_OF_MAIN, MainGear
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.settings import Preset, Profile, RigSettings
from meshpoint.rig_sim.shared.engagement import VALVE_OF_MAIN, Engaged
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.gear_train import INDEX
from meshpoint.rig_sim.truck.world import TruckWorld
from meshpoint.units import SECOND_US


class Outcome(NamedTuple):
    """How one tried engagement ended. Slips in rad/s, gear less sleeve."""

    contact: Engaged
    passed: Engaged | None
    locked: Engaged | None
    blocked: bool
    slip_after_rad_s: float

    @property
    def in_gap(self) -> bool:
        """Whether the tooth entered a gap, at first contact or after rubbing."""
        return self.passed is not None or self.contact.event is EngagementEvent.GAP_CONTACT

    @property
    def clean(self) -> bool:
        """Whether it entered a gap at first contact and locked without being bounced off."""
        gap = self.contact.event is EngagementEvent.GAP_CONTACT
        return gap and self.locked is not None and self.locked.tally.ratchets == 0


class Trials:
    """One gearbox in which engagements of one gear are tried."""

    def __init__(
        self,
        sheet: GearboxSheet,
        values: Mapping[str, float],
        gear: MainGear = MainGear.SECOND,
        seed: int = 1,
    ) -> None:
        settings = RigSettings(
            preset=Preset.TRUCK, seed=seed, profile=Profile.CLEAN, as_built=values
        )
        self.gear = gear
        self.world = TruckWorld(sheet, settings)
        self.engagement, self.plant = self.world.engagement, self.world.plant
        self.sleeve = SLEEVE_OF_MAIN[gear].sleeve
        self.pitch_rad = self.world.sheet.dog.pitch_rad
        self.backlash_rad = self.world.sheet.dog.backlash_rad
        self.plant.script_layshaft(0.0)
        self.plant.coast()

    def engage(self, phase_rad: float, slip_rad_s: float, patience_us: float = 2e7) -> Outcome:
        """One engagement, ended by LOCKED, BLOCKED or after `patience_us`.

        phase_rad and slip_rad_s are those at contact if the slip stays constant until then.
        KeyError where the sleeve has not even met its gear by the end."""
        plant, engagement = self.plant, self.engagement
        engagement.reset_sleeve(self.sleeve)
        contact_us, _ = engagement.expected_contact_us(self.gear, plant.time_us)
        delay_s = (contact_us - plant.time_us) / SECOND_US
        self._set(phase_rad - slip_rad_s * delay_s, slip_rad_s)
        engagement.engaged.clear()
        engagement.lines.clear()
        start_us = plant.time_us
        engagement.switch(VALVE_OF_MAIN[self.gear], True, start_us)
        found: dict[EngagementEvent, Engaged] = {}
        while plant.time_us < start_us + patience_us:
            event = plant.advance(start_us + patience_us, engagement.next_us)
            if event == at.REACHED:
                break
            self.world.handle(event)
            for engaged in engagement.engaged:
                found.setdefault(engaged.event, engaged)
            if EngagementEvent.LOCKED in found or EngagementEvent.BLOCKED in found:
                break
        contact = found.get(EngagementEvent.GAP_CONTACT) or found[EngagementEvent.TOOTH_CONTACT]
        return Outcome(
            contact,
            found.get(EngagementEvent.TOOTH_PASSED),
            found.get(EngagementEvent.LOCKED),
            EngagementEvent.BLOCKED in found,
            plant.slip_rad_s(self.gear),
        )

    def _set(self, phase_rad: float, slip_rad_s: float) -> None:
        plant = self.plant
        plant.coast()
        omega = (plant.main_rad_s + slip_rad_s) / plant.ratio(self.gear)
        for body, rate in plant.chain.rates(plant.chain.group(at.LAYSHAFT), at.LAYSHAFT).items():
            plant.y.speed_rad_s[body] = omega * rate
        half = self.pitch_rad / 2.0
        plant.y.phase_rad[INDEX[self.gear]] = (phase_rad + half) % self.pitch_rad - half
        plant.y.lash_rad[INDEX[self.gear]] = 0.0
        plant.y.supply_pa = plant.g.governed_pa
