# Written by `python -m meshpoint.dbc.stubs` from meshpoint.dbc. Do not edit.
"""The messages and enumerations of the DBC as Python classes in SI units."""

from enum import IntEnum
from typing import Final, NamedTuple, TypeAlias

class ValveAction(IntEnum):
    OFF_NOW = 0
    ON_NOW = 1
    OFF_AT = 2
    ON_AT = 3

class ClutchAction(IntEnum):
    OPEN = 0
    CLOSE = 1

class ControllerState(IntEnum):
    STARTING = 0
    IN_GEAR = 1
    NEUTRAL = 2
    CLUTCH_OPENING = 3
    DISENGAGING = 4
    SYNCHRONISING = 5
    COASTING = 6
    ENGAGING = 7
    RETRACTING = 8
    CLUTCH_CLOSING = 9
    STEPS_CHANGING = 10
    SPEED_RAISING = 11
    CLUTCH_PARTING = 12
    FAULTED = 13
    SPLITTER_CHANGING = 14
    HALTED = 15

class Strategy(IntEnum):
    SPEED_WINDOW = 0
    SPEED_WINDOW_ANTICIPATING = 1
    TARGET_PHASE = 2

class Estimator(IntEnum):
    WINDOW = 0
    THESIS = 1
    CROSSING = 2

class PhaseReference(IntEnum):
    UNKNOWN = 0
    KNOWN = 1

class Engagement(IntEnum):
    MAIN_GEAR = 0
    SPLITTER = 1

class ReferenceSource(IntEnum):
    NONE = 0
    MEASURED = 1
    RESTORED = 2
    NARROWED = 3
    UNSEEN = 4

class ShiftResult(IntEnum):
    NONE = 0
    ENGAGED = 1
    ENDED_IN_NEUTRAL = 2
    ENDED_IN_OLD_GEAR = 3
    REFUSED = 4
    ENDED_BETWEEN_GEARS = 5

class ShiftDecision(IntEnum):
    NONE = 0
    BRAKE = 1
    RELEASE = 2
    WAIT_FOR_SLIP = 3
    WAIT_FOR_GAP = 4
    FIRE = 5
    COMMITTED = 6
    RETRACT = 7

class FaultCode(IntEnum):
    NONE = 0
    SPEED_STALE = 1
    POSITION_STALE = 2
    VALVE_LINK_LOST = 3
    CLUTCH_STUCK = 4
    DISENGAGE_FAILED = 5
    SYNCHRONISE_FAILED = 6
    ENGAGE_FAILED = 7
    GUARD_BLOCKED = 8
    REQUEST_IMPOSSIBLE = 9
    LOW_SUPPLY = 10
    INPUT_OVERSPEED = 11
    DISENGAGE_REFUSED = 12
    BRAKE_LIMIT = 13
    SPLITTER_FAILED = 14
    RANGE_FAILED = 15
    ENGINE_FAILED = 16
    INPUT_WHEEL_WRONG = 17
    LAYSHAFT_WHEEL_WRONG = 18
    MAIN_WHEEL_WRONG = 19
    PROPELLER_WHEEL_WRONG = 20
    WHEELS_DISAGREE = 21
    SLIP_AT_CONTACT = 22

class MainGear(IntEnum):
    NEUTRAL = 0
    CRAWL = 1
    FIRST = 2
    SECOND = 3
    THIRD = 4

class EngagementEvent(IntEnum):
    READY = 0
    GAP_CONTACT = 1
    TOOTH_CONTACT = 2
    TOOTH_PASSED = 3
    LOCKED = 4
    RELEASED = 5
    BLOCKED = 6
    GIVEN_UP = 7
    CLUTCH_OPENS = 8
    PLATES_PARTED = 9
    BRAKE_FILLS = 10
    BRAKE_EMPTIES = 11
    CLUTCH_CLOSES = 12
    PLATES_MET = 13

class RigFault(IntEnum):
    NO_FAULT = 0
    HALL_DROPOUT = 1
    HALL_MISSING_TOOTH = 2
    HALL_DOUBLE_EDGE = 3
    HALL_NOISE_BURST = 4
    VALVE_STUCK = 5
    VALVE_SLOW = 6
    SUPPLY_DROP = 7
    SLEEVE_JAMMED = 8
    POSITION_OFFSET = 9
    POSITION_FROZEN = 10
    FROZEN_PAYLOAD = 11
    BRAKE_FADE = 12
    CLUTCH_STUCK = 13
    ENGINE_DEAF = 14
    CLOCK_DRIFT = 15
    CLOCK_STEP = 16
    NODE_RESTART = 17
    NODE_STALLED = 18
    WHEEL_FACTOR = 19
    VALVE_SLOW_ON = 20
    VALVE_SLOW_OFF = 21
    VALVE_LEAKS = 22
    SLEEVE_STIFF = 23
    SLEEVE_HEAVY = 24

