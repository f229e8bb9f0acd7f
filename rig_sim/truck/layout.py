"""Where everything stands in the truck plant's vectors. Shared by the kernels and their callers.

Five bodies in a row, each linked to the next:

    E engine --clutch-- I input shaft --splitter-- L layshaft --main-- M main shaft --range-- P

P is the propeller shaft with the vehicle. A link is open, rubs (friction torque), or is rigid; what
is rigidly linked moves as one group, led by one of its bodies.
"""

from __future__ import annotations

from typing import Final

BODIES: Final = 5
ENGINE, INPUT, LAYSHAFT, MAIN, PROPELLER = range(5)
LINKS: Final = 4
CLUTCH, SPLITTER, MAIN_BOX, RANGE = range(4)

# --- state y: what is integrated --------------------------------------------------------------
SPEED: Final = 0  # 5: rad/s
ANGLE: Final = 5  # 5: rest angle of each body, rad in [0, 2 pi)
PHASE: Final = 10  # 4: i_gear theta_L - theta_M of crawl, first, second, third, within a pitch
LASH: Final = 14  # 5: where in its mesh's backlash the input shaft and each gear lies, rad
BRAKE_PA: Final = 19  # absolute pressure in the brake
SUPPLY_PA: Final = 20  # absolute pressure of the tank
DISC_K: Final = 21  # temperature of the brake disc
TORQUE: Final = 22  # engine torque at the crankshaft, Nm
POSITION: Final = 23  # clutch, 0 open to 1 closed
WORK_J: Final = 24  # put in by engine and bench
BRAKE_J: Final = 25  # turned into heat by the disc brake
DRAG_J: Final = 26  # by bearings, oil and seals
ROAD_J: Final = 27  # by tyres and air
GRADE_J: Final = 28  # stored by climbing
RUB_J: Final = 29  # by clutch, tooth faces and synchroniser cones
WHEELS_RAD_S: Final = 30  # the vehicle's speed, at the propeller shaft; only with a compliant one
TWIST_RAD: Final = 31  # how far the propeller shaft is ahead of the vehicle
TWIST_J: Final = 32  # turned into heat by the twisted shafts
STATES: Final = 33

# --- constants p --------------------------------------------------------------------------------
INERTIA: Final = 0  # 5: kg m2
STEP_US: Final = 5
DRAG_INPUT_NMS: Final = 6
DRAG_NMS: Final = 7  # at the layshaft, oil temperature included
DRAG_NM: Final = 8
DRAG_MAIN_NMS: Final = 9
LASH_INPUT_RAD: Final = 10  # half of the backlash
LASH_MAIN_RAD: Final = 11
LASH_RATE: Final = 12  # 1/s
GEAR_INERTIA: Final = 13
GEAR_DRAG_NMS: Final = 14
MASS_KG: Final = 15
ROLLING_N: Final = 16
GRADE_N: Final = 17
AIR_NS2_M2: Final = 18  # 1/2 rho cd A
WHEEL_M: Final = 19  # wheel radius over axle ratio: vehicle speed = propeller speed x this
BRAKE_MODEL: Final = 20
BRAKE_RATE: Final = 21  # 1 / tau of 4.1, 1/s
FILL: Final = 22  # choked filling rate per Pa of supply, 1/s
EXHAUST: Final = 23  # choked exhaust rate per Pa of chamber, 1/s
CRITICAL: Final = 24
ATMOSPHERE_PA: Final = 25
DROOP: Final = 26  # brake volume over tank volume
RECOVERY: Final = 27  # 1/s
BRAKE_GAIN: Final = 28  # C_db, Nm/Pa
TOUCH_PA: Final = 29
FADE_PER_K: Final = 30
FADE_PER_RAD_S: Final = 31
DISC_REFERENCE_K: Final = 32
DISC_REFERENCE_RAD_S: Final = 33
HEAT_J_K: Final = 34
COOLING_W_K: Final = 35
OIL_K: Final = 36
ENGINE_LAG_RATE: Final = 37
ENGINE_NM_S: Final = 38
ENGINE_MAX_NM: Final = 39
ENGINE_MIN_NM: Final = 40
GOVERNOR_NMS: Final = 41
IDLE_RAD_S: Final = 42
CLUTCH_NM: Final = 43
KISS: Final = 44
RATIO: Final = 45  # 4: i_gear of crawl, first, second, third
STIFF_NM_RAD: Final = 49  # propeller and axle shafts; 0: rigid, the vehicle is part of body P
TWIST_NMS: Final = 50
VEHICLE_KGM2: Final = 51  # at the propeller shaft
CONSTANTS: Final = 52

