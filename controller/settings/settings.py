"""Settings of the controller: one frozen dataclass a group, read from TOML, checked on read."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

from meshpoint.controller.settings.filters import (
    CrossingFilterTuning,
    CruiseFilterTuning,
    ThesisFilterTuning,
)
from meshpoint.controller.settings.strategy_file import StrategyFile
from meshpoint.dbc.messages import Estimator, Strategy
from meshpoint.dbc.sensor_time import READ_CYCLE_US
from meshpoint.gearbox.tables import (
    TableError,
    count,
    flag,
    group,
    load_toml,
    quantity,
    read_group,
    text,
)
from meshpoint.units import RPM

MS_IN_US: Final = 1000

STRATEGY_NAMES: Final = {value.name.lower(): value for value in Strategy}
"""The strategies of the DBC's value table; `plan/strategist` has the class of each."""
ESTIMATOR_NAMES: Final = {
    value.name.lower(): value for value in (Estimator.WINDOW, Estimator.THESIS, Estimator.CROSSING)
}


class ValveTiming(StrEnum):
    """How a valve is switched at a time between two ticks."""

    SCHEDULED = "scheduled"
    IMMEDIATE = "immediate"


@dataclass(frozen=True)
class Timing:
    """The tick and the margins around it."""

    tick_ms: int = count("tick_ms", 1, 100, default=10)
    """From one step to the next."""
    lead_ms: int = count("lead_ms", 1, 80, default=4)
    """How far ahead of the controller's notion of sensor time an activation is placed at least:
    bus time and the node's own lateness must fit into it."""
    wire_us: int = count("wire_us", 0, 5000, default=900)
    """Hardware that cannot schedule: the least time from a read to its frame's arrival and from a
    command to its valve, which the switch is sent ahead by."""

    @property
    def tick_us(self) -> int:
        """Time between two steps."""
        return self.tick_ms * MS_IN_US

    @property
    def measured_us(self) -> int:
        """Time between two steps of which each knows more than the one before."""
        return max(self.tick_us, READ_CYCLE_US)

    @property
    def lead_us(self) -> int:
        """The least lead of an activation."""
        return self.lead_ms * MS_IN_US


@dataclass(frozen=True)
class Window:
    """Slip at which a sleeve may meet its gear; slip > 0: the gear turns faster than the
    sleeve."""

    fire_slip_rad_s: float = quantity("fire_slip_rpm", 1.0, 200.0, RPM, default=50.0 * RPM)
    """`speed_window` fires when the slip has fallen to this."""
    contact_high_rad_s: float = quantity("contact_high_rpm", 1.0, 200.0, RPM, default=25.0 * RPM)
    """`target_phase` plans no contact above this slip."""
    contact_low_rad_s: float = quantity("contact_low_rpm", -50.0, 100.0, RPM, default=-40.0 * RPM)
    """`target_phase` plans no contact below this slip: there the gear is slower than the
    sleeve, and gets slower yet."""
    release_slip_rad_s: float = quantity("release_slip_rpm", 1.0, 200.0, RPM, default=25.0 * RPM)
    """`speed_window` releases the brake so that this slip is left when it has died away."""
    anticipate_slip_rad_s: float = quantity(
        "anticipate_slip_rpm", 1.0, 200.0, RPM, default=25.0 * RPM
    )
    """`speed_window_anticipating` fires ahead so that contact is at this slip."""
    anticipate_release_rad_s: float = quantity(
        "anticipate_release_rpm", 1.0, 200.0, RPM, default=10.0 * RPM
    )
    """`speed_window_anticipating` releases the brake so that this slip would be left when it
    has died away. Both baselines' releases are those of their least mean duration
    (`benchmarks/tune_baselines.py`)."""
    settle_time_constants: float = quantity("settle_time_constants", 0.0, 10.0, default=3.0)
    """When the brake counts as died away, in time constants of its pressure after release."""
    aim_slip_rad_s: float = quantity("aim_slip_rpm", 1.0, 200.0, RPM, default=18.0 * RPM)
    """`target_phase` releases the brake so that at this slip the phase is the target; an engine
    that raises a gear leaves this slip for the first contact that can be made."""
    aim_time_constants: float = quantity("aim_time_constants", 0.0, 10.0, default=0.9)
    """Time from the brake's release to about where the slip is `aim_slip_rpm`, in time constants of
    the brake's pressure."""
    least_rad_s: float = quantity("least_rpm", -200.0, 50.0, RPM, default=-50.0 * RPM)
    """Below this slip the engine has to help: waiting is no use, the layshaft only gets slower."""

    def __post_init__(self) -> None:
        if self.contact_low_rad_s >= self.contact_high_rad_s:
            raise TableError("contact_low_rpm must be less than contact_high_rpm")