class BenchAction(IntEnum):
    IDLE = 0
    RETURN_TO_GEAR = 1
    HOLD = 2

class Flank(IntEnum):
    NO_FLANK = 0
    TRAILING = 1
    LEADING = 2

class J1939Measured(IntEnum):
    NO = 0
    YES = 1
    ERROR = 2
    NOT_AVAILABLE = 3

class TscOverrideMode(IntEnum):
    OVERRIDE_DISABLED = 0
    SPEED_CONTROL = 1
    TORQUE_CONTROL = 2
    SPEED_TORQUE_LIMIT = 3

class EdgesInputRise(NamedTuple):
    """Input shaft Hall sensor: the last 27 rising tooth edges (thesis figure 2.2), newest first.

    GearboxIo -> TransmissionControl, every 10 ms.
    """

    read_time_us: int = ...
    """Sensor clock when the capture array was read; wraps every 71.6 minutes (0..4294967295)."""

    newest_index: int = ...
    """Number of rising edges since power-up, modulo 65536; the newest edge carries this number, 0
    when none came yet (0..65535)."""

    valid_stamps: int = ...
    """How many entries of the array hold an edge; fewer than 27 only after power-up (0..27)."""

    long_interval: bool = ...
    """An interval inside the array was over 65535 us: entries beyond it cannot be chained."""

    stopped: bool = ...
    """No edge for over 65535 us before the read: the newest entry cannot be placed by its low 16
    bits alone, and the index may be wrong."""

    sensor_fault: bool = ...
    """The sensor supply or signal is out of range."""

    timestamp_low_us: tuple[int, ...] = ...
    """27 values; the first: Low 16 bits of the sensor clock at the newest edge; chained back from
    the read time (0..65535)."""

class EdgesInputFall(NamedTuple):
    """Input shaft Hall sensor: the last 27 falling tooth edges (thesis figure 2.2), newest first.

    GearboxIo -> TransmissionControl, every 10 ms.
    """

    read_time_us: int = ...
    """Sensor clock when the capture array was read; wraps every 71.6 minutes (0..4294967295)."""

    newest_index: int = ...
    """Number of falling edges since power-up, modulo 65536; the newest edge carries this number, 0
    when none came yet (0..65535)."""

    valid_stamps: int = ...
    """How many entries of the array hold an edge; fewer than 27 only after power-up (0..27)."""

    long_interval: bool = ...
    """An interval inside the array was over 65535 us: entries beyond it cannot be chained."""

    stopped: bool = ...
    """No edge for over 65535 us before the read: the newest entry cannot be placed by its low 16
    bits alone, and the index may be wrong."""

    sensor_fault: bool = ...
    """The sensor supply or signal is out of range."""

    timestamp_low_us: tuple[int, ...] = ...
    """27 values; the first: Low 16 bits of the sensor clock at the newest edge; chained back from
    the read time (0..65535)."""

class EdgesLayshaftRise(NamedTuple):
    """Layshaft shaft Hall sensor: the last 27 rising tooth edges (thesis figure 2.2), newest first.

    GearboxIo -> TransmissionControl, every 10 ms.
    """

    read_time_us: int = ...
    """Sensor clock when the capture array was read; wraps every 71.6 minutes (0..4294967295)."""

    newest_index: int = ...
    """Number of rising edges since power-up, modulo 65536; the newest edge carries this number, 0
    when none came yet (0..65535)."""

    valid_stamps: int = ...
    """How many entries of the array hold an edge; fewer than 27 only after power-up (0..27)."""

    long_interval: bool = ...
    """An interval inside the array was over 65535 us: entries beyond it cannot be chained."""

    stopped: bool = ...
    """No edge for over 65535 us before the read: the newest entry cannot be placed by its low 16
    bits alone, and the index may be wrong."""

    sensor_fault: bool = ...
    """The sensor supply or signal is out of range."""

    timestamp_low_us: tuple[int, ...] = ...
    """27 values; the first: Low 16 bits of the sensor clock at the newest edge; chained back from
    the read time (0..65535)."""

class EdgesLayshaftFall(NamedTuple):
    """Layshaft shaft Hall sensor: the last 27 falling tooth edges (thesis figure 2.2), newest
    first.

    GearboxIo -> TransmissionControl, every 10 ms.
    """

    read_time_us: int = ...
    """Sensor clock when the capture array was read; wraps every 71.6 minutes (0..4294967295)."""

    newest_index: int = ...
    """Number of falling edges since power-up, modulo 65536; the newest edge carries this number, 0
    when none came yet (0..65535)."""

    valid_stamps: int = ...
    """How many entries of the array hold an edge; fewer than 27 only after power-up (0..27)."""

    long_interval: bool = ...
    """An interval inside the array was over 65535 us: entries beyond it cannot be chained."""

    stopped: bool = ...
    """No edge for over 65535 us before the read: the newest entry cannot be placed by its low 16
    bits alone, and the index may be wrong."""

    sensor_fault: bool = ...
    """The sensor supply or signal is out of range."""

    timestamp_low_us: tuple[int, ...] = ...
    """27 values; the first: Low 16 bits of the sensor clock at the newest edge; chained back from
    the read time (0..65535)."""

