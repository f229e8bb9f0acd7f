"""The virtual gearbox driven by values instead of nodes: what is on, what is asked of the engine.

Between values and rig stand the bus's own frames, made and read in this process, so that it is the
same rig to the byte, the end-to-end protection and the valves' expiry included.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import torque_parts
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Transmitter, read_alone
from meshpoint.dbc.messages import (
    EEC1,
    TSC1,
    BenchAction,
    BenchCommand,
    ClutchAction,
    ClutchCommand,
    EngagementEvent,
    GearboxSensors,
    MainGear,
    ReferenceEngagement,
    SleevesAux,
    SleevesMain,
    TscOverrideMode,
    ValveAction,
    ValveCommand,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.wheels import SHAFTS
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import RigSettings
from meshpoint.units import TURN, US

CYCLE_US: Final = 10_000
"""Commands are renewed within this time: 100 ms without them, and the valves are off."""
VALVES: Final = tuple(valve.name.lower() for valve in ValveName)
HEARD: Final = {
    codec.spec.can_id: codec
    for codec in CODECS.values()
    if codec.message_type in (EEC1, GearboxSensors, SleevesAux, SleevesMain, ReferenceEngagement)
}
SLOPE: Final = "vehicle.slope_percent"
CONTACTS: Final = {EngagementEvent.GAP_CONTACT: True, EngagementEvent.TOOTH_CONTACT: False}


@dataclass
class Inputs:
    """What is asked of the rig, from now on."""

    valves: dict[str, bool] = field(default_factory=lambda: dict.fromkeys(VALVES, False))
    """Which coils are on."""
    clutch_closed: bool = True
    engine_speed_rad_s: float | None = None
    """The speed asked of the engine; None: it goes as its driver wants."""
    engine_torque_fraction: float | None = None
    """The torque asked of it, of its reference torque, where no speed is."""
    gear: int = 0
    """Where it is another than before: the bench brings the gearbox into this gear."""
    main_speed_rad_s: float = 0.0
    """The speed that the bench brings the main shaft to."""
    slope_added_percent: float = 0.0
    """The road's slope beyond the one that was drawn."""


@dataclass
class Contact:
    """A main sleeve has met its gear's teeth."""

    count: int = 0
    """How many there have been."""
    time_us: int = 0
    """Since power-up, by the sensors' clock."""
    gear: MainGear = MainGear.NEUTRAL
    in_gap: bool = False
    phase_rad: float = 0.0
    slip_rad_s: float = 0.0


class DrivenRig:
    """A rig from power-up on. Its state is `truth`, what its sensors say `heard`."""

    def __init__(self, sheet: GearboxSheet, settings: RigSettings) -> None:
        self._core = RigCore(sheet, settings)
        self._node = Transmitter(Node.TRANSMISSION_CONTROL)
        self._bench = Transmitter(Node.BENCH)
        self._gear, self._sequence = 0, 0
        self._slope_added_percent = 0.0
        vehicle = (self._core.as_built or {}).get("vehicle", {})
        self._slope_percent = float(vehicle.get("slope_percent", 0.0))
        self.truth = self._core.truth
        self.heard: dict[str, Any] = {}
        """The newest message of each kind, by its name."""
        self.contact = Contact()

    def advance(self, from_us: int, to_us: int, inputs: Inputs) -> None:
        """Drives it by these inputs from one time to another; both since any zero, from first to
        last without a hole."""
        self._incline(inputs.slope_added_percent)
        for begin_us in range(from_us, to_us, CYCLE_US):
            for message in _commands(inputs):
                self._core.receive(self._node.encode(message))
            self._core.receive(self._bench.encode(self._bench_command(inputs)))
            self._step(begin_us)
            end_us = min(begin_us + CYCLE_US, to_us)
            while begin_us < self._core.next_step_us <= end_us:
                self._step(self._core.next_step_us)
            self._step(end_us)

    def _incline(self, added_percent: float) -> None:
        if added_percent != self._slope_added_percent:
            self._slope_added_percent = added_percent
            self._core.change_conditions({SLOPE: self._slope_percent + added_percent})

    def _bench_command(self, inputs: Inputs) -> BenchCommand:
        if inputs.gear != self._gear:
            self._gear, self._sequence = inputs.gear, self._sequence + 1
        if self._gear == 0:
            return BenchCommand(sequence=self._sequence)
        return BenchCommand(
            action=BenchAction.RETURN_TO_GEAR,
            gear=self._gear,
            sequence=self._sequence,
            main_speed_rad_s=inputs.main_speed_rad_s,
        )

    def _step(self, now_us: int) -> None:
        for frame in self._core.step(now_us).frames:
            self._hear(frame)

    def _hear(self, frame: Frame) -> None:
        codec = HEARD.get(frame.can_id)
        message = None if codec is None else read_alone(codec, frame)
        if message is None:
            return
        self.heard[type(message).__name__] = message
        if isinstance(message, ReferenceEngagement) and message.event in CONTACTS:
            since_us = (message.event_time_us - self.truth.clock_start_us) & 0xFFFF_FFFF
            self.contact = Contact(
                self.contact.count + 1,
                since_us,
                message.gear,
                CONTACTS[message.event],
                message.phase_rad,
                message.slip_rad_s,
            )


