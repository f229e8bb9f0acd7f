"""What must hold at every step, whatever fails: held against the gearbox's own truth.

What the guard cannot know (docs/safety.md) is left out by rule: while a position sensor lies, or a
valve does not follow its coil, a collision that it causes is the fault's own.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from benchmarks.swarm.nodes import WatchedController, WatchedRig
from meshpoint.controller.guard.own_clock import signed_us
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.shift.table import IN_SHIFT
from meshpoint.gearbox import GearboxSheet
from meshpoint.rig_sim.shared.engagement import Violation

EXPIRY_US: Final = 115_000
"""The valve side's 100 ms, its read and the bus."""
LONGEST_SHIFT_US: Final = 25_000_000
"""Every phase as long as its limit, every retry used."""
OVERSPEED: Final = 1.03
"""The sheet's limit, what a sensor may be wrong by, and the guard's 1 %."""
MEMORY_US: Final = 90_000
"""A speed that the guard uses is at most so old."""
SPEED_ERROR: Final = 0.05
"""A gear that locks jerks its shafts for less time than there is between two polls at the truth."""
SPEED_ERROR_RAD_S: Final = 2.0
BLIND_STEPS: Final = 2
BEHIND_US: Final = 20_000
"""A frame's delay, and a sensor clock that went back by less than a cycle (docs/safety.md, Not
protected)."""
AHEAD_US: Final = 60_000
"""Samples may be 40 ms old to be valid, and a cycle is sent after its samples."""
LIES: Final = frozenset({"position_offset", "position_frozen", "frozen_payload"})
SLUGGISH: Final = frozenset({"valve_stuck", "valve_slow", "valve_slow_on", "valve_slow_off"})
REACT_US: Final = 30_000
"""From a sleeve that the bench moves until a brake that was on before is off: what the sensors show
late, a tick, and the way of the command."""
FORESEEN_BY_NOBODY: Final = (Violation.BRAKE_IN_GEAR, Violation.SLIP_AT_CONTACT)
"""Where a hand pushes a gear in."""
CLOCKS: Final = frozenset({"clock_step", "clock_drift", "node_restart", "node_stalled"})


class Broken(NamedTuple):
    """An invariant that did not hold."""

    what: str
    at_ms: int
    text: str


@dataclass
class Invariants:
    """Looks at both nodes after every step; `active` are the faults of now and just before."""

    sheet: GearboxSheet
    broken: list[Broken]
    settings: ControllerSettings = field(default_factory=ControllerSettings)

    def __post_init__(self) -> None:
        self._counted: dict[Violation, int] = {}
        self._speeds: deque[tuple[int, tuple[float, ...]]] = deque()
        self._blind = 0
        self._sent_us = 0
        self._in_shift_us: int | None = None
        self._clock: tuple[int, int] | None = None
        self._bench_us = -REACT_US

    def note(self, what: str, now_us: int, text: str) -> None:
        """Keeps the first of each kind."""
        if all(each.what != what for each in self.broken):
            self.broken.append(Broken(what, now_us // 1000, text))

    def controller_is_new(self) -> None:
        """It has started anew, and its shift as well."""
        self._in_shift_us = None

    def heard(self, now_us: int) -> None:
        """A valve command of the controller's has reached the gearbox."""
        self._sent_us = now_us

    def rig(self, rig: WatchedRig, now_us: int, active: frozenset[str]) -> None:
        """After a step of the gearbox."""
        truth: Any = rig.truth
        self._clock = now_us, rig.sensor_us
        if rig.is_moved_by_the_bench:
            self._bench_us = now_us
        by_bench = now_us - self._bench_us <= REACT_US
        for kind, count in truth.violations.items():
            before, self._counted[kind] = self._counted.get(kind, 0), count
            if kind in FORESEEN_BY_NOBODY and by_bench:
                continue
            if count > before and not (active & _excuses(kind)):
                self.note(kind.name.lower(), now_us, f"{count} times")
        speeds = truth.speeds_rad_s
        self._speeds.append((now_us, speeds))
        while self._speeds[0][0] < now_us - MEMORY_US:
            self._speeds.popleft()
        most = OVERSPEED * self.sheet.limits.input_max_rad_s
        if speeds[0] > most:
            rpm = speeds[0] * 30.0 / 3.14159265
            self.note("input_overspeed", now_us, f"input shaft at {rpm:.0f} rpm")
        if any(rig.energised) and not rig.is_stalled and now_us - self._sent_us > EXPIRY_US:
            late_ms = (now_us - self._sent_us) / 1000.0
            self.note(
                "valve_after_expiry", now_us, f"driven {late_ms:.0f} ms after the last command"
            )

    def controller(self, core: WatchedController, now_us: int, active: frozenset[str]) -> None:
        """After a step of the controller."""
        self._blind = self._blind + 1 if core.drives and not core.sees_all else 0
        if self._blind > BLIND_STEPS:
            self.note("driven_blind", now_us, "valves driven on channels that are not valid")
        if core.state not in IN_SHIFT:
            self._in_shift_us = None
        elif self._in_shift_us is None:
            self._in_shift_us = now_us
        elif now_us - self._in_shift_us > LONGEST_SHIFT_US:
            self.note("shift_without_end", now_us, core.state.name)
        if core.seen is not None and core.is_proven:
            self._time(core.seen, now_us, active)
            self._guard_speeds(core.seen.speeds, now_us, active)

    def _time(self, seen: Any, now_us: int, active: frozenset[str]) -> None:
        """Where the guard would let a valve be driven, its clock is that of the sensors."""
        if self._clock is None or not seen.valid or active & (CLOCKS | {"bus_delay"}):
            return
        stepped_us, sensor_us = self._clock
        error_us = signed_us(seen.now_us - sensor_us - (now_us - stepped_us))
        if not -BEHIND_US <= error_us <= AHEAD_US:
            self.note("absurd_time", now_us, f"the guard's clock is wrong by {error_us} us")

    def _guard_speeds(self, speeds: Any, now_us: int, active: frozenset[str]) -> None:
        if active & {"hall_noise_burst", "wheel_factor", "bus_delay", *CLOCKS} or not self._speeds:
            return
        for shaft, speed in enumerate(speeds):
            if speed is None:
                continue
            true = [each[shaft] for _, each in self._speeds]
            slack = SPEED_ERROR_RAD_S + SPEED_ERROR * max(true)
            if not min(true) - slack <= speed.omega_rad_s <= max(true) + slack:
                self.note(
                    "guard_speed", now_us,
                    f"shaft {shaft}: {speed.omega_rad_s:.1f} rad/s, in truth {min(true):.1f}.."
                    f"{max(true):.1f}",
                )  # fmt: skip


def _excuses(kind: Violation) -> frozenset[str]:
    return LIES | SLUGGISH if kind is not Violation.BOTH_VALVES else SLUGGISH