class EdgesMainRise(NamedTuple):
    """Main shaft Hall sensor: the last 27 rising tooth edges (thesis figure 2.2), newest first.

    GearboxIo -> TransmissionControl, every 10 ms.
    """

    read_time_us: int = ...
    """Sensor clock when the capture array was read; wraps every 71.6 minutes (0..4294967295)."""

    newest_index: int = ...
    """Number of rising edges since power-up, modulo 65536; the newest edge carries this number, 0
    when none came yet (0..65535)."""

    valid_stamps: int = ...
    """How many entries of the array hold an edge; fewer than 27 only after power-up (0..27)."""

    long_interval: bool = ...
    """An interval inside the array was over 65535 us: entries beyond it cannot be chained."""

    stopped: bool = ...
    """No edge for over 65535 us before the read: the newest entry cannot be placed by its low 16
    bits alone, and the index may be wrong."""

    sensor_fault: bool = ...
    """The sensor supply or signal is out of range."""

    timestamp_low_us: tuple[int, ...] = ...
    """27 values; the first: Low 16 bits of the sensor clock at the newest edge; chained back from
    the read time (0..65535)."""

class EdgesMainFall(NamedTuple):
    """Main shaft Hall sensor: the last 27 falling tooth edges (thesis figure 2.2), newest first.

    GearboxIo -> TransmissionControl, every 10 ms.
    """

    read_time_us: int = ...
    """Sensor clock when the capture array was read; wraps every 71.6 minutes (0..4294967295)."""

    newest_index: int = ...
    """Number of falling edges since power-up, modulo 65536; the newest edge carries this number, 0
    when none came yet (0..65535)."""

    valid_stamps: int = ...
    """How many entries of the array hold an edge; fewer than 27 only after power-up (0..27)."""

    long_interval: bool = ...
    """An interval inside the array was over 65535 us: entries beyond it cannot be chained."""

    stopped: bool = ...
    """No edge for over 65535 us before the read: the newest entry cannot be placed by its low 16
    bits alone, and the index may be wrong."""

    sensor_fault: bool = ...
    """The sensor supply or signal is out of range."""

    timestamp_low_us: tuple[int, ...] = ...
    """27 values; the first: Low 16 bits of the sensor clock at the newest edge; chained back from
    the read time (0..65535)."""

class EdgesPropellerRise(NamedTuple):
    """Propeller shaft Hall sensor: the last 27 rising tooth edges (thesis figure 2.2), newest
    first.

    GearboxIo -> TransmissionControl, every 10 ms.
    """

    read_time_us: int = ...
    """Sensor clock when the capture array was read; wraps every 71.6 minutes (0..4294967295)."""

    newest_index: int = ...
    """Number of rising edges since power-up, modulo 65536; the newest edge carries this number, 0
    when none came yet (0..65535)."""

    valid_stamps: int = ...
    """How many entries of the array hold an edge; fewer than 27 only after power-up (0..27)."""

    long_interval: bool = ...
    """An interval inside the array was over 65535 us: entries beyond it cannot be chained."""

    stopped: bool = ...
    """No edge for over 65535 us before the read: the newest entry cannot be placed by its low 16
    bits alone, and the index may be wrong."""

    sensor_fault: bool = ...
    """The sensor supply or signal is out of range."""

    timestamp_low_us: tuple[int, ...] = ...
    """27 values; the first: Low 16 bits of the sensor clock at the newest edge; chained back from
    the read time (0..65535)."""

class EdgesPropellerFall(NamedTuple):
    """Propeller shaft Hall sensor: the last 27 falling tooth edges (thesis figure 2.2), newest
    first.

    GearboxIo -> TransmissionControl, every 10 ms.
    """

    read_time_us: int = ...
    """Sensor clock when the capture array was read; wraps every 71.6 minutes (0..4294967295)."""

    newest_index: int = ...
    """Number of falling edges since power-up, modulo 65536; the newest edge carries this number, 0
    when none came yet (0..65535)."""

    valid_stamps: int = ...
    """How many entries of the array hold an edge; fewer than 27 only after power-up (0..27)."""

    long_interval: bool = ...
    """An interval inside the array was over 65535 us: entries beyond it cannot be chained."""

    stopped: bool = ...
    """No edge for over 65535 us before the read: the newest entry cannot be placed by its low 16
    bits alone, and the index may be wrong."""

    sensor_fault: bool = ...
    """The sensor supply or signal is out of range."""

    timestamp_low_us: tuple[int, ...] = ...
    """27 values; the first: Low 16 bits of the sensor clock at the newest edge; chained back from
    the read time (0..65535)."""

