"""What the rig says on the bus at a 10 ms read, in the order of the wire contract."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from meshpoint.dbc.edges import EDGE_MESSAGES
from meshpoint.dbc.j1939 import torque_parts
from meshpoint.dbc.messages import (
    EEC1,
    GearboxSensors,
    Message,
    ReferenceEncoder,
    ReferenceEngagement,
    ReferencePhase,
    SleevesAux,
    SleevesMain,
    ValveStatus,
)
from meshpoint.dbc.messages import MainGear as WireGear
from meshpoint.gearbox.gears import Sleeve, SplitGear
from meshpoint.rig_sim.settings import CLOCK_MODULUS
from meshpoint.rig_sim.shared.angle_kernels import TAU
from meshpoint.rig_sim.shared.angles import Angle
from meshpoint.rig_sim.shared.edge_ring import ENCODER_MODULUS, ENCODER_STEPS_PER_TURN
from meshpoint.rig_sim.shared.engagement import Engaged
from meshpoint.rig_sim.shared.sensor_clock import SensorClock
from meshpoint.rig_sim.shared.world import RigWorld, SensorRead
from meshpoint.units import RPM

_new: Final = tuple.__new__  # a NamedTuple without its constructor's argument handling
SENSOR_MAX_PA: Final = 13.107e5  # the pressure signals saturate here, as their sensors would
ENGINE_MAX_RAD_S: Final = 8031.875 * RPM  # likewise SPN 190
COUNT_MODULUS: Final = 1 << 16
MOST_IMPACT_J: Final = 655.35
MOST_FACE_US: Final = (1 << 24) - 1
MOST_RATCHETS: Final = 127


def read_messages(world: RigWorld, now_us: int) -> list[Message]:
    """All cyclic messages of the read at this instant, to which the world has been run, in the
    order in which they are sent: the engine's, which wins the bus before all others, first. The
    truth (`TRUTH`) comes after them."""
    clock_us = world.clock.at(now_us) % CLOCK_MODULUS
    sensors = world.sensors(now_us)
    messages: list[Message] = [_engine(sensors)]
    messages += [
        _new(edges, (clock_us, index, valid, long, stopped, False, stamps))
        for edges, (index, valid, long, stopped, stamps) in zip(
            EDGE_MESSAGES, world.edge_reads(now_us), strict=True
        )
    ]
    messages.append(_sensors(sensors, clock_us))
    messages.append(valve_status(world, now_us))
    messages.extend(_sleeves(world, now_us, clock_us))
    return messages


def engagement_message(record: Engaged, clock: SensorClock) -> ReferenceEngagement:
    """An event between gear and sleeve; its time is rounded down to the microsecond. Of a splitter
    with dog teeth the gear is neutral and the drive gear 1 for the low step, 2 for the high one."""
    tally, gear, drive_gear = record.tally, WireGear.NEUTRAL, record.drive_gear
    if isinstance(record.gear, SplitGear):
        drive_gear = record.gear.split + 1
    else:
        gear = WireGear(record.gear)
    return ReferenceEngagement(
        event_time_us=clock.at(record.time_us) % CLOCK_MODULUS,
        event=record.event,
        gear=gear,
        phase_rad=record.phase_rad,
        slip_rad_s=record.slip_rad_s,
        drive_gear=drive_gear,
        impact_energy_j=min(tally.impact_j, MOST_IMPACT_J),
        face_time_us=min(tally.face_us, MOST_FACE_US),
        ratchets=min(tally.ratchets, MOST_RATCHETS),
        blocked=tally.blocked,
    )


def valve_status(world: RigWorld, now_us: int) -> ValveStatus:
    """What the valve drivers do at this instant."""
    valves = world.valves
    return ValveStatus._make(
        (
            world.clock.at(now_us) % CLOCK_MODULUS,
            *valves.energised,
            *valves.pending,
            valves.refused % COUNT_MODULUS,
            valves.expired % COUNT_MODULUS,
        )
    )


def _engine(sensors: SensorRead) -> EEC1:
    whole = fine = None
    if sensors.torque_share is not None:
        whole, fine = torque_parts(sensors.torque_share)
    return EEC1(
        engine_speed_rad_s=min(sensors.engine_rad_s, ENGINE_MAX_RAD_S),
        actual_engine_torque_fraction=whole,
        actual_engine_torque_fine_fraction=fine,
    )


def _sensors(sensors: SensorRead, clock_us: int) -> GearboxSensors:
    return GearboxSensors._make(
        (
            clock_us,
            min(sensors.brake_pa, SENSOR_MAX_PA),
            min(sensors.supply_pa, SENSOR_MAX_PA),
            sensors.oil_k,
            sensors.clutch,
        )
    )


def _sleeves(world: RigWorld, now_us: int, clock_us: int) -> list[Message]:
    return [
        SleevesMain(
            sample_time_us=clock_us,
            sleeve_first_second_m=world.sleeve_samples_m(Sleeve.FIRST_SECOND, now_us),
            sleeve_crawl_third_m=world.sleeve_samples_m(Sleeve.CRAWL_THIRD, now_us),
        ),
        SleevesAux(
            sample_time_us=clock_us,
            sleeve_splitter_m=world.sleeve_samples_m(Sleeve.SPLITTER, now_us),
            sleeve_range_m=world.sleeve_samples_m(Sleeve.RANGE, now_us),
        ),
    ]


def _encoder(world: RigWorld, now_us: int) -> ReferenceEncoder:
    clock_us = world.clock.at(now_us) % CLOCK_MODULUS
    angles, speeds = world.encoder_read(now_us)
    return ReferenceEncoder(sample_time_us=clock_us, angle_rad=angles, speed_rad_s=speeds)


def _phases(world: RigWorld, now_us: int) -> ReferencePhase:
    clock_us = world.clock.at(now_us) % CLOCK_MODULUS
    angle, speed_rad_s, phases_rad = world.phase_read()
    return ReferencePhase._make(
        (clock_us, _encoder_rad(angle), speed_rad_s, *phases_rad, world.truth.road_speed_m_s)
    )


def _encoder_rad(angle: Angle) -> float:
    steps = angle[0] * ENCODER_STEPS_PER_TURN + round(angle[1] / TAU * ENCODER_STEPS_PER_TURN)
    return steps % ENCODER_MODULUS * (TAU / ENCODER_STEPS_PER_TURN)


TRUTH: Final[dict[type[Message], Callable[[RigWorld, int], Message]]] = {
    ReferenceEncoder: _encoder,
    ReferencePhase: _phases,
}
"""For logs and studies, by message: no node may act by it."""
