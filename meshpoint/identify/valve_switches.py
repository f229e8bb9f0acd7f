"""When the valves were switched, by the commands on the bus (wire contract, ValveCommand)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from meshpoint.controller.settings.valve_name import DOG_VALVE
from meshpoint.dbc.messages import ValveAction, ValveCommand
from meshpoint.dbc.sensor_time import unwrap
from meshpoint.gearbox.gears import MAIN_GEARS, DogGear

LATE_US: Final = 2_000
AHEAD_US: Final = 100_000
"""An activation that first comes later than this, or for a time further ahead, is refused by the
drivers, however often it is sent again."""
VALVE_OF_GEAR: Final = {gear: valve.name.lower() for gear, valve in DOG_VALVE.items()}
"""As the fields of a ValveCommand begin."""
BRAKE: Final = "brake"


class Switch(NamedTuple):
    """A valve switched on or off. time_us: sensor clock, unwrapped."""

    time_us: int
    on: bool
    exact: bool
    """Whether its time was commanded; else it is that at which the command came."""


class _Slot:
    """One valve: its state and its one pending activation."""

    def __init__(self) -> None:
        self.on = False
        self.switches: list[Switch] = []
        self.late = 0
        self._pending: Switch | None = None
        self._passed: Switch | None = None
        self._refused: Switch | None = None
        """The newest activations that have passed and that were refused: neither is taken again."""

    def take(self, action: ValveAction, stamp: int, now_us: int) -> None:
        self.run(now_us)
        if action in (ValveAction.OFF_NOW, ValveAction.ON_NOW):
            self._pending = None
            self._switch(Switch(now_us, action is ValveAction.ON_NOW, False))
            return
        at_us = unwrap(stamp, now_us)
        wanted = Switch(at_us, action is ValveAction.ON_AT, True)
        if wanted == self._pending:
            return
        self._pending = None
        if wanted in (self._passed, self._refused):
            return
        if not -LATE_US <= at_us - now_us <= AHEAD_US:
            self._refused = wanted
            self.late += at_us < now_us
        elif at_us <= now_us:
            self._pass(wanted)
        else:
            self._pending = wanted

    def run(self, now_us: int) -> None:
        """What is due by now."""
        if self._pending is not None and self._pending.time_us <= now_us:
            self._pass(self._pending)
            self._pending = None

    def _pass(self, activation: Switch) -> None:
        self._passed = activation
        self._switch(activation)

    def _switch(self, switch: Switch) -> None:
        if switch.on is not self.on:
            self.on = switch.on
            self.switches.append(switch)


class ValveSwitches:
    """Follows the drivers of the brake's valve, and of those that bring these gears in, by the
    commands they got."""

    def __init__(self, gears: Sequence[DogGear] = MAIN_GEARS) -> None:
        self._slots = {name: _Slot() for name in (BRAKE, *map(VALVE_OF_GEAR.__getitem__, gears))}

    def take(self, command: ValveCommand, now_us: int) -> None:
        """A command that came at this time of the sensor clock."""
        for name, slot in self._slots.items():
            action, stamp = getattr(command, f"{name}_action"), getattr(command, f"{name}_time_us")
            slot.take(action, stamp, now_us)

    @property
    def late(self) -> int:
        """Commands with an activation that had passed when they came, and none such was there."""
        return sum(slot.late for slot in self._slots.values())

    def of(self, name: str, now_us: int) -> list[Switch]:
        """The switches of a valve up to now, oldest first."""
        slot = self._slots[name]
        slot.run(now_us)
        return slot.switches

    def forget(self, before_us: int) -> None:
        """Drops switches that are older, but for each valve's newest."""
        for slot in self._slots.values():
            kept = [switch for switch in slot.switches[:-1] if switch.time_us >= before_us]
            slot.switches = kept + slot.switches[-1:]