class GearboxSensors(NamedTuple):
    """Pneumatics, oil and clutch as the gearbox sensors see them.

    GearboxIo -> TransmissionControl, every 10 ms.
    """

    sample_time_us: int = ...
    """Sensor clock of the samples (0..4294967295)."""

    brake_pressure_pa: float = ...
    """Absolute pressure between brake valve and brake (p_valve of thesis 4.1) (0..1310700)."""

    supply_pressure_pa: float = ...
    """Absolute pressure of the air supply (0..1310700)."""

    oil_temperature_k: float = ...
    """Gearbox oil (213.15..473.15)."""

    clutch_position_fraction: float = ...
    """0 % open, 100 % closed (0..1)."""

class SleevesMain(NamedTuple):
    """Axial positions of two sleeves, ten samples each, newest first; 0 mm is neutral.

    GearboxIo -> TransmissionControl, every 10 ms.
    """

    sample_time_us: int = ...
    """Sensor clock of the newest samples; the others are 1 ms apart (0..4294967295)."""

    sensor_fault: int = ...
    """Bit 0: first sensor out of range; bit 1: second sensor (0..3)."""

    sleeve_first_second_m: tuple[float, ...] = ...
    """10 values; the first: Sleeve of first (negative) and second (positive) gear, 0 ms before the
    newest (-0.02..0.02)."""

    sleeve_crawl_third_m: tuple[float, ...] = ...
    """10 values; the first: Sleeve of crawl (negative) and third (positive) gear, 0 ms before the
    newest (-0.02..0.02)."""

class SleevesAux(NamedTuple):
    """Axial positions of two sleeves, ten samples each, newest first; 0 mm is neutral.

    GearboxIo -> TransmissionControl, every 10 ms.
    """

    sample_time_us: int = ...
    """Sensor clock of the newest samples; the others are 1 ms apart (0..4294967295)."""

    sensor_fault: int = ...
    """Bit 0: first sensor out of range; bit 1: second sensor (0..3)."""

    sleeve_splitter_m: tuple[float, ...] = ...
    """10 values; the first: Sleeve of the splitter, low negative, high positive, 0 ms before the
    newest (-0.02..0.02)."""

    sleeve_range_m: tuple[float, ...] = ...
    """10 values; the first: Sleeve of the range, low negative, high positive, 0 ms before the
    newest (-0.02..0.02)."""

class ValveStatus(NamedTuple):
    """What the valve drivers do.

    GearboxIo -> Bench, TransmissionControl, every 10 ms.
    """

    sample_time_us: int = ...
    """Sensor clock of this state (0..4294967295)."""

    brake_energised: bool = ...
    """Valve Brake is driven now."""

    split_low_energised: bool = ...
    """Valve SplitLow is driven now."""

    split_high_energised: bool = ...
    """Valve SplitHigh is driven now."""

    main_first_energised: bool = ...
    """Valve MainFirst is driven now."""

    main_second_energised: bool = ...
    """Valve MainSecond is driven now."""

    main_crawl_energised: bool = ...
    """Valve MainCrawl is driven now."""

    main_third_energised: bool = ...
    """Valve MainThird is driven now."""

    range_low_energised: bool = ...
    """Valve RangeLow is driven now."""

    range_high_energised: bool = ...
    """Valve RangeHigh is driven now."""

    brake_pending: bool = ...
    """Valve Brake has an activation waiting in its slot."""

    split_low_pending: bool = ...
    """Valve SplitLow has an activation waiting in its slot."""

    split_high_pending: bool = ...
    """Valve SplitHigh has an activation waiting in its slot."""

    main_first_pending: bool = ...
    """Valve MainFirst has an activation waiting in its slot."""

    main_second_pending: bool = ...
    """Valve MainSecond has an activation waiting in its slot."""

    main_crawl_pending: bool = ...
    """Valve MainCrawl has an activation waiting in its slot."""

    main_third_pending: bool = ...
    """Valve MainThird has an activation waiting in its slot."""

    range_low_pending: bool = ...
    """Valve RangeLow has an activation waiting in its slot."""

    range_high_pending: bool = ...
    """Valve RangeHigh has an activation waiting in its slot."""

    refused_count: int = ...
    """Activations refused as late or too far ahead since power-up, modulo 65536 (0..65535)."""

    expired_count: int = ...
    """Times the 100 ms command expiry cleared the valves since power-up, modulo 65536
    (0..65535)."""

class EEC1(NamedTuple):
    """J1939-71 Electronic Engine Controller 1, PGN 61444.

    Engine -> TransmissionControl, every 10 ms.
    """

    engine_torque_mode: int | None = ...
    """SPN 899 (0..15 or None)."""

    actual_engine_torque_fine_fraction: float | None = ...
    """SPN 4154, added to SPN 513 (0..0.00875 or None)."""

    driver_demand_torque_fraction: float | None = ...
    """SPN 512 (-1.25..1.25 or None)."""

    actual_engine_torque_fraction: float | None = ...
    """SPN 513 (-1.25..1.25 or None)."""

    engine_speed_rad_s: float | None = ...
    """SPN 190 (0..841.095983 or None)."""

