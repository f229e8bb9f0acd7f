"""The interface between the rig's node and the gearbox of a preset (`presets.build_world`)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple, Protocol

from meshpoint.gearbox.gears import MainGear, Sleeve
from meshpoint.rig_sim.orders import EngineRequest, FaultOrder
from meshpoint.rig_sim.shared.angles import Angle
from meshpoint.rig_sim.shared.edge_ring import EdgeRead
from meshpoint.rig_sim.shared.engagement import Engaged, Violation
from meshpoint.rig_sim.shared.node_state import NodeState
from meshpoint.rig_sim.shared.rotation import Drive
from meshpoint.rig_sim.shared.sensor_clock import SensorClock
from meshpoint.rig_sim.shared.sleeves import SleeveState
from meshpoint.rig_sim.shared.valve_drivers import Order, ValveBank

READ_US: Final = 10_000
"""The sensors are read, and their frames sent, once in this time."""


class SensorRead(NamedTuple):
    """The slow sensors at a read: absolute pressures Pa, oil K, clutch 0..1, engine."""

    brake_pa: float
    supply_pa: float
    oil_k: float
    clutch: float
    engine_rad_s: float
    torque_share: float | None = None
    """Engine torque as a share of its highest; None in a preset without an engine."""


class EncoderRead(NamedTuple):
    """Layshaft angles (rad, modulo 256 turns) and speeds (rad/s), the newest first."""

    angle_rad: tuple[float, ...]
    speed_rad_s: tuple[float, ...]


class PhaseRead(NamedTuple):
    """The truth that is on the bus beside the encoder: the main shaft's wheel and its speed, and
    each gear's phase against its sleeve in the order of `MAIN_GEARS`, rad."""

    main_angle: Angle
    main_rad_s: float
    phases_rad: tuple[float, ...]


class Vehicle(NamedTuple):
    """The vehicle behind the propeller shaft."""

    road_m_s: float
    """Its speed, and that of the treads of wheels that only roll."""
    driven_m_s: float
    """That of the driven wheels' treads: another one where tyres twist and slip."""
    wheel_m: float
    """How far it goes with a radian of the propeller shaft."""


class Truth(Protocol):
    """The true state of the rig, for tests in the same process. Reading it has no side effects."""

    @property
    def time_us(self) -> float:
        """Time since power-up of everything else here."""

    @property
    def clock_start_us(self) -> int:
        """Sensor clock at power-up."""

    @property
    def angles(self) -> tuple[Angle, Angle, Angle, Angle]:
        """Sensor wheels of input, layshaft, main and propeller shaft."""

    @property
    def speeds_rad_s(self) -> tuple[float, float, float, float]:
        """Speeds of input, layshaft, main and propeller shaft."""

    @property
    def road_speed_m_s(self) -> float:
        """Speed of the vehicle; 0 where there is none."""

    @property
    def vehicle(self) -> Vehicle | None:
        """The vehicle; None where there is none."""

    def phase_rad(self, gear: MainGear) -> float:
        """Phase of a gear against its sleeve."""

    def slip_rad_s(self, gear: MainGear) -> float:
        """Speed of a gear less that of its sleeve."""

    @property
    def locked_gear(self) -> MainGear:
        """The main-box gear whose teeth are in mesh and locked, or neutral."""

    @property
    def drive(self) -> Drive:
        """What moves the layshaft."""

    @property
    def brake_gauge_pa(self) -> float:
        """Gauge pressure at the brake."""

    def delay_s(self, gear: MainGear) -> tuple[float, float]:
        """From a sleeve valve's activation now to contact: mean and standard deviation."""

    @property
    def brake_valve_delay_s(self) -> float:
        """From the brake valve's activation to the first change of pressure."""

    def sleeve_state(self, sleeve: Sleeve) -> SleeveState:
        """State of one of the two main sleeves. KeyError for splitter and range."""

    @property
    def script(self) -> Any:
        """Where the bench script stands."""

    @property
    def violations(self) -> Mapping[Violation, int]:
        """How often each of the forbidden things has happened."""


class RigWorld(Protocol):
    """A gearbox in its own time, microseconds since power-up. Commands act at the instant given,
    to which the world has been run."""

    clock: SensorClock
    valves: ValveBank
    node: NodeState

    @property
    def next_read_us(self) -> int:
        """When the sensors are read next."""

    @property
    def truth(self) -> Truth:
        """The state, for tests."""

    @property
    def as_built(self) -> dict[str, Any] | None:
        """What was drawn for this gearbox, for the run's output; None: it is as its sheet says."""

    def change_conditions(self, values: Mapping[str, float]) -> None:
        """Other oil, load, slope or supply from now on, by their as-built names. SettingsError
        where the preset has no such thing."""

    def run_to(self, until_us: int) -> bool:
        """Go on to this instant, or to the next 10 ms read if that comes first: then True."""

    def command_valves(self, orders: tuple[Order, ...], now_us: int) -> None:
        """A valid valve command, consumed now."""

    def renew_valves(self, now_us: int) -> bool:
        """The same valve command again; False where it may do more than renew."""

    def all_valves_off(self, now_us: int) -> None:
        """Shutdown: no valve is driven from now on."""

    def command_clutch(self, close: bool, now_us: int) -> None:
        """A valid clutch command, consumed now."""

    def command_engine(self, request: EngineRequest, now_us: int) -> None:
        """A TSC1 frame, consumed now."""

    def return_to_gear(self, gear_number: int, main_rad_s: float, now_us: int) -> None:
        """The bench asks for the script."""

    def inject(self, order: FaultOrder, now_us: int) -> None:
        """The bench asks for a fault."""

    def edge_reads(self, now_us: int) -> list[EdgeRead]:
        """The read of all edge channels now, in the order of the wire contract."""

    def sensors(self, now_us: int) -> SensorRead:
        """The slow sensors now."""

    def sleeve_samples_m(self, name: Sleeve, now_us: int) -> tuple[float, ...]:
        """Ten positions, 1 ms apart, the newest first."""

    def encoder_read(self, now_us: int) -> EncoderRead:
        """The reference encoder now."""

    def phase_read(self) -> PhaseRead:
        """Main shaft and phases now."""

    def take_engaged(self) -> list[Engaged]:
        """What has happened between sleeves and gears since the last call."""

    def take_lines(self) -> list[tuple[float, str]]:
        """Lines for the log since the last call, with their times."""
