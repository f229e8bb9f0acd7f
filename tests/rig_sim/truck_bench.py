"""A truck gearbox on its own: chosen as-built values, no frames, trials one after the other."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final, NamedTuple

from dbc.messages import EngagementEvent
from gearbox.gears import SLEEVE_OF_MAIN, MainGear
from gearbox.sheet import GearboxSheet, load_sheet
from rig_sim import truck_layout as at
from rig_sim.as_built import linear
from rig_sim.engagement import VALVE_OF_MAIN, Engaged
from rig_sim.settings import Preset, RigSettings
from rig_sim.truck_engagement import ROWS
from rig_sim.truck_plant import INDEX
from rig_sim.truck_sleeves import TruckSleeve
from rig_sim.truck_world import TruckWorld

SHEET: Final = load_sheet("thesis")
RPM: Final = math.pi / 30.0
DEG: Final = math.pi / 180.0
GEAR: Final = MainGear.SECOND
TRIALS: Final = int(os.environ.get("MESHPOINT_TRIALS", "500"))
"""Random trials a figure; MESHPOINT_TRIALS=20000 for the full campaign."""


def world(
    fixed: Mapping[str, float] | None = None,
    sheet: GearboxSheet = SHEET,
    seed: int = 1,
    **settings: Any,
) -> TruckWorld:
    """A truck; what is not fixed is drawn."""
    chosen = RigSettings(preset=Preset.TRUCK, seed=seed, as_built=fixed or {}, **settings)
    return TruckWorld(sheet, chosen)


def run(truck: TruckWorld, until_us: int) -> None:
    """Go on, reads included, without looking at them."""
    while truck.run_to(until_us):
        pass


def limit_sheet(teeth: int = 24, backlash_share: float = 0.2) -> GearboxSheet:
    """The data sheet of the limits: z = 24, r = 75 mm, J_eq = 1 at the gear, sleeve 0.25 m/s, no
    friction of the shafts."""
    ratio = SHEET.main_mesh(GEAR).ratio
    return replace(
        SHEET,
        dog=replace(SHEET.dog, teeth=teeth, backlash_share=backlash_share, radius_m=0.075),
        shafts=replace(
            SHEET.shafts,
            layshaft_inertia_kgm2=ratio**2 - 1e-3,
            input_inertia_kgm2=1e-3 * SHEET.splitter.high.ratio**2,
            friction_nms=0.0,
        ),
        sleeve=replace(SHEET.sleeve, speed_m_s=0.25, delay_sd_s=0.0),
    )


def limit_values(**changed: float) -> dict[str, float]:
    """Everything off but what is named, as `dog__face_friction=0.1`; force 1 kN on 3 kg."""
    values = linear() | {
        "sleeve.noise_sd_ms": 0.0,
        "sleeve.force_n": 1000.0,
        "sleeve.friction_n": 0.0,
        "sleeve.mass_kg": 3.0,
        "sleeve.damping_nsm": 0.0,
        "dog.static_factor": 1.0,
    }
    return values | {name.replace("__", "."): value for name, value in changed.items()}


class Outcome(NamedTuple):
    """What an engagement came to. entered: the tooth got into the gap and stayed."""

    contact: Engaged
    passed: Engaged | None
    locked: Engaged | None
    blocked: bool
    slip_after_rad_s: float

    @property
    def in_gap(self) -> bool:
        """Whether the tooth got into a gap."""
        return self.passed is not None or self.contact.event is EngagementEvent.GAP_CONTACT

    @property
    def clean(self) -> bool:
        """Into a gap at first contact, and no flank before the overlap held."""
        gap = self.contact.event is EngagementEvent.GAP_CONTACT
        return gap and self.locked is not None and self.locked.tally.ratchets == 0


class Trials:
    """One gearbox in which engagements are tried one after the other: the sleeve is put back into
    neutral, the gear given phase and slip, the valve opened."""

    def __init__(self, sheet: GearboxSheet, values: Mapping[str, float]) -> None:
        self.world = world(values, sheet)
        self.engagement, self.plant = self.world.engagement, self.world.plant
        self._axis = self.engagement.sleeves[SLEEVE_OF_MAIN[GEAR].sleeve].axis
        self._actuator = self.world.sheet.sleeve
        self.delay_s = self._actuator.delay_s
        self.pitch_rad = self.world.sheet.dog.pitch_rad
        self.backlash_rad = self.world.sheet.dog.backlash_rad
        self.plant.script_layshaft(0.0)
        self.plant.coast()

    def engage(self, phase_rad: float, slip_rad_s: float, patience_us: float = 2e7) -> Outcome:
        """With this phase and slip at contact, if the slip does not change on the way."""
        self._reset(phase_rad - slip_rad_s * self.delay_s, slip_rad_s)
        plant, engagement = self.plant, self.engagement
        engagement.records.clear()
        engagement.lines.clear()
        start_us = plant.time_us
        engagement.switch(VALVE_OF_MAIN[GEAR], True, start_us)
        found: dict[EngagementEvent, Engaged] = {}
        while plant.time_us < start_us + patience_us:
            event = plant.advance(start_us + patience_us, engagement.next_us)
            if event == at.REACHED:
                break
            self.world._handle(event)
            for record in engagement.records:
                found.setdefault(record.event, record)
            if EngagementEvent.LOCKED in found or EngagementEvent.BLOCKED in found:
                break
        contact = found.get(EngagementEvent.GAP_CONTACT) or found[EngagementEvent.TOOTH_CONTACT]
        return Outcome(
            contact,
            found.get(EngagementEvent.TOOTH_PASSED),
            found.get(EngagementEvent.LOCKED),
            EngagementEvent.BLOCKED in found,
            plant.slip_rad_s(GEAR),
        )

    def _reset(self, phase_rad: float, slip_rad_s: float) -> None:
        plant, engagement = self.plant, self.engagement
        name = SLEEVE_OF_MAIN[GEAR].sleeve
        engagement._leave_face(name)
        engagement._energised.clear()
        plant.unwatch(ROWS[name])
        plant.coast()
        engagement.sleeves[name] = TruckSleeve(self._actuator, 0, self._axis)
        omega = (plant.main_rad_s + slip_rad_s) / plant.ratio(GEAR)
        for body, rate in plant.chain.rates(plant.chain.group(at.LAYSHAFT), at.LAYSHAFT).items():
            plant.y[at.SPEED + body] = omega * rate
        half = self.pitch_rad / 2.0
        plant.y[at.PHASE + INDEX[GEAR]] = (phase_rad + half) % self.pitch_rad - half
        plant.y[at.LASH + 1 + INDEX[GEAR]] = 0.0
        plant.y[at.SUPPLY_PA] = plant.g[at.GOVERNED_PA]


def share(hits: int, trials: int, expected: float) -> float:
    """How many standard errors a counted share is from the expected one."""
    error = math.sqrt(max(expected * (1.0 - expected), 1.0 / trials) / trials)
    return (hits / trials - expected) / error