class ReferenceEncoder(NamedTuple):
    """Reference encoder on the layshaft (the extra sensor of thesis 6.5): truth for logs and tests,
    never an input of the controller.

    Reference -> Bench, every 10 ms.
    """

    sample_time_us: int = ...
    """Sensor clock of the newest sample; the others are 2 ms apart (0..4294967295)."""

    angle_rad: tuple[float, ...] = ...
    """5 values; the first: Layshaft angle, 0 ms before the newest, modulo 256 turns; zero is the
    rising edge of tooth 0 (0..1608.49544)."""

    speed_rad_s: tuple[float, ...] = ...
    """5 values; the first: Layshaft speed, 0 ms before the newest (-22488.3962..22488.3962)."""

class ReferencePhase(NamedTuple):
    """Truth: main shaft, and the phase of each gear against its sleeve; never an input of the
    controller.

    Reference -> Bench, every 10 ms.
    """

    sample_time_us: int = ...
    """Sensor clock of the sample (0..4294967295)."""

    main_angle_rad: float = ...
    """Main shaft angle modulo 256 turns; zero is the rising edge of tooth 0 (0..1608.49544)."""

    main_speed_rad_s: float = ...
    """Main shaft speed (-22488.3962..22488.3962)."""

    phase_crawl_rad: float = ...
    """Angle of a tooth of gear crawl from the middle of the sleeve's gap, wrapped to half a pitch
    either way; grows when the gear turns faster (-374.806603..374.806603)."""

    phase_first_rad: float = ...
    """Angle of a tooth of gear first from the middle of the sleeve's gap, wrapped to half a pitch
    either way; grows when the gear turns faster (-374.806603..374.806603)."""

    phase_second_rad: float = ...
    """Angle of a tooth of gear second from the middle of the sleeve's gap, wrapped to half a pitch
    either way; grows when the gear turns faster (-374.806603..374.806603)."""

    phase_third_rad: float = ...
    """Angle of a tooth of gear third from the middle of the sleeve's gap, wrapped to half a pitch
    either way; grows when the gear turns faster (-374.806603..374.806603)."""

    road_speed_m_s: float = ...
    """Speed of the vehicle over the road, uphill or down; 0 where the rig has no vehicle
    (-59652.3236..59652.3235)."""

class ReferenceEngagement(NamedTuple):
    """Truth: contact and locking of a dog clutch; never an input of the controller.

    Reference -> Bench, on events.
    """

    event_time_us: int = ...
    """Sensor clock of the event (0..4294967295)."""

    event: EngagementEvent = ...
    """What happened: between sleeve and gear, at the clutch, or at the brake."""

    gear: MainGear = ...
    """The gear it happened at; Neutral at clutch and brake."""

    phase_rad: float = ...
    """Phase at the event (-374.806603..374.806603)."""

    slip_rad_s: float = ...
    """Gear speed less sleeve speed at the event, before any impact (-22488.3962..22488.3962)."""

    drive_gear: int = ...
    """Ready: the gear number the rig stands in (0..14)."""

    impact_energy_j: float = ...
    """Locked, Blocked, GivenUp: energy lost in the flank's impact since the sleeve was fired,
    saturated; 0 in the preset thesis (0..655.35)."""

    face_time_us: int = ...
    """Likewise: time tooth on tooth (0..16777215)."""

    ratchets: int = ...
    """Likewise: times a flank threw the sleeve back, saturated (0..127)."""

    blocked: bool = ...
    """Likewise: whether sleeve and gear have stuck tooth on tooth."""