@dataclass(frozen=True)
class Aim:
    """Where in the gap a tooth should meet the sleeve."""

    target_rad_share: float = quantity("target_percent_of_gap", -90.0, 90.0, 0.01, default=0.0)
    """Target angle as a signed share of half a gap; 0: its middle."""

    def target_rad(self, backlash_rad: float) -> float:
        """The target angle in a gap of this width."""
        return self.target_rad_share * (backlash_rad / 2.0)


@dataclass(frozen=True)
class Prices:
    """The cost of a contact besides the time until it, in milliseconds (docs/strategy.md)."""

    miss_s: float = quantity("miss_ms", 0.0, 10_000.0, 1e-3, default=0.6)
    """Tooth on tooth, or bounced off by a flank: waiting for the next gap, going back for another
    attempt, and the wear."""
    block_s: float = quantity("block_ms", 0.0, 10_000.0, 1e-3, default=0.2)
    """Added to a miss if the slip is too small to carry the tooth to a gap, so that the sleeve is
    blocked."""
    block_slip_rad_s: float = quantity("block_slip_rpm", 0.1, 100.0, RPM, default=6.0 * RPM)
    """The slip below which a tooth may block the sleeve."""
    energy_s_per_j: float = quantity("energy_ms_per_j", 0.0, 10_000.0, 1e-3, default=0.02)
    """Cost of a joule of impact energy at a tooth's flank."""
    aim_s: float = quantity("aim_ms", 0.0, 10_000.0, 1e-3, default=0.01)
    """A contact half a backlash away from the target angle."""


@dataclass(frozen=True)
class ShiftLimits:
    """When a part of the shift has taken too long, and how often it is tried."""

    clutch_ms: int = count("clutch_ms", 50, 5000, default=600)
    """For the clutch to open, and to close."""
    disengage_ms: int = count("disengage_ms", 50, 5000, default=400)
    """For the old gear to come out."""
    synchronise_ms: int = count("synchronise_ms", 100, 10000, default=2000)
    """For the brake to bring the layshaft down to the new gear's speed."""
    engage_ms: int = count("engage_ms", 100, 5000, default=500)
    """From firing until the sleeve is in its gear."""
    face_ms: int = count("face_ms", 20, 2000, default=200)
    """A sleeve that rests on a tooth for longer, also since the brake has last moved that on, goes
    back and tries another one."""
    coast_ms: int = count("coast_ms", 20, 2000, default=250)
    """Where drag alone would take longer than this to bring the slip down, the brake helps."""
    raise_ms: int = count("raise_ms", 200, 10000, default=2000)
    """For the engine to bring the layshaft up to the new gear's speed."""
    steps_ms: int = count("steps_ms", 200, 10000, default=1500)
    """For splitter and range to change, both together."""
    attempts: int = count("attempts", 1, 10, default=3)
    """How often a sleeve is fired in one shift."""
    raises: int = count("raises", 0, 10, default=3)
    """How often the engine is asked to bring the layshaft up in one shift."""
    pulses: int = count("pulses", 0, 10, default=3)
    """How often the brake is used in one shift, and again after each time that the engine has
    raised the gear."""
    blocks: int = count("blocks", 1, 100, default=8)
    """A shift ends when the guard has blocked its commands this often, counted once a read."""
    supply_low_pa: float = quantity("supply_low_bar", 0.0, 12.0, 1e5, default=5.5e5)
    """Below this supply pressure (absolute) no shift is begun."""
    valve_on_ms: int = count("valve_on_ms", 100, 10000, default=3000)
    """The longest time for which the guard lets a valve be on."""