# --- what is connected, g; changes at events ----------------------------------------------------
LEAD: Final = 0  # 5: the body that leads this body's group
RATE: Final = 5  # 5: speed over the leader's speed
GROUP: Final = 10  # 5: inertia of the group at its leader
FORCED: Final = 15  # 5: 1 where the bench or the held brake gives the group's acceleration
ACCEL: Final = 20  # 5: that acceleration
VALVE: Final = 25  # brake valve's input u
BRAKE_SIGN: Final = 26  # direction in which the layshaft turns
CLUTCH_RATE: Final = 27  # 1/s
ENGINE_MODE: Final = 28
ENGINE_TARGET: Final = 29  # rad/s or Nm
GOVERNED_PA: Final = 30  # where the compressor governor holds the tank
MESHED: Final = 31  # index of the gear in mesh, 0..3, or -1
LOW: Final = 32  # 4: a link's torque below this is an event, Nm on the body behind the link
HIGH: Final = 36  # 4: or above this
RELEASE_NM: Final = 40  # main-box torque at which a waiting release can go, or -1
HELD: Final = 41  # 1 where the brake holds a stopped layshaft
CARRIED: Final = 42  # 4: speed behind a rigid link over that before it; 0: the link is not rigid
CONNECTED: Final = 46

# --- friction slots: a row each -----------------------------------------------------------------
SLOTS: Final = 5
FACE_FIRST_SECOND, FACE_CRAWL_THIRD, CONE_SPLITTER, CONE_RANGE, PLATE = range(5)
SIGN, FRICTION_RATIO, FRICTION_NM, BEFORE, BEHIND = range(5)  # sign 0: not rubbing
SLOT: Final = 5

# --- watched phases: a row each, one for each main sleeve ----------------------------------------
GEAR, BOTTOM, TOP, OFFSET, WITH_LASH = range(5)  # gear -1: not watched
WATCH: Final = 5

# --- torques and the like found on the way, aux -------------------------------------------------
LOAD: Final = 0  # 5: torque on each body
LINK: Final = 5  # 4: torque a rigid link puts on the body behind it
SUM: Final = 9  # 5: of a group at its leader
PULL: Final = 14  # torque at the layshaft's group without the brake
HOLD: Final = 15  # what the brake can hold, Nm
AUX: Final = 16

# --- how `advance` ends -------------------------------------------------------------------------
REACHED: Final = 0  # nothing happened up to `until`
DUE: Final = 1  # the instant asked for by `stop`
LEFT_TOP: Final = 10  # + watch: the phase has left its span at the top
LEFT_BOTTOM: Final = 20  # + watch
NO_SLIP: Final = 30  # + slot: rubbing surfaces have the same speed
STOPPED: Final = 40  # the layshaft has come to rest
LINK_SLIPS: Final = 50  # + link: its torque has left LOW..HIGH
CAN_RELEASE: Final = 60
LET_GO: Final = 61  # the brake cannot hold the layshaft any more

# --- sensor wheels ------------------------------------------------------------------------------
WHEELS: Final = 4
CHANNELS: Final = 8
TOOTH, LAP, COUNT = range(3)  # columns of an edge pointer
POINTER: Final = 3
SILENT, MISSING, EXTRA = range(3)  # columns of a channel's faults
FAULTS: Final = 3
FIRST_EDGES: Final = 16
JITTERS: Final = 4096
EXTRA_EDGE_US: Final = 60.0
RING: Final = 64  # captured edges kept a channel
HISTORY: Final = 8
HISTORY_US: Final = 2000
