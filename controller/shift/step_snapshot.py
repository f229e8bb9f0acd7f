"""What the shift sequence sees at one step, and what it makes of it over several.

Over several steps: whether the driveline rings once a gear is out (shafts and tyres that twist, or
rigid ones), and how far the engine's torque has fallen by what the engine says (EEC1), what will be
left, and how the engine changes its speed meanwhile.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from meshpoint.controller.estimate.loaded_driveline import LoadedDriveline
from meshpoint.controller.estimate.observer import LayshaftTracker
from meshpoint.controller.measure.gearbox_view import GearboxView
from meshpoint.controller.measure.inputs import ShaftSpeeds
from meshpoint.controller.models.swing import ShaftState
from meshpoint.controller.plan.strategy import BUS_US
from meshpoint.controller.settings.valve_name import Driven
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.dbc.messages import FaultCode
from meshpoint.gearbox import GearboxSheet, MainGear
from meshpoint.kernels.records import Vector
from meshpoint.units import SECOND_US, US

MISSING: Final = (FaultCode.SPEED_STALE, FaultCode.POSITION_STALE, FaultCode.VALVE_LINK_LOST)
"""Inputs that a shift needs and that are not there."""
WHEEL_FAULTS: Final = (
    FaultCode.INPUT_WHEEL_WRONG,
    FaultCode.LAYSHAFT_WHEEL_WRONG,
    FaultCode.MAIN_WHEEL_WRONG,
    FaultCode.PROPELLER_WHEEL_WRONG,
)
"""By the number of the shaft whose speed wheel reads wrong."""

RINGS_RAD_S: Final = 0.25
"""Standard deviation of the main shaft's speed about a straight line above which it rings (2.4 rpm,
7 rpm from peak to peak): that moves a gear's tooth against its sleeve by half a gap within 45 ms.
"""
BEYOND_NOISE: Final = 3.0
"""Its variance about that line above which it is no noise of the sensor, as a multiple of the
noise's. White noise alone comes so far 3 times in 100 in 15 reads, 17 times in 6 (4,000 draws)."""
THIRD_SQUARE: Final = 20.0
"""A third difference of white noise has this many times its variance: 1 + 9 + 9 + 1."""
LEAST_MEASUREMENTS: Final = 6
"""Measurements, one a read of the sensors, from which a line can be distinguished from a swing."""
FREE_STATES: Final = frozenset({State.SYNCHRONISING, State.COASTING})

MEASUREMENTS: Final = 6
"""The engine's acceleration is that of its last 50 ms."""
LONGEST_GAP_US: Final = 25_000
"""Over a longer pause in what the engine says nobody knows what it did."""


@dataclass(frozen=True)
class StepSnapshot:
    """The inputs of the shift sequence at one step. Times are in us of the sensor clock."""

    now_us: int
    earliest_us: int
    """The earliest activation time that a command sent now can still meet."""
    view: GearboxView
    layshaft: LayshaftTracker
    main_at: Callable[[float], ShaftState | None]
    """The main shaft at a sensor time."""
    speeds: ShaftSpeeds
    lost: FaultCode
    """The input that a shift needs and that is missing (`MISSING`) or contradicted (`WHEEL_FAULTS`,
    or WHEELS_DISAGREE where it may be one of several); NONE if all are there."""
    driven: Driven
    """Of each valve, whether the valve side reports it driven, or its activation pending."""
    supply_pa: float
    """Absolute supply pressure; infinite before the first frame."""
    engine_rad_s: float | None = None
    """The engine's speed in this step's newest frame; None without one."""
    engine_torque_share: float | None = None
    """Its torque there, as a share of its reference torque; None without one."""
    engine_torque_step: float = 0.01
    """The step in which that torque is reported."""
    is_self_tested: bool = True
    """Whether the guard's self-test is passed: before that it lets no valve be driven."""
    more_lead_us: int = 0
    """By how much more than set an activation is sent ahead, since one was refused."""
    brake_delays_us: tuple[int, int] | None = None
    """From the brake valve's switch off, and on, to the pressure's first reaction, as learned;
    None: as before."""
    takes_in: bool = True
    """Whether frames were taken in and a decision was made: not by a step between ticks that sends
    the end of a valve's pulse."""
    loaded: LoadedDriveline | None = None
    """The driveline with a gear in mesh; None: nobody follows it."""

    @cached_property
    def main(self) -> ShaftState | None:
        """The main shaft now; worked out where a state asks for it, which most do not."""
        return self.main_at(self.now_us)

    @property
    def at_once_us(self) -> int:
        """When a valve can be switched against a sleeve's motion, which waits for no lead."""
        return self.now_us + BUS_US + self.more_lead_us