@dataclass(frozen=True)
class EngineRequests:
    """What the engine may be asked for (TSC1)."""

    least_rad_s: float = quantity("least_rpm", 100.0, 2000.0, RPM, default=500.0 * RPM)
    """The engine is asked for no speed below this one."""
    ramp_ms: int = count("ramp_ms", 0, 2000, default=250)
    """The longest wait for the engine's torque to fall before the clutch sets off; 0: it sets off
    at once, under torque, and the driveline rings."""
    swing_ramp_ms: int = count("swing_ramp_ms", 0, 4000, default=2000)
    """The longest ramp that leaves a driveline at rest, where it has been seen to ring; 0: the
    torque is taken away at once there too."""
    torque_left_share: float = quantity("torque_left_percent", 0.5, 100.0, 0.01, default=0.05)
    """So much of the engine's reference torque may be left when the clutch's plates part."""


SPEEDS_RAD_S: Final = 10.0 * RPM
"""Error of a slip by two measured speeds."""


@dataclass(frozen=True)
class GuardSettings:
    """Limits of the guard: wider than any strategy plans, narrower than what does damage."""

    slip_low_rad_s: float = quantity("slip_low_rpm", -300.0, 0.0, RPM, default=-60.0 * RPM)
    """No sleeve is driven to a contact below this slip."""
    slip_high_rad_s: float = quantity("slip_high_rpm", 10.0, 300.0, RPM, default=120.0 * RPM)
    """No sleeve is driven to a contact above this slip."""
    brake_on_ms: int = count("brake_on_ms", 100, 20000, default=2500)
    """The longest use of the brake."""
    brake_energy_j: float = quantity("brake_energy_kj", 0.1, 1000.0, 1e3, default=15e3)
    """The most energy of one use of the brake."""
    brake_floor_rad_s: float = quantity("brake_floor_rpm", 0.0, 1000.0, RPM, default=100.0 * RPM)
    """The brake never takes the layshaft below this speed."""
    before_teeth_ms: int = count("before_teeth_ms", 100, 10000, default=500)
    """For so long a main sleeve may stand between neutral and a gear's teeth, held by its friction
    alone: time for several gaps to pass, and little for the road to shake it on. Then it may only
    go back."""
    supply_low_pa: float = quantity("supply_low_bar", 0.0, 12.0, 1e5, default=5.0e5)
    """Absolute pressure below which nothing new is actuated."""
    torque_factor: float = quantity("torque_factor", 1.0, 3.0, default=1.4)
    """The brake's torque over that of its data sheet, at most."""
    drag_torque_nm: float = quantity("drag_torque_nm", 0.0, 200.0, default=15.0)
    """Drag at the layshaft beyond the sheet's friction, at most."""

    def is_outside(self, slip_rad_s: float) -> bool:
        """Whether a contact at this slip was outside the window, by more than two measured speeds
        may be wrong by."""
        least_rad_s = self.slip_low_rad_s - SPEEDS_RAD_S
        most_rad_s = self.slip_high_rad_s + SPEEDS_RAD_S
        return not least_rad_s <= slip_rad_s <= most_rad_s

    def may_be_outside(self, measured_rad_s: float) -> bool:
        """Whether one measured at this slip may have been: two speeds hide as much as they add."""
        return not self.slip_low_rad_s <= measured_rad_s <= self.slip_high_rad_s