def _commands(inputs: Inputs) -> list[Any]:
    on = {f"{name}_action": _action(is_on) for name, is_on in inputs.valves.items()}
    clutch = ClutchAction.CLOSE if inputs.clutch_closed else ClutchAction.OPEN
    return [ValveCommand(**on), ClutchCommand(action=clutch), _engine(inputs)]


def _action(is_on: bool) -> ValveAction:
    return ValveAction.ON_NOW if is_on else ValveAction.OFF_NOW


def _engine(inputs: Inputs) -> TSC1:
    if inputs.engine_speed_rad_s is not None:
        return TSC1(
            override_control_mode=TscOverrideMode.SPEED_CONTROL,
            requested_speed_rad_s=inputs.engine_speed_rad_s,
        )
    if inputs.engine_torque_fraction is not None:
        whole, fine = torque_parts(inputs.engine_torque_fraction)
        return TSC1(
            override_control_mode=TscOverrideMode.TORQUE_CONTROL,
            requested_torque_fraction=whole,
            requested_torque_fine_fraction=fine,
        )
    return TSC1()


def outputs(rig: DrivenRig) -> dict[str, float | int | bool]:
    """What a simulation sees of the rig: shafts as they are, all else as its sensors say."""
    truth, contact = rig.truth, rig.contact
    found: dict[str, float | int | bool] = {}
    for shaft, angle, speed in zip(SHAFTS, truth.angles, truth.speeds_rad_s, strict=True):
        turns, rest_rad = angle
        found |= {f"{shaft}_angle_rad": turns * TURN + rest_rad, f"{shaft}_speed_rad_s": speed}
    found |= {
        "road_speed_m_s": truth.road_speed_m_s,
        "contact_count": contact.count,
        "contact_time_s": contact.time_us * US,
        "contact_gear": int(contact.gear),
        "contact_in_gap": contact.in_gap,
        "contact_phase_rad": contact.phase_rad,
        "contact_slip_rad_s": contact.slip_rad_s,
    }
    if (engine := rig.heard.get("EEC1")) is not None and engine.engine_speed_rad_s is not None:
        found["engine_speed_rad_s"] = engine.engine_speed_rad_s
    if (sensors := rig.heard.get("GearboxSensors")) is not None:
        found |= {
            "brake_pressure_pa": sensors.brake_pressure_pa,
            "supply_pressure_pa": sensors.supply_pressure_pa,
            "clutch_position_fraction": sensors.clutch_position_fraction,
        }
    if (main := rig.heard.get("SleevesMain")) is not None:
        found["first_second_m"] = main.sleeve_first_second_m[0]
        found["crawl_third_m"] = main.sleeve_crawl_third_m[0]
    if (aux := rig.heard.get("SleevesAux")) is not None:
        found["splitter_m"], found["range_m"] = aux.sleeve_splitter_m[0], aux.sleeve_range_m[0]
    return found