class ValveCommand(NamedTuple):
    """All valves in one frame. One pending slot a valve: the newest valid frame replaces or cancels
    it, resending an activation that has passed holds it; refused when first received over 2 ms late
    or over 100 ms ahead; expires 100 ms after the last valid frame.

    TransmissionControl -> Bench, GearboxIo, every 10 ms.
    """

    brake_action: ValveAction = ...
    """Valve Brake: switch now, or at its activation time."""

    split_low_action: ValveAction = ...
    """Valve SplitLow: switch now, or at its activation time."""

    split_high_action: ValveAction = ...
    """Valve SplitHigh: switch now, or at its activation time."""

    main_first_action: ValveAction = ...
    """Valve MainFirst: switch now, or at its activation time."""

    main_second_action: ValveAction = ...
    """Valve MainSecond: switch now, or at its activation time."""

    main_crawl_action: ValveAction = ...
    """Valve MainCrawl: switch now, or at its activation time."""

    main_third_action: ValveAction = ...
    """Valve MainThird: switch now, or at its activation time."""

    range_low_action: ValveAction = ...
    """Valve RangeLow: switch now, or at its activation time."""

    range_high_action: ValveAction = ...
    """Valve RangeHigh: switch now, or at its activation time."""

    brake_time_us: int = ...
    """Activation time of valve Brake in the sensor clock; read only by OffAt and OnAt
    (0..4294967295)."""

    split_low_time_us: int = ...
    """Activation time of valve SplitLow in the sensor clock; read only by OffAt and OnAt
    (0..4294967295)."""

    split_high_time_us: int = ...
    """Activation time of valve SplitHigh in the sensor clock; read only by OffAt and OnAt
    (0..4294967295)."""

    main_first_time_us: int = ...
    """Activation time of valve MainFirst in the sensor clock; read only by OffAt and OnAt
    (0..4294967295)."""

    main_second_time_us: int = ...
    """Activation time of valve MainSecond in the sensor clock; read only by OffAt and OnAt
    (0..4294967295)."""

    main_crawl_time_us: int = ...
    """Activation time of valve MainCrawl in the sensor clock; read only by OffAt and OnAt
    (0..4294967295)."""

    main_third_time_us: int = ...
    """Activation time of valve MainThird in the sensor clock; read only by OffAt and OnAt
    (0..4294967295)."""

    range_low_time_us: int = ...
    """Activation time of valve RangeLow in the sensor clock; read only by OffAt and OnAt
    (0..4294967295)."""

    range_high_time_us: int = ...
    """Activation time of valve RangeHigh in the sensor clock; read only by OffAt and OnAt
    (0..4294967295)."""

class ClutchCommand(NamedTuple):
    """Clutch command; expires with the valves.

    TransmissionControl -> Bench, GearboxIo, every 10 ms.
    """

    action: ClutchAction = ...
    """Clutch actuator: 0 opens, which is also what it does when commands stop."""

class TSC1(NamedTuple):
    """J1939-71 Torque/Speed Control 1, PGN 0, from the transmission to the engine.

    TransmissionControl -> Engine, every 10 ms.
    """

    override_control_mode: TscOverrideMode = ...
    """SPN 695."""

    speed_control_conditions: int | None = ...
    """SPN 696 (0..3 or None)."""

    override_priority: int | None = ...
    """SPN 897 (0..3 or None)."""

    requested_speed_rad_s: float | None = ...
    """SPN 898 (0..841.095983 or None)."""

    requested_torque_fraction: float | None = ...
    """SPN 518 (-1.25..1.25 or None)."""

    transmission_rate: int | None = ...
    """SPN 3349 (0..7 or None)."""

    control_purpose: int | None = ...
    """SPN 3350 (0..31 or None)."""

    requested_torque_fine_fraction: float | None = ...
    """SPN 4191, added to SPN 518 (0..0.00875 or None)."""

    message_counter: int | None = ...
    """SPN 4206 (0..15 or None)."""

    message_checksum: int | None = ...
    """SPN 4207 (0..15 or None)."""

class ETC1(NamedTuple):
    """J1939-71 Electronic Transmission Controller 1, PGN 61442.

    TransmissionControl -> Bench, Engine, every 10 ms.
    """

    driveline_engaged: J1939Measured = ...
    """SPN 560."""

    converter_lockup: J1939Measured = ...
    """SPN 573."""

    shift_in_process: J1939Measured = ...
    """SPN 574."""

    output_shaft_speed_rad_s: float | None = ...
    """SPN 191 (0..841.095983 or None)."""

    clutch_slip_fraction: float | None = ...
    """SPN 522 (0..1 or None)."""

    input_shaft_speed_rad_s: float | None = ...
    """SPN 161 (0..841.095983 or None)."""

    controlling_address: int | None = ...
    """SPN 1482, source address of the device that requested (0..255 or None)."""

class ETC2(NamedTuple):
    """J1939-71 Electronic Transmission Controller 2, PGN 61445.

    TransmissionControl -> Bench, Engine, every 100 ms.
    """

    selected_gear: int | None = ...
    """SPN 524, gear selected; 0 neutral, 1..12, 13 and 14 the crawl gears (-125..125 or None)."""

    actual_ratio: float | None = ...
    """SPN 526 (0..64.255 or None)."""

    current_gear: int | None = ...
    """SPN 523, gear engaged now (-125..125 or None)."""

    requested_range: int | None = ...
    """SPN 162, two ASCII characters (0..65535 or None)."""

    current_range: int | None = ...
    """SPN 163, two ASCII characters (0..65535 or None)."""