@dataclass(frozen=True)
class ControllerSettings:
    """All settings of a controller."""

    strategy_name: str = text("strategy", *STRATEGY_NAMES, default="target_phase")
    """How a sleeve is fired: `speed_window`, once the slip has fallen to its window, as is done
    today; `speed_window_anticipating`, ahead, so that the slip is small at contact;
    `target_phase`, so that tooth meets gap."""
    estimator_name: str = text("estimator", *ESTIMATOR_NAMES, default="crossing")
    """How the layshaft's angle and speed are estimated: `window`, the 10 ms window speed of
    today; `thesis`, its Kalman filter; `crossing`, a filter on the time of each edge."""
    valve_timing: str = text("valve_timing", *ValveTiming, default="scheduled")
    """`scheduled`: the valve side switches at the time in the command; `immediate`: hardware
    that cannot schedule, so the controller sends the command at its moment."""
    timing: Timing = group(Timing, default=Timing())
    window: Window = group(Window, default=Window())
    aim: Aim = group(Aim, default=Aim())
    prices: Prices = group(Prices, default=Prices())
    limits: ShiftLimits = group(ShiftLimits, default=ShiftLimits())
    engine: EngineRequests = group(EngineRequests, default=EngineRequests())
    guard: GuardSettings = group(GuardSettings, default=GuardSettings())
    thesis_filter: ThesisFilterTuning = group(ThesisFilterTuning, default=ThesisFilterTuning())
    cruise_filter: CruiseFilterTuning = group(CruiseFilterTuning, default=CruiseFilterTuning())
    crossing_filter: CrossingFilterTuning = group(
        CrossingFilterTuning, default=CrossingFilterTuning()
    )
    strategy_file: StrategyFile | None = None
    """A user's own strategy, which `strategy_name` names then; in no settings file."""

    def __post_init__(self) -> None:
        if self.window.fire_slip_rad_s > self.guard.slip_high_rad_s:
            raise TableError("window.fire_slip_rpm must not exceed guard.slip_high_rpm")
        if self.window.least_rad_s < self.guard.slip_low_rad_s:
            raise TableError("window.least_rpm must not be below guard.slip_low_rpm")

    @property
    def strategy(self) -> Strategy:
        """The engagement strategy asked for, as its DBC value."""
        if self.strategy_file is not None:
            return self.strategy_file.wire
        return STRATEGY_NAMES[self.strategy_name]

    def name_of(self, strategy: Strategy) -> str:
        """The name of a strategy that acted under these settings, by its value on the bus."""
        return self.strategy_name if strategy is self.strategy else strategy.name.lower()

    def with_strategy(self, name: str, file: StrategyFile | None = None) -> ControllerSettings:
        """The same with another strategy; `file` for a user's own."""
        return dataclasses.replace(self, strategy_name=name, strategy_file=file)

    def values(self) -> dict[str, Any]:
        """All of them by attribute (SI), without the text of a user's strategy and without what
        is the data sheet's."""
        kept = dataclasses.replace(self, strategy_file=None)
        return dataclasses.asdict(
            kept, dict_factory=lambda all_: {k: v for k, v in all_ if k not in NO_KEYS}
        )

    @property
    def estimator(self) -> Estimator:
        """The layshaft estimator asked for."""
        return ESTIMATOR_NAMES[self.estimator_name]


NO_KEYS: Final = frozenset(
    field.name
    for group_of in (ControllerSettings, CrossingFilterTuning)
    for field in dataclasses.fields(group_of)
    if not field.metadata
)
"""Fields that no settings file has: a user's strategy, and what the data sheet says."""


@dataclass(frozen=True)
class Outputs:
    """Whether the outputs are armed: whether valves, clutch and engine may be commanded at all."""

    armed: bool | None = flag("armed", default=None)
    """False: the controller reads, estimates and logs, and commands nothing. Where it is not
    given, only the local bus of this machine is armed; `--arm` and `--no-arm` win."""


@dataclass(frozen=True)
class SettingsFile(ControllerSettings):
    """What a settings file may hold: the settings, and `[outputs]`, which belongs to one run on one
    bus and therefore goes into the run header by itself."""

    outputs: Outputs = group(Outputs, default=Outputs())

    @property
    def settings(self) -> ControllerSettings:
        """The settings alone."""
        names = [field.name for field in dataclasses.fields(ControllerSettings)]
        return ControllerSettings(**{name: getattr(self, name) for name in names})


def load_settings_file(path: Path | None) -> SettingsFile:
    """A settings file, TOML, or the defaults. TableError names file, key, found and allowed."""
    return SettingsFile() if path is None else read_group(SettingsFile, load_toml(path), path.name)


def load_settings(path: Path | None, **overrides: Any) -> ControllerSettings:
    """Settings from a TOML file, or the defaults; overrides that are not None win.

    TableError names file, key, found and allowed."""
    given = {key: value for key, value in overrides.items() if value is not None}
    return dataclasses.replace(load_settings_file(path).settings, **given)


def splitter_ms(settings: ControllerSettings) -> int:
    """How long a change of a splitter with dog teeth may take, ms."""
    limits = settings.limits
    return limits.steps_ms + limits.raise_ms + limits.synchronise_ms
