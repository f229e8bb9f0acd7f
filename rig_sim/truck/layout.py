"""The records of the truck plant's kernels, and the numbers of bodies, links and events.

Five bodies in a row, each linked to the next:

    E engine --clutch-- I input shaft --splitter-- L layshaft --main-- M main shaft --range-- P

P is the propeller shaft with the vehicle. A link is open, rubs (friction torque), or is rigid; what
is rigidly linked moves as one group, led by one of its bodies.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, cast

from meshpoint.gearbox.wheels import SHAFT_OF_WHEEL
from meshpoint.kernels.structures import Record, Row, Vector
from meshpoint.rig_sim.parts.brake_disc import DiscBrake
from meshpoint.rig_sim.parts.disturbance import ChanceNumbers, Disturbance, Shaking
from meshpoint.rig_sim.parts.engine import ClutchPlates, EngineLimits
from meshpoint.rig_sim.parts.lash import Backlash
from meshpoint.rig_sim.parts.pneumatics import BrakeAir
from meshpoint.rig_sim.parts.vehicle import RoadLoad
from meshpoint.rig_sim.shared.capture_records import CHANNELS, WHEELS, Captured

BODIES: Final = 5
ENGINE, INPUT, LAYSHAFT, MAIN, PROPELLER = range(5)
LINKS: Final = 4
CLUTCH, SPLITTER, MAIN_BOX, RANGE = range(4)
GEARS: Final = 4  # crawl, first, second, third
DOGS: Final = 6  # and low and high split, where they have dog teeth
CONTACTS: Final = 5
FACE_FIRST_SECOND, FACE_CRAWL_THIRD, CONE_SPLITTER, CONE_RANGE, PLATE = range(5)
WATCHES: Final = 3  # of the first contacts: a splitter with dog teeth has faces for its cone

# --- how `advance` ends -------------------------------------------------------------------------
REACHED: Final = 0  # nothing happened up to `until`
DUE: Final = 1  # the instant asked for by `stop`
LEFT_TOP: Final = 10  # + watch: the phase has left its span at the top
LEFT_BOTTOM: Final = 20  # + watch
NO_SLIP: Final = 30  # + contact: rubbing surfaces have the same speed
STOPPED: Final = 40  # the layshaft has come to rest
LINK_SLIPS: Final = 50  # + link: its torque has left low_nm..high_nm
CAN_RELEASE: Final = 60  # + link: a sleeve that waits there can be pulled out
LET_GO: Final = 65  # the brake cannot hold the layshaft any more
MEETS_FLANK: Final = 70  # + side: a flank of the final drive is met or left; kept here

# --- sensor wheels ------------------------------------------------------------------------------
BODY_OF_WHEEL: Final = tuple(INPUT + shaft for shaft in SHAFT_OF_WHEEL)
MOST_TEETH: Final = 120  # of a sensor wheel (`meshpoint.gearbox.sheet.Wheel`)
FIRST_EDGES: Final = 16
JITTERS: Final = 4096
EXTRA_EDGE_US: Final = 60.0
HISTORY: Final = 8
HISTORY_STEP_US: Final = 2000


class RigState(Vector):
    """The integrated state; a second record of the same fields holds its rates of change, per
    second."""

    speed_rad_s: Annotated[Row[float], BODIES]
    angle_rad: Annotated[Row[float], BODIES]  # rest angle of each body, in [0, 2 pi)
    phase_rad: Annotated[Row[float], DOGS]  # i_gear theta_L - theta_M or theta_I, within a pitch
    input_lash_rad: float  # where in its mesh's backlash the input shaft lies
    lash_rad: Annotated[Row[float], DOGS]  # and each gear
    brake_pa: float  # absolute pressure in the brake
    supply_pa: float  # absolute pressure of the tank
    felt_pa: float  # brake pressure as its sensor follows it
    disc_k: float  # temperature of the brake disc
    engine_nm: float  # engine torque at the crankshaft
    clutch: float  # position, 0 open to 1 closed
    work_j: float  # put in by engine and bench
    brake_j: float  # turned into heat by the disc brake
    drag_j: float  # by bearings, oil and seals
    road_j: float  # by tyres and air
    grade_j: float  # stored by climbing
    rub_j: float  # by clutch, tooth faces and synchroniser cones
    wheels_rad_s: float  # driven wheels, at the propeller shaft; only where shafts twist
    twist_rad: float  # how far the propeller shaft is ahead of the wheels
    vehicle_rad_s: float  # vehicle's speed, at the propeller shaft; only where tyres twist too
    tyre_rad: float  # how far the tyres are twisted
    twist_j: float  # turned into heat by shafts, tyres and the tyres' slip


class TwistingShafts(Record):
    """Propeller shaft, half-shafts and tyres as built (`driveline`); all at the propeller shaft."""

    stiff_nm_rad: float  # 0: rigid, wheels and vehicle are part of body P
    damping_nms: float
    half_lash_rad: float  # half the backlash of the final drive
    wheels_kgm2: float  # with rigid tyres the vehicle as well
    tyre_nm_rad: float  # 0: rigid tyres
    tyre_nms: float
    relaxation_m: float  # road after which a rolling tyre's twist has faded to 1/e
    vehicle_kgm2: float


class PlantParameters(Record):
    """Parameters that are constant during a run."""

    step_us: float
    dogs: int  # GEARS, or DOGS
    pitch_rad: Annotated[Row[float], DOGS]  # of the dog teeth
    oil_k: float
    inertia_kgm2: Annotated[Row[float], BODIES]
    ratio: Annotated[Row[float], DOGS]  # i_gear
    drag_input_nms: float
    drag_nms: float  # at the layshaft, oil temperature included
    drag_nm: float
    drag_main_nms: float
    drag_propeller_nm: float  # of the axle's pinion
    gear_inertia_kgm2: float
    gear_drag_nms: float
    input_lash: Backlash
    main_lash: Backlash
    split_lash: Backlash  # of a splitter with dog teeth; the input shaft then has none of its own
    air: BrakeAir
    brake: DiscBrake
    engine: EngineLimits
    plates: ClutchPlates
    road: RoadLoad
    twisting: TwistingShafts
    disturbance: Disturbance
    feeling_rate: float  # 1 / lag of the brake pressure sensor, 1/s; 0: none


class Body(Record):
    """How a body moves with its group."""

    lead: int  # the body that leads the group
    rate: float  # speed over the leader's speed
    group_kgm2: float  # of a leader: inertia of its group
    forced: int  # of a leader: 1 where the bench or the held brake gives the acceleration
    accel_rad_s2: float  # of a leader: that acceleration


class Link(Record):
    """What links a body to the next."""

    low_nm: float  # torque below this, on the body behind the link, is an event
    high_nm: float  # or above this
    carried: float  # speed behind a rigid link over that before it; 0: the link is not rigid


class Connections(Record):
    """What is connected and commanded; changes at events."""

    bodies: Annotated[Row[Body], BODIES]
    links: Annotated[Row[Link], LINKS]
    valve: float  # brake valve's input u
    brake_sign: float  # direction in which the layshaft turns
    clutch_rate: float  # 1/s
    engine_mode: int  # IDLE to DRIVE of `engine`
    engine_target: float  # rad/s or Nm
    governed_pa: float  # where the compressor governor holds the tank
    meshed: int  # index of the gear in mesh, or -1
    split_meshed: int  # the same of a splitter with dog teeth
    release_nm: Annotated[Row[float], LINKS]  # torque at which a waiting release can go, or -1
    held: int  # 1 where the brake holds a stopped layshaft
    swing_us: float  # longest step for what swings now


class Contact(Record):
    """Surfaces that rub."""

    sign: float  # 0: not rubbing
    ratio: float
    friction_nm: float
    before: int  # the bodies
    behind: int


class PhaseWatch(Record):
    """A span of a gear's phase, the leaving of which is an event; one for each dog sleeve."""

    gear: int  # index; -1: not watched
    bottom_rad: float
    top_rad: float
    offset_rad: float  # added to the phase, which is kept within a pitch
    with_lash: int


