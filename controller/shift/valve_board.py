"""The present command of each valve, as the sequence gives it and the wire has it.

There is a command for each valve, sent again at every step. Hardware that can schedule gets the
activation time with the command. Hardware that cannot (`valve_timing = "immediate"`) gets plain on
and off; the controller then steps at that time.
"""

from __future__ import annotations

from operator import itemgetter
from typing import Final, NamedTuple

from meshpoint.controller.plan.strategy import BUS_US
from meshpoint.controller.settings.settings import ValveTiming
from meshpoint.controller.settings.valve_name import DOG_OPPOSITE, DOG_VALVE, ValveName
from meshpoint.controller.sleeve.sleeves import Sleeves
from meshpoint.dbc.messages import ValveAction, ValveCommand
from meshpoint.dbc.sensor_time import wrap

_ACTION: Final = itemgetter(0)
_TIME_US: Final = itemgetter(1)
OFF_HELD_US: Final = 1_000
"""An `off` older than this is sent as OFF_NOW: a valve side that has not heard it before would
refuse it as too late, and leave the valve on."""
FOREVER_US: Final = 1 << 62


class SwitchCommand(NamedTuple):
    """The valve is to be `on` from sensor time `time_us`; `before` is its state until then. A pulse
    ends at `until_us`."""

    time_us: int
    on: bool
    before: bool
    until_us: int = FOREVER_US

    def at(self, time_us: int) -> bool:
        """Whether the valve is driven at a sensor time."""
        if time_us < self.time_us:
            return self.before
        return self.on and time_us < self.until_us

    def rests(self, now_us: int) -> bool:
        """Whether the valve is off and stays so."""
        return not self.at(now_us) and (not self.on or now_us >= self.until_us)


OFF: Final = SwitchCommand(-(1 << 62), False, False)


class ValveBoard:
    """The present command of each valve."""

    def __init__(self, timing: ValveTiming, wire_us: int = 0) -> None:
        """wire_us: `Timing.wire_us`."""
        self.keeps_times = timing is ValveTiming.SCHEDULED
        """Whether the valve side switches at a command's own time."""
        self.ahead_us = 0 if self.keeps_times else wire_us
        """By this much sooner a switch is sent."""
        self._commands: dict[ValveName, SwitchCommand] = dict.fromkeys(ValveName, OFF)
        self._rest: set[ValveName] = set(ValveName)
        """Those that the message before left off."""
        self._message: ValveCommand | None = None
        self._message_until_us = 0

    def schedule(self, valve: ValveName, on: bool, time_us: int, now_us: int) -> None:
        """Switch the valve at a sensor time; replaces what was still to come."""
        before = self.driven(valve, now_us)
        self._commands[valve] = SwitchCommand(time_us, on, before)
        self._message = None

    def pulse(self, valve: ValveName, on_us: int, off_us: int, now_us: int) -> None:
        """Switch the valve on from one sensor time to another; replaces what was still to come.

        A valve has one slot at the valve side: the end is sent again when the beginning has
        passed."""
        before = self.driven(valve, now_us)
        self._commands[valve] = SwitchCommand(on_us, True, before, off_us)
        self._message = None

    def all_off(self) -> None:
        """Everything off at once."""
        self._commands = dict.fromkeys(ValveName, OFF)
        self._message = None

    def off(self, valve: ValveName) -> None:
        """This valve off at once."""
        self._commands[valve] = OFF
        self._message = None

    def driven(self, valve: ValveName, time_us: int) -> bool:
        """Whether the valve is driven at a sensor time, as commanded."""
        return self._commands[valve].at(time_us)

    def command(self, valve: ValveName) -> SwitchCommand:
        """The command as it stands."""
        return self._commands[valve]

    def publish_to(self, sleeves: Sleeves, now_us: int) -> None:
        """What is commanded of the valves of dog sleeves; what goes off at once takes the bus's
        time."""
        for valve in DOG_VALVE.values():
            command = self._commands[valve]
            switches = [(now_us + BUS_US if command is OFF else command.time_us, command.on)]
            if command.until_us < FOREVER_US:
                switches.append((command.until_us, False))
            sleeves.expected(valve, switches)

    def next_switch_us(self, now_us: int) -> int | None:
        """The first sensor time after this one at which the valve side needs a frame before the
        next tick; else None. Hardware that cannot schedule needs one at each switch; the other one
        at a pulse's beginning, for its end: on a tick that is a little late that would be late."""
        commands = self._commands.values()
        if self.keeps_times:
            times = [c.time_us for c in commands if c.until_us < FOREVER_US]
        else:
            times = [t for c in commands for t in (c.time_us, c.until_us)]
        sent_us = now_us + self.ahead_us
        next_us = min((t for t in times if t > sent_us), default=FOREVER_US)
        return None if next_us == FOREVER_US else next_us - self.ahead_us

    def message(self, now_us: int) -> ValveCommand:
        """The command frame's content at a sensor time; kept until something changes."""
        now_us += self.ahead_us
        if self._message is None or now_us >= self._message_until_us:
            self._message = self._make_message(now_us)
            self._message_until_us = self._unchanged_until_us(now_us)
        return self._message

    def _make_message(self, now_us: int) -> ValveCommand:
        said = [self._action(command, now_us) for command in self._commands.values()]
        rest = {valve for valve in ValveName if said[valve][0] is ValveAction.OFF_NOW}
        if self.keeps_times:
            self._say_ends(said, self._rest & rest, now_us)
        self._rest = rest
        # The frame has all actions, then all times, each in the order of `ValveName`.
        return ValveCommand._make([*map(_ACTION, said), *map(_TIME_US, said)])

    def _say_ends(
        self, said: list[tuple[ValveAction, int]], rest: set[ValveName], now_us: int
    ) -> None:
        """The end of a pulse that waits, in the slot of its sleeve's other valve, if that was off
        before: whatever frames are lost then, the pulse gets no longer."""
        for gear, valve in DOG_VALVE.items():
            command, other = self._commands[valve], DOG_OPPOSITE[gear]
            waits = now_us < command.time_us < command.until_us < FOREVER_US
            if waits and other in rest:
                said[other] = ValveAction.OFF_AT, wrap(command.until_us)

    def _unchanged_until_us(self, now_us: int) -> int:
        """When the message's content changes although no new command is given."""
        held_us = OFF_HELD_US + 1 if self.keeps_times else 0
        times = [
            switch_us + held_us
            for c in self._commands.values()
            for switch_us in (c.time_us, c.until_us)
        ] + [c.time_us for c in self._commands.values() if c.until_us < FOREVER_US]
        return min([time_us for time_us in times if time_us > now_us], default=FOREVER_US)

    def _action(self, command: SwitchCommand, now_us: int) -> tuple[ValveAction, int]:
        if not self.keeps_times:
            return (ValveAction.ON_NOW if command.at(now_us) else ValveAction.OFF_NOW), 0
        if command.until_us < FOREVER_US and now_us >= command.time_us:
            command = SwitchCommand(command.until_us, False, True)
        if not command.on and command.time_us < now_us - OFF_HELD_US:
            return ValveAction.OFF_NOW, 0
        action = ValveAction.ON_AT if command.on else ValveAction.OFF_AT
        return action, wrap(command.time_us)