class RingingDetector:
    """Learned from the main shaft's speed in neutral, from when the old gear is out until the
    sleeve is fired for the new one.

    A swing is slow against the reads, noise differs from read to read. So third differences, in
    which a swing of less than 20 Hz nearly vanishes, tell how large noise is (von Neumann 1941),
    and what the speed scatters about a straight line beyond that is swing. Both are summed over
    all shifts.
    """

    def __init__(self, sheet: GearboxSheet) -> None:
        self.twists = False
        """Whether shafts between engine and road are known to twist: seen to ring, and by how much
        the sheet says. What once did twists for good."""
        self.is_beyond_noise = False
        """Whether they have rung by more than the sensor's noise explains: for good, too."""
        self._is_told = sheet.driveline.stiffness_nm_rad > 0.0
        self._measurements: list[tuple[int, float]] = []
        self._about_line, self._noise = np.zeros(2), np.zeros(2)
        """Sum of squares (rad2/s2), and how many they are of."""

    def measure(self, state: State, snapshot: StepSnapshot) -> None:
        """One step: one without a new speed shows nothing."""
        main = snapshot.speeds.main
        is_free = state in FREE_STATES and snapshot.view.main_gear is MainGear.NEUTRAL
        if is_free and main is not None:
            if not self._measurements or main != self._measurements[-1][1]:
                self._measurements.append((snapshot.now_us, main))
            return
        if len(self._measurements) >= LEAST_MEASUREMENTS and not self.is_beyond_noise:
            self._look(*np.array(self._measurements).T)
        self._measurements.clear()

    def _look(self, time_us: Vector, speed: Vector) -> None:
        """A shift's measurements."""
        time_s = US * (time_us - time_us[0])
        line = np.column_stack((np.ones_like(time_s), time_s))
        _, squares, _, _ = np.linalg.lstsq(line, speed, rcond=None)
        now = np.array([squares.sum(), len(speed) - line.shape[1]])
        self._about_line += now
        third = np.diff(speed, 3)
        self._noise += float(third @ third) / THIRD_SQUARE, len(third)
        self.twists |= self._is_told and bool(now[0] / now[1] > RINGS_RAD_S**2)
        about_line, noise = (sums[0] / sums[1] for sums in (self._about_line, self._noise))
        self.is_beyond_noise = self.twists and bool(about_line > BEYOND_NOISE * noise)


class TorqueDecay:
    """The engine's torque as it says it to be, and what will be left of it."""

    def __init__(self) -> None:
        self._newest: tuple[int, float] | None = None
        self._before: tuple[int, float] | None = None
        self.step = 0.01
        """The engine says it in steps of this share of its reference torque."""
        self._speeds: deque[tuple[int, float]] = deque(maxlen=MEASUREMENTS)

    def take(
        self, now_us: int, share: float | None, step: float = 0.01, speed_rad_s: float | None = None
    ) -> None:
        """One step's torque, as a share of the engine's reference torque, None: nothing new; and in
        which steps it is said; and the engine's speed."""
        if speed_rad_s is not None:
            if self._speeds and now_us - self._speeds[-1][0] > LONGEST_GAP_US:
                self._speeds.clear()
            self._speeds.append((now_us, speed_rad_s))
        if share is not None:
            self._before, self._newest, self.step = self._newest, (now_us, share), step

    @property
    def engine_rad_s2(self) -> float:
        """The engine's acceleration; 0 before it was seen for long enough."""
        if len(self._speeds) < MEASUREMENTS:
            return 0.0
        (first_us, first), (last_us, last) = self._speeds[0], self._speeds[-1]
        return (last - first) / max(1, last_us - first_us) * SECOND_US

    @property
    def share(self) -> float | None:
        """The newest torque; None where the engine says none."""
        return None if self._newest is None else self._newest[1]

    def left_in(self, ahead_s: float) -> float | None:
        """The torque after so long, falling toward zero exponentially as it does now; None where
        the engine says none."""
        if self._newest is None:
            return None
        now_us, share = self._newest
        if self._before is None or share == 0.0:
            return share
        before_us, before = self._before
        if now_us <= before_us or share * before <= 0.0 or abs(share) >= abs(before):
            return share
        rate = math.log(share / before) / ((now_us - before_us) / SECOND_US)
        return share * math.exp(rate * ahead_s)