class Torques(Record):
    """Torques computed together with the rates."""

    body_nm: Annotated[Row[float], BODIES]  # on each body, from outside and from friction
    link_nm: Annotated[Row[float], LINKS]  # what a rigid link puts on the body behind it
    group_nm: Annotated[Row[float], BODIES]  # sum of a group at its leader
    pull_nm: float  # at the layshaft's group without the brake
    hold_nm: float  # what the brake can hold


class Hall(Record):
    """One capture channel's edges as the wheel was made, and its faults."""

    teeth: int
    edges_rad: Annotated[Row[float], MOST_TEETH]  # angle of each edge
    drift_rad: Annotated[Row[float], MOST_TEETH]  # and how far full load moves it
    first_rad: Annotated[Row[float], FIRST_EDGES]  # error of the first edges after power-up
    silent: int
    missing: int  # number of the tooth that gives no edge, plus one; 0: none
    extra: int  # edges added to each


class Past(Record):
    """The layshaft at an instant."""

    turns: int
    rest_rad: float
    speed_rad_s: float


class Rig(Record):
    """All that the kernels read and change."""

    y: RigState
    g: Connections
    contacts: Annotated[Row[Contact], CONTACTS]
    laps: Annotated[Row[int], BODIES]  # whole turns
    slipped_rad: Annotated[Row[float], WHEELS]  # how far a sensor wheel is ahead of its shaft
    captured: Captured
    shaking: Shaking
    p: PlantParameters
    watches: Annotated[Row[PhaseWatch], WATCHES]
    hall: Annotated[Row[Hall], CHANNELS]
    wheel_rate: Annotated[Row[float], WHEELS]  # a sensor wheel's speed over its shaft's; 1 if sound
    jitter_s: Annotated[Row[float], JITTERS]  # turned into angle at the present speed
    chance: ChanceNumbers
    history: Annotated[Row[Past], HISTORY]
    stages: Annotated[Row[RigState], 4]  # rates at the stages of a step
    after: RigState  # at its end
    ahead: RigState  # the rates there
    torques: Torques

    def moving(self) -> bytes:
        """A copy of what moves or is connected: all before `p`."""
        return bytes(self.raw()[:MOVING_BYTES])

    def set_moving(self, copied: bytes) -> None:
        """As it was at a copy, of this rig or of one of the same gearbox."""
        self.raw()[:MOVING_BYTES] = copied


MOVING_BYTES: Final[int] = cast(Any, Rig).p.offset
