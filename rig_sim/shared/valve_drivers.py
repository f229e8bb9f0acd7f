"""The nine valve drivers: pending slots, activation times, expiry.

Activations are in the unwrapped sensor clock in integer microseconds; commands carry its low 32
bits. The expiry is in the drivers' own time, which nothing sets: a sensor clock that jumps back
must not keep a valve on. Rules (wire contract, ValveCommand):

* OFF_NOW/ON_NOW switch at once and empty the valve's slot.
* OFF_AT/ON_AT fill the slot, replacing what was there. The same activation again changes nothing,
  whether it is still pending or has passed; one that has passed is never armed again.
* An activation first received more than 2 ms late or more than 100 ms ahead is refused: counted,
  once however often it is resent, the slot emptied, the valve left as it is.
* An activation that passes switches the other valve of its sleeve off: ON_AT of one and OFF_AT of
  the other, which is off, say a pulse whole, and no lost command lengthens it.
* 100 ms of own time after the last command all valves switch off, all slots are emptied; counted.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final, NamedTuple

from meshpoint.dbc.messages import ValveAction
from meshpoint.rig_sim.settings import CLOCK_MODULUS

MAX_LATE_US: Final = 2_000
MAX_AHEAD_US: Final = 100_000
EXPIRY_US: Final = 100_000


class Valve(IntEnum):
    """The valves in the order of the wire contract."""

    BRAKE = 0
    SPLIT_LOW = 1
    SPLIT_HIGH = 2
    MAIN_FIRST = 3
    MAIN_SECOND = 4
    MAIN_CRAWL = 5
    MAIN_THIRD = 6
    RANGE_LOW = 7
    RANGE_HIGH = 8


OTHER_OF_SLEEVE: Final = (None, 2, 1, 4, 3, 6, 5, 8, 7)
"""By valve: the one that pushes its sleeve the other way."""


class Order(NamedTuple):
    """What a command says of one valve; time_us is the 32-bit clock, read only by OFF_AT, ON_AT."""

    action: ValveAction
    time_us: int = 0


class Change(NamedTuple):
    """A valve that has been switched, now or when its activation was due."""

    valve: Valve
    on: bool


class _Activation(NamedTuple):
    on: bool
    time_us: int


class _Driver:
    """One valve: its output, its slot, and the last activation that passed or was refused."""

    def __init__(self) -> None:
        self.energised = False
        self.pending: _Activation | None = None
        self.passed: _Activation | None = None
        self.refused: _Activation | None = None

    def order(self, order: Order, now_us: int) -> bool:
        """Take an order; whether it was refused now."""
        if order.action in (ValveAction.OFF_NOW, ValveAction.ON_NOW):
            self.pending = None
            self.energised = order.action is ValveAction.ON_NOW
            return False
        ahead = (order.time_us - now_us + CLOCK_MODULUS // 2) % CLOCK_MODULUS - CLOCK_MODULUS // 2
        wanted = _Activation(order.action is ValveAction.ON_AT, now_us + ahead)
        if wanted == self.pending:
            return False
        self.pending = None
        if wanted in (self.passed, self.refused):
            return False
        if not -MAX_LATE_US <= ahead <= MAX_AHEAD_US:
            self.refused = wanted
            return True
        self.pending = wanted  # one that is late already is done by the `activate` that follows
        return False


class ValveBank:
    """All valves. Calls must come in the order of time; changes are returned, offs before ons."""

    def __init__(self) -> None:
        self._drivers = [_Driver() for _ in Valve]
        self.energised: tuple[bool, ...] = (False,) * len(Valve)
        """Which valves are driven, in the order of `Valve`."""
        self.pending: tuple[bool, ...] = (False,) * len(Valve)
        """Which valves have an activation waiting."""
        self.expiry_us: int | None = None
        """When all valves switch off, in own time; None: no command holds."""
        self.activation_us: int | None = None
        """The earliest activation that waits, in the sensor clock; None: none does."""
        self.refused = 0
        self.expired = 0
        self.dropped = 0
        """Expiries that switched something off."""

    def command(self, orders: tuple[Order, ...], clock_us: int, own_us: int) -> list[Change]:
        """A valid frame, consumed now by both clocks: one order a valve."""
        for driver, order in zip(self._drivers, orders, strict=True):
            self.refused += driver.order(order, clock_us)
        self.expiry_us = own_us + EXPIRY_US
        return self.activate(clock_us)

    def renew(self, own_us: int) -> bool:
        """The orders of the command before, once more: nothing changes but the expiry.

        False, and nothing done, after an expiry, which may have switched off what they ask for."""
        if self.expiry_us is None:
            return False
        self.expiry_us = own_us + EXPIRY_US
        return True

    def activate(self, clock_us: int) -> list[Change]:
        """Do what is due by the sensor clock (not later: call at `activation_us`)."""
        due = [
            (waits.time_us, waits.on, valve)
            for valve, driver in enumerate(self._drivers)
            if (waits := driver.pending) is not None and waits.time_us <= clock_us
        ]
        for _, on, valve in sorted(due):  # of one instant, offs before ons
            driver, other = self._drivers[valve], OTHER_OF_SLEEVE[valve]
            driver.energised, driver.passed, driver.pending = on, driver.pending, None
            if other is not None:
                self._drivers[other].energised = False
        return self._changes()

    def expire(self, own_us: int) -> list[Change]:
        """Switch off where no command holds by now (call at `expiry_us`, after `activate`)."""
        if self.expiry_us is None or self.expiry_us > own_us:
            return []
        self.expired += 1
        changes = self.all_off()
        self.dropped += bool(changes)
        return changes

    def all_off(self) -> list[Change]:
        """Switch everything off and empty all slots, as at shutdown."""
        self._clear()
        return self._changes()

    def _clear(self) -> None:
        self.expiry_us = None
        for driver in self._drivers:
            driver.energised, driver.pending = False, None

    def _changes(self) -> list[Change]:
        before = self.energised
        self.energised = tuple([driver.energised for driver in self._drivers])
        self.pending = tuple([driver.pending is not None for driver in self._drivers])
        times = [driver.pending.time_us for driver in self._drivers if driver.pending]
        self.activation_us = min(times, default=None)
        changed = [
            Change(valve, after)
            for valve, was, after in zip(Valve, before, self.energised, strict=True)
            if was is not after
        ]
        return sorted(changed, key=lambda change: change.on)