class ControllerStatus(NamedTuple):
    """One frame a step, with the highest identifier of its sender so that it closes the step on the
    bus: enough, with the consumed frames, to repeat the step byte for byte.

    TransmissionControl -> Bench, every 10 ms.
    """

    step_number: int = ...
    """Number of this step since start (0..4294967295)."""

    step_time_us: int = ...
    """Controller clock of this step, quantised to this resolution before the step
    (0..9007199263748192)."""

    previous_step_time_us: int = ...
    """The same of the step before (0..9007199263748192)."""

    consumed_count: int = ...
    """Frames consumed by this step: identifiers of this DBC, not own (0..65535)."""

    previous_consumed_count: int = ...
    """The same of the step before (0..65535)."""

    consumed_crc: int = ...
    """CRC-32 over identifier and payload of the frames consumed by this step, in order
    (0..4294967295)."""

    previous_consumed_crc: int = ...
    """The same of the step before (0..4294967295)."""

    run_hash_low: int = ...
    """First four bytes of the SHA-256 of the run header, low byte first (0..4294967295)."""

    run_hash_high: int = ...
    """The next four bytes of the SHA-256 of the run header, low byte first (0..4294967295)."""

    state: ControllerState = ...
    """Shift sequence."""

    current_gear: int = ...
    """Gear in mesh, 0 neutral, -1 not known (-1..14)."""

    target_gear: int = ...
    """Gear asked for (-1..14)."""

    strategy: Strategy = ...
    """Engagement strategy chosen."""

    estimator: Estimator = ...
    """Layshaft estimator chosen."""

    reference_known: int = ...
    """Bit 0 crawl, 1 first, 2 second, 3 third: phase reference learned (0..15)."""

    active_fault: FaultCode = ...
    """Fault that is active or ended the last shift."""

    e2e_errors: int = ...
    """Frames refused by the end-to-end check, modulo 65536 (0..65535)."""

    format_errors: int = ...
    """Frames of our identifiers with the wrong length, format or a value out of range, modulo 65536
    (0..65535)."""

    foreign_frames: int = ...
    """Frames that this DBC does not know, modulo 65536 (0..65535)."""

    guard_blocks: int = ...
    """Commands the guard blocked, modulo 65536 (0..65535)."""

    invalid_channels: int = ...
    """One bit a received cyclic message, in order of identifier: its channel is not VALID
    (0..65535)."""

    step_lateness_us: int = ...
    """How late this step ran against its due time, saturated (0..65535)."""

    cold_start: bool = ...
    """Started without a calibration of earlier runs."""

class ControllerEstimates(NamedTuple):
    """What the controller believes, with standard deviations.

    TransmissionControl -> Bench, every 10 ms.
    """

    estimate_time_us: int = ...
    """Sensor clock the estimates are valid for (0..4294967295)."""

    layshaft_angle_rad: float = ...
    """Layshaft angle modulo 256 turns; zero is rising edge 0 as the controller counts
    (0..1608.49544)."""

    layshaft_angle_sd_rad: float = ...
    """Standard deviation, saturated (0..0.571900763)."""

    layshaft_speed_rad_s: float = ...
    """Layshaft speed (-22488.3962..22488.3962)."""

    layshaft_speed_sd_rad_s: float = ...
    """Standard deviation, saturated (0..34.3140458)."""

    main_angle_rad: float = ...
    """Main shaft angle modulo 256 turns; zero is rising edge 0 as the controller counts
    (0..1608.49544)."""

    main_angle_sd_rad: float = ...
    """Standard deviation, saturated (0..0.571900763)."""

    main_speed_rad_s: float = ...
    """Main shaft speed (-22488.3962..22488.3962)."""

    main_speed_sd_rad_s: float = ...
    """Standard deviation, saturated (0..34.3140458)."""

    brake_pressure_pa: float = ...
    """Estimated absolute brake pressure (0..1310700)."""

    brake_pressure_sd_pa: float = ...
    """Standard deviation, saturated (0..1310700)."""

    slip_rad_s: float = ...
    """Target gear less sleeve (-22488.3962..22488.3962)."""

    phase_rad: float = ...
    """Target gear against sleeve, 0 where PhaseKnown is off (-374.806603..374.806603)."""

    phase_sd_rad: float = ...
    """Standard deviation, saturated (0..0.571900763)."""

    phase_known: bool = ...
    """The target gear's phase reference is known."""

    layshaft_valid: bool = ...
    """Layshaft estimate may be used."""

    main_valid: bool = ...
    """Main shaft estimate may be used."""

    model_valid: bool = ...
    """Clutch open and main box in neutral: the model of thesis 4.13 holds."""

class ShiftPrediction(NamedTuple):
    """The plan of a running shift, one a step from synchronising to firing.

    TransmissionControl -> Bench, on events.
    """

    decision_time_us: int = ...
    """Sensor clock of the decision (0..4294967295)."""

    decision: ShiftDecision = ...
    """What was decided."""

    release_time_us: int = ...
    """Planned activation of brake off (0..4294967295)."""

    fire_time_us: int = ...
    """Planned activation of the sleeve valve (0..4294967295)."""

    contact_time_us: int = ...
    """Predicted contact of sleeve and gear (0..4294967295)."""

    phase_rad: float = ...
    """Predicted phase at contact, 0 when the reference is unknown (-374.806603..374.806603)."""

    phase_sd_rad: float = ...
    """Standard deviation, saturated (0..0.571900763)."""

    slip_rad_s: float = ...
    """Predicted slip at contact (-22488.3962..22488.3962)."""

