"""The guard's inputs, taken directly from the raw frames of each step.

Nothing here comes from the observer, the codec or the receiver: the guard has its own ear
(`listening`), clock (`own_clock`) and speeds (`own_speed`). Positions and pressures are the newest
samples. A gear that is in mesh although the position sensors show no sleeve at its teeth is
recognised by the shafts' turns (row 13). A speed wheel that the others deny (`shafts_in_mesh`) has
no speed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Final, NamedTuple

from meshpoint.controller.guard.held_gear import HeldGear, Shaft, gear_angle_rad
from meshpoint.controller.guard.limits import GuardLimits, end_of
from meshpoint.controller.guard.listening import (
    EDGES,
    LAYSHAFT_EDGES,
    MAIN_EDGES,
    NEEDED,
    SENSORS,
    SLEEVES_AUX,
    SLEEVES_MAIN,
    Engine,
    GuardReceiver,
)
from meshpoint.controller.guard.own_clock import GuardClock, signed_us
from meshpoint.controller.guard.own_speed import GuardSpeed, ShaftSpeed, TeethCounted
from meshpoint.controller.guard.shafts_in_mesh import ShaftsInMesh
from meshpoint.controller.guard.swing import Swing, SwingMemory
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox import GearboxSheet
from meshpoint.units import TURN

GUARD_FRESH_US: Final = 40_000
"""Samples older than this count as lost, even if the counters of their frames are valid. With the
tick that notices it, within 50 ms."""
AGREE_US: Final = 100_000
"""Turns of gear and sleeve are compared over two consecutive intervals of this length."""
AGREE_RAD_S: Final = 0.15
"""If the mean slip is below this (1.4 rpm) in both intervals, gear and sleeve turn as one."""
TURNING_RAD_S: Final = 10.0
"""Below this layshaft speed the ratios of the gears cannot be distinguished."""
CLUTCH_GAP_US: Final = 25_000
"""Samples of the clutch further apart say nothing of its speed."""
READ_CYCLE_US: Final = 10_000
"""From one read of the wheels to the next."""
NO_ENGINE: Final = Engine(None, None)
BothCounted = tuple[TeethCounted, TeethCounted]
"""Layshaft and main shaft."""


class GuardInputs(NamedTuple):
    """The inputs of one step, SI. Speeds: input shaft, layshaft, main shaft, propeller shaft; None
    if stale or invalid."""

    now_us: int
    positions_m: tuple[float, float, float, float]
    """First/second, crawl/third, splitter, range."""
    clutch_closed: float
    supply_pa: float
    brake_pa: float
    speeds: tuple[ShaftSpeed | None, ShaftSpeed | None, ShaftSpeed | None, ShaftSpeed | None]
    agreeing: int
    """Number of the main valve whose gear turns with its sleeve although both sleeves are measured
    apart from all teeth, or did so and has not turned free since; 0 if there is none."""
    valid: bool
    """Positions, clutch, pressures and the valve side's own status come from channels that the
    guard believes and are recent, and no sensor reports itself out of range."""
    engine_rad_s: float | None = None
    """The engine's speed; None where it says none any more."""
    requested_gear: int | None = None
    """The gear asked for in this step; None where none was."""
    clock_error_us: int = 0
    """The clock that the commands are timed by, less the guard's own."""
    positions_us: int = 0
    """When the positions of the main sleeves were sampled."""
    speeds_m_s: tuple[float, ...] = (0.0, 0.0)
    """Of the two main sleeves, and of a splitter's with dog teeth, over their newest samples."""
    clutch_us: int = 0
    """When the clutch's position was sampled."""
    engine_torque_share: float | None = None
    """The engine's torque, as a share of its reference torque; None where it says none any more."""
    clutch_per_s: float = 0.0
    """How fast the clutch closes; negative: opens."""
    clock_gained_us: int = 0
    """How much the guard's sensor clock has gained on the controller's in this step, or by how much
    a message is less late than the one before it, whichever is more: frames that come faster than
    they were sent have waited, and those to come are younger still."""
    clock_is_new: bool = False
    """Whether the sensors' clock is another since this step."""
    has_heard: bool = True
    """Whether a frame that the guard believes has come since the step before."""
    in_doubt: tuple[int, ...] = ()
    """Shafts whose speed wheels are denied by those they are in mesh with, 0 input to 3 propeller;
    their speeds count as unknown."""
    swings: tuple[Swing | None, ...] = (None, None)
    """How the speeds of layshaft and main shaft change and have changed, and of an input shaft that
    a splitter with dog teeth leaves to itself; None where not known."""
    means_m_s: tuple[float, ...] = (0.0, 0.0)
    """Of the same sleeves, over all samples of a frame: with less noise, and later."""
    gear_rad: float | None = None
    """Angle of the gear that a main sleeve is measured in against that sleeve, from anywhere; None
    where none is, or a wheel's teeth are not known."""
    gear_is_wrong: bool = False
    """Whether the counts of all wheels say that this gear is not in."""


