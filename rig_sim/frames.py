"""What the rig says on the bus at a 10 ms read, in the order of the wire contract."""

from __future__ import annotations

from typing import Final

from dbc.messages import (
    EEC1,
    EdgesInputFall,
    EdgesInputRise,
    EdgesLayshaftFall,
    EdgesLayshaftRise,
    EdgesMainFall,
    EdgesMainRise,
    EdgesPropellerFall,
    EdgesPropellerRise,
    GearboxSensors,
    Message,
    ReferenceEncoder,
    ReferenceEngagement,
    ReferencePhase,
    SleevesAux,
    SleevesMain,
    ValveStatus,
)
from dbc.messages import (
    MainGear as WireGear,
)
from gearbox.gears import MainGear, Sleeve
from gearbox.sheet import RPM
from rig_sim.engagement import Engaged
from rig_sim.kernels import TAU
from rig_sim.sensors import ENCODER_MODULUS, ENCODER_STEPS_PER_TURN
from rig_sim.settings import CLOCK_MODULUS
from rig_sim.shafts import Angle
from rig_sim.world import World

_new: Final = tuple.__new__  # a NamedTuple without its constructor's argument handling
EDGES: Final[tuple[type[Message], ...]] = (
    EdgesInputRise,
    EdgesInputFall,
    EdgesLayshaftRise,
    EdgesLayshaftFall,
    EdgesMainRise,
    EdgesMainFall,
    EdgesPropellerRise,
    EdgesPropellerFall,
)
OIL_K: Final = 353.15
SENSOR_MAX_PA: Final = 13.107e5  # the pressure signals saturate here, as their sensors would
ENGINE_MAX_RAD_S: Final = 8031.875 * RPM  # likewise SPN 190
COUNT_MODULUS: Final = 1 << 16


def read_messages(world: World, now_us: int) -> list[Message]:
    """All cyclic messages of the read at this instant, to which the world has been run."""
    clock_us = (world.clock_start_us + now_us) % CLOCK_MODULUS
    messages: list[Message] = [
        _new(edges, (clock_us, index, valid, long, stopped, False, stamps))
        for edges, (index, valid, long, stopped, stamps) in zip(
            EDGES, world.edges.read(now_us, world.clock_start_us), strict=True
        )
    ]
    clutch = world.clutch.position(now_us)
    messages.append(_sensors(world, clock_us, clutch))
    messages.extend(_sleeves(world, now_us, clock_us))
    messages.append(valve_status(world, now_us))
    input_rad_s = world.plant.layshaft_rad_s * world.shafts.input_mesh.ratio
    engine_rad_s = world.engine.speed_rad_s(now_us, clutch, input_rad_s)
    messages.append(EEC1(engine_speed_rad_s=min(engine_rad_s, ENGINE_MAX_RAD_S)))
    angles, speeds = world.encoder.read(now_us)
    messages.append(ReferenceEncoder(sample_time_us=clock_us, angle_rad=angles, speed_rad_s=speeds))
    messages.append(_phases(world, clock_us))
    return messages


def engagement_message(record: Engaged, clock_start_us: int) -> ReferenceEngagement:
    """An event between gear and sleeve; its time is rounded down to the microsecond."""
    return ReferenceEngagement(
        event_time_us=(clock_start_us + int(record.time_us)) % CLOCK_MODULUS,
        event=record.event,
        gear=WireGear(record.gear),
        phase_rad=record.phase_rad,
        slip_rad_s=record.slip_rad_s,
        drive_gear=record.drive_gear,
    )


def valve_status(world: World, now_us: int) -> ValveStatus:
    """What the valve drivers do at this instant."""
    valves = world.valves
    return ValveStatus._make(
        (
            (world.clock_start_us + now_us) % CLOCK_MODULUS,
            *valves.energised,
            *valves.pending,
            valves.refused % COUNT_MODULUS,
            valves.expired % COUNT_MODULUS,
        )
    )


def _sensors(world: World, clock_us: int, clutch: float) -> GearboxSensors:
    air = world.sheet.air
    return GearboxSensors(
        sample_time_us=clock_us,
        brake_pressure_pa=min(air.atmosphere_pa + world.plant.brake_gauge_pa, SENSOR_MAX_PA),
        supply_pressure_pa=min(air.atmosphere_pa + air.supply_gauge_pa, SENSOR_MAX_PA),
        oil_temperature_k=OIL_K,
        clutch_position_fraction=clutch,
    )


def _sleeves(world: World, now_us: int, clock_us: int) -> list[Message]:
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


def _phases(world: World, clock_us: int) -> ReferencePhase:
    shafts = world.shafts
    return ReferencePhase(
        sample_time_us=clock_us,
        main_angle_rad=_encoder_rad(shafts.main),
        main_speed_rad_s=world.plant.main_rad_s,
        phase_crawl_rad=shafts.phase_rad(MainGear.CRAWL),
        phase_first_rad=shafts.phase_rad(MainGear.FIRST),
        phase_second_rad=shafts.phase_rad(MainGear.SECOND),
        phase_third_rad=shafts.phase_rad(MainGear.THIRD),
    )


def _encoder_rad(angle: Angle) -> float:
    steps = angle[0] * ENCODER_STEPS_PER_TURN + round(angle[1] / TAU * ENCODER_STEPS_PER_TURN)
    return steps % ENCODER_MODULUS * (TAU / ENCODER_STEPS_PER_TURN)