class ShiftOutcome(NamedTuple):
    """A finished shift: prediction against outcome.

    TransmissionControl -> Bench, on events.
    """

    from_gear: int = ...
    """Gear before (-1..14)."""

    to_gear: int = ...
    """Gear asked for (-1..14)."""

    strategy: Strategy = ...
    """Strategy that acted: the fallback while the reference is unknown."""

    reference: PhaseReference = ...
    """Whether the phase reference was known when the sleeve was fired."""

    engagement: Engagement = ...
    """Whose dog teeth attempts, times, phase and slip are of: the main gear's, or the splitter's
    where it alone was to change."""

    result: ShiftResult = ...
    """How it ended."""

    attempts: int = ...
    """Times a sleeve was fired (0..255)."""

    fault: FaultCode = ...
    """Why it failed."""

    request_time_us: int = ...
    """Sensor clock when the request was taken (0..4294967295)."""

    fire_time_us: int = ...
    """Activation of the last firing (0..4294967295)."""

    predicted_contact_time_us: int = ...
    """Predicted at the last firing (0..4294967295)."""

    measured_contact_time_us: int = ...
    """From the position sensor (0..4294967295)."""

    end_time_us: int = ...
    """Sensor clock when engagement was confirmed or given up (0..4294967295)."""

    predicted_phase_rad: float = ...
    """At contact; 0 when the reference is unknown (-374.806603..374.806603)."""

    predicted_phase_sd_rad: float = ...
    """Standard deviation, saturated (0..0.571900763)."""

    predicted_slip_rad_s: float = ...
    """At contact (-22488.3962..22488.3962)."""

    estimated_phase_rad: float = ...
    """At the measured contact time, estimated afterwards (-374.806603..374.806603)."""

    reference_source: ReferenceSource = ...
    """Where the reference came from when the sleeve was fired: measured in mesh, restored with the
    tooth numbers, or narrowed by other gears in mesh; where there is none: the gear has not been in
    mesh (none), or none of its measurements counted (unseen)."""

    aborts: int = ...
    """Times a sleeve on its way was stopped short of the teeth (0..255)."""

    halt_position_m: float = ...
    """Where the sleeve stood after the last abort, from neutral; 0 without one (-0.02..0.02)."""

class TC1(NamedTuple):
    """J1939-71 Transmission Control 1, PGN 256, to the transmission: the bench asks for a gear.

    Bench -> TransmissionControl, on events.
    """

    shift_inhibit_request: int | None = ...
    """SPN 681 (0..3 or None)."""

    converter_lockup_request: int | None = ...
    """SPN 682 (0..3 or None)."""

    disengage_driveline_request: int | None = ...
    """SPN 683 (0..3 or None)."""

    requested_clutch_slip_fraction: float | None = ...
    """SPN 684 (0..1 or None)."""

    requested_gear: int | None = ...
    """SPN 525, gear asked for: 0 neutral, 1..12, 13 and 14 the crawl gears (-125..125 or None)."""

class BenchCommand(NamedTuple):
    """Bench to rig; never sent in a vehicle.

    Bench -> GearboxIo, every 20 ms.
    """

    action: BenchAction = ...
    """ReturnToGear: scripted ramp back to a gear, as the thesis re-initialises between shifts."""

    gear: int = ...
    """The gear to return to (0..14)."""

    sequence: int = ...
    """A new number starts the action once; repeats of the same number do nothing (0..65535)."""

    main_speed_rad_s: float = ...
    """Main shaft speed to hold (0..523.598776)."""

class BenchFault(NamedTuple):
    """Bench to rig: inject a fault; never sent in a vehicle.

    Bench -> GearboxIo, on events.
    """

    fault: RigFault = ...
    """What goes wrong; NoFault ends all faults."""

    target: int = ...
    """Which channel, valve, shaft or sleeve, as listed by meshpoint rig --describe (0..255)."""

    sequence: int = ...
    """A new number injects once; repeats of the same number do nothing (0..65535)."""

    duration_us: int = ...
    """How long; 0 is until further notice (0..4294967295)."""

    value: float = ...
    """How much, in the fault's own unit (-2147483.65..2147483.65)."""

Message: TypeAlias = (
    EdgesInputRise
    | EdgesInputFall
    | EdgesLayshaftRise
    | EdgesLayshaftFall
    | EdgesMainRise
    | EdgesMainFall
    | EdgesPropellerRise
    | EdgesPropellerFall
    | GearboxSensors
    | SleevesMain
    | SleevesAux
    | ValveStatus
    | EEC1
    | ReferenceEncoder
    | ReferencePhase
    | ReferenceEngagement
    | ValveCommand
    | ClutchCommand
    | TSC1
    | ETC1
    | ETC2
    | ControllerStatus
    | ControllerEstimates
    | ShiftPrediction
    | ShiftOutcome
    | TC1
    | BenchCommand
    | BenchFault
)

MESSAGE_TYPES: Final[dict[str, type[Message]]]