def _read_by_all(reads_us: list[int]) -> int | None:
    """The newest read of which all wheels were heard. A step between the frames of a read has heard
    some of it, and of the others the one before: counts of two reads compare only while no shaft
    gains speed. A wheel of which a frame was lost is not waited for."""
    newest_us = max(reads_us, default=0)
    return min((each for each in reads_us if newest_us - each <= READ_CYCLE_US), default=None)


class GuardView:
    """Makes `GuardInputs` from the frames of each step."""

    def __init__(self, sheet: GearboxSheet, limits: GuardLimits) -> None:
        wheels = sheet.wheels
        self._main = limits.main
        self._teeth = (wheels.layshaft.teeth, wheels.main.teeth)
        counts = (wheels.input_.teeth, *self._teeth, wheels.propeller.teeth)
        self._shafts = {
            can_id: GuardSpeed(teeth) for can_id, teeth in zip(EDGES, counts, strict=True)
        }
        self._ear = GuardReceiver()
        self._clock = GuardClock()
        self._engine: tuple[int, Engine] = (0, NO_ENGINE)
        self._ahead_us: int | None = None
        self._late: dict[int, tuple[int, int]] = {}
        """Newest time of each message, and how late it was by the controller's clock."""
        self._clutch: tuple[int, float] | None = None
        self._clutch_per_s = 0.0
        self._turns: deque[BothCounted] = deque()
        self._wheels = ShaftsInMesh(sheet, limits)
        self._swings = (SwingMemory(), SwingMemory(), SwingMemory())
        self._has_dog_splitter = bool(limits.splitter)
        self._held = HeldGear(limits.main, sheet.dog.pitch_rad, limits.apart_m)
        self._apart_m, self._in_mesh_m = limits.apart_m, limits.in_mesh_m

    def take(self, frames: Iterable[Frame], step_us: int, believed_us: int) -> GuardInputs:
        """Takes one step's frames, at `step_us` of the controller's clock; believed_us: the sensor
        time that the step's commands are made for."""
        ear = self._ear
        # A step hears its frames message by message: after a hang their times go back and forth.
        heard_us = sorted(set(ear.take(frames, step_us)))
        if ear.has_restarted:
            self._begin_anew()
        is_new = False
        for time_us in heard_us:
            is_new = self._clock.hear(time_us, step_us) or is_new
        own_us = self._clock.now_us(step_us)
        now_us = 0 if own_us is None else own_us
        gained_us = max(self._gained_us(own_us, step_us), self._less_late_us(step_us))
        speeds = self._speeds(now_us)
        engine = self._engine_now(step_us)
        for time_us, closed in ear.clutch:
            self._see_clutch(time_us, closed)
        gear, error_us = ear.requested_gear, signed_us(believed_us - now_us)
        if len(ear.slow) < len(NEEDED):
            a, b, c, d = speeds
            return GuardInputs(
                now_us, (0.0,) * 4, 1.0, 0.0, 0.0, (a, b, c, d), 0, False, engine.speed_rad_s, gear
            )
        first_second_m, crawl_third_m = ear.slow[SLEEVES_MAIN].values
        splitter_m, range_m = ear.slow[SLEEVES_AUX].values
        positions = (first_second_m, crawl_third_m, splitter_m, range_m)
        brake_pa, supply_pa, clutch = ear.slow[SENSORS].values
        oldest_us = min([slow.time_us for slow in ear.slow.values()])
        is_valid = ear.hears_all and now_us - oldest_us <= GUARD_FRESH_US
        in_doubt = self._doubted(positions if is_valid else None, speeds)
        a, b, c, d = (None if k in in_doubt else speed for k, speed in enumerate(speeds))
        agreeing, gear_rad = self._in_mesh(positions, b, c, now_us)
        main = ear.slow[SLEEVES_MAIN]
        swings: tuple[Swing | None, ...] = (self._swings[0].take(b), self._swings[1].take(c))
        sleeves_us = main.time_us
        speeds_m_s: tuple[float, ...] = main.speeds_m_s
        means_m_s: tuple[float, ...] = main.means_m_s
        if self._has_dog_splitter:
            aux, swings = ear.slow[SLEEVES_AUX], (*swings, self._swings[2].take(a))
            sleeves_us = min(sleeves_us, aux.time_us)
            speeds_m_s = (*speeds_m_s, aux.speeds_m_s[0])
            means_m_s = (*means_m_s, aux.means_m_s[0])
        return GuardInputs(
            now_us,
            positions,
            clutch,
            supply_pa,
            brake_pa,
            (a, b, c, d),
            agreeing,
            is_valid,
            engine.speed_rad_s,
            gear,
            error_us,
            sleeves_us,
            speeds_m_s,
            ear.slow[SENSORS].time_us,
            engine.torque_share,
            self._clutch_per_s,
            gained_us,
            is_new,
            bool(heard_us),
            in_doubt,
            swings,
            means_m_s,
            gear_rad,
            self._wheels.denies_gear,
        )

    def _begin_anew(self) -> None:
        """The sensors' clock is another: a time of the old one says nothing in the new."""
        self._clock.restart()
        self._clutch, self._clutch_per_s = None, 0.0
        for shaft in self._shafts.values():
            shaft.forget()
        self._wheels.forget_counts()
        for swing in self._swings:
            swing.forget()
        self._held.forget()

    def _gained_us(self, own_us: int | None, step_us: int) -> int:
        """By how much the clock is further ahead of the controller's than a step ago."""
        before, self._ahead_us = self._ahead_us, None if own_us is None else own_us - step_us
        if before is None or self._ahead_us is None:
            return 0
        return self._ahead_us - before

    def _less_late_us(self, step_us: int) -> int:
        """By how much a message of this step is less late than the last one of its kind, the most
        of all. It may be later than the clock knows a frame can come, and still catch up."""
        gained = []
        for can_id, time_us in self._ear.newest_us.items():
            before = self._late.get(can_id)
            if before is not None and before[0] == time_us:
                continue
            late_us = step_us - time_us
            self._late[can_id] = (time_us, late_us)
            if before is not None:
                gained.append(before[1] - late_us)
        return max(gained, default=0)

    def _see_clutch(self, time_us: int, closed: float) -> None:
        before, self._clutch = self._clutch, (time_us, closed)
        self._clutch_per_s = 0.0
        if before is not None and 0 < time_us - before[0] <= CLUTCH_GAP_US:
            self._clutch_per_s = (closed - before[1]) / (time_us - before[0]) * 1e6

    def _speeds(self, now_us: int) -> list[ShaftSpeed | None]:
        ear = self._ear
        for can_id, shaft in self._shafts.items():
            for edges in ear.edges[can_id]:
                shaft.take(edges)
        return [
            shaft.at(now_us) if ear.channels[can_id].is_valid else None
            for can_id, shaft in self._shafts.items()
        ]

    def _doubted(
        self, positions_m: tuple[float, ...] | None, speeds: list[ShaftSpeed | None]
    ) -> tuple[int, ...]:
        """Wheels that the others deny."""
        shafts = list(zip(self._shafts.values(), speeds, strict=True))
        read_us = _read_by_all([s.read_us for s, v in shafts if v is not None and s.read_us])
        self._wheels.take(positions_m, [shaft.turned(speed, read_us) for shaft, speed in shafts])
        return self._wheels.in_doubt

    def _engine_now(self, step_us: int) -> Engine:
        for said in self._ear.engine:
            self._engine = (step_us, said)
        heard_us, newest = self._engine
        return newest if step_us - heard_us <= GUARD_FRESH_US else NO_ENGINE

    def _in_mesh(
        self,
        positions: tuple[float, ...],
        layshaft: ShaftSpeed | None,
        main: ShaftSpeed | None,
        now_us: int,
    ) -> tuple[int, float | None]:
        """The valve of `GuardInputs.agreeing`, and its `gear_rad`."""
        wheels = zip((LAYSHAFT_EDGES, MAIN_EDGES), (layshaft, main), self._teeth, strict=True)
        shafts = [Shaft(self._shafts[k].counted, speed, teeth) for k, speed, teeth in wheels]
        agreeing = self._agreeing(positions, layshaft, main, now_us)
        held = self._held.take(agreeing, positions, *shafts)
        side = [end_of(position, self._in_mesh_m) for position in positions]
        ratios = [each.ratio for each in self._main.values() if side[each.sleeve] == each.direction]
        return held, gear_angle_rad(ratios[0], *shafts) if len(ratios) == 1 else None

    def _agreeing(
        self,
        positions: tuple[float, ...],
        layshaft: ShaftSpeed | None,
        main: ShaftSpeed | None,
        now_us: int,
    ) -> int:
        """The main valve whose gear turns with its sleeve, from the turns since both sleeves were
        apart from all teeth; 0 if there is none."""
        turns = self._turns
        out = max(abs(positions[0]), abs(positions[1])) > self._apart_m
        slow = layshaft is None or main is None or layshaft.omega_rad_s < TURNING_RAD_S
        if out or slow:
            turns.clear()
            return 0
        turned = (self._shafts[LAYSHAFT_EDGES].counted, self._shafts[MAIN_EDGES].counted)
        if turned[0] is None or turned[1] is None:
            turns.clear()
            return 0
        turns.append((turned[0], turned[1]))
        while len(turns) > 1 and now_us - turns[1][0].time_us >= 2 * AGREE_US:
            turns.popleft()
        if now_us - turns[0][0].time_us < 2 * AGREE_US:
            return 0
        middle = next(t for t in turns if now_us - t[0].time_us <= AGREE_US or t is turns[-1])
        for valve, gear in self._main.items():
            halves = ((turns[0], middle), (middle, turns[-1]))
            if all(abs(self._slip(gear.ratio, *half)) < AGREE_RAD_S for half in halves):
                return valve
        return 0

    def _slip(
        self,
        ratio: float,
        before: tuple[TeethCounted, TeethCounted],
        after: tuple[TeethCounted, TeethCounted],
    ) -> float:
        """Mean slip (rad/s) between two readings, from whole teeth and the times of their edges."""
        layshaft, main = (
            TURN / teeth * (late.teeth - early.teeth) * 1e6 / max(1, late.time_us - early.time_us)
            for teeth, early, late in zip(self._teeth, before, after, strict=True)
        )
        return ratio * layshaft - main
