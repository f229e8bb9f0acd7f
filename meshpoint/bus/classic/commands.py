"""Commands to valves, clutch and engine: packed for a classic bus, and unpacked from it."""

from __future__ import annotations

from typing import Any, Final

from meshpoint.bus.classic.inner import InnerChannel
from meshpoint.dbc.classic.codecs import ClassicEar, ClassicSender, Heard, Hearing
from meshpoint.dbc.classic.contract import ENGINE_CYCLE_MS, VALVES
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import checked_request
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ClutchAction, ClutchCommand, ValveAction, ValveCommand

COUNT: Final = len(VALVES)
TIMED: Final = frozenset({ValveAction.OFF_AT, ValveAction.ON_AT})
NO_CLUTCH, OPEN, CLOSE = 0, 1, 2
CLUTCH_OF: Final = {ClutchAction.OPEN: OPEN, ClutchAction.CLOSE: CLOSE}
ACTION_OF: Final = {OPEN: ClutchAction.OPEN, CLOSE: ClutchAction.CLOSE}
ENGINE_LEAST_US: Final = (ENGINE_CYCLE_MS - 5) * 1000
"""A request to the engine that says nothing new is sent so long after the one before at least."""
CONTENT: Final = 7
"""Bytes of TSC1 before its counter and checksum."""
ORDER_BITS_AT, CLUTCH_AT, TIME_AT = 12, 30, 32
WORD: Final = 0xFFFF_FFFF


class OrderSender:
    """Packs what a step commands."""

    def __init__(self) -> None:
        self._orders, self._time = ClassicSender("ValveOrders"), ClassicSender("ValveTime")
        self._engine: tuple[int, bytes] | None = None
        self._requests = 0

    def valves(self, command: ValveCommand, clutch: ClutchCommand | None) -> list[Frame]:
        """The times of all activations but the first, then the orders."""
        actions, times = command[:COUNT], command[COUNT:]
        timed = [valve for valve in range(COUNT) if actions[valve] in TIMED]
        counter, made = self._orders.next_counter, self._time.message_type
        frames = [self._time.frame(made(counter, v, times[v])) for v in timed[1:]]
        clutch_order = NO_CLUTCH if clutch is None else CLUTCH_OF[clutch.action]
        first_us = times[timed[0]] if timed else 0
        orders = self._orders.message_type._make((*actions, clutch_order, first_us))
        frames.append(self._orders.frame(orders))
        return frames

    def engine(self, frame: Frame, now_us: int) -> list[Frame]:
        """TSC1 with a counter of this bus, where it says something new or is due."""
        content = frame.data[:CONTENT]
        if self._engine is not None:
            sent_us, before = self._engine
            if content == before and now_us - sent_us < ENGINE_LEAST_US:
                return []
        self._engine = (now_us, content)
        self._requests += 1
        return [checked_request(frame, self._requests - 1)]


def read_orders(frames: list[Frame]) -> tuple[list[int], list[int], int]:
    """Actions and times (0 where there is none) of all valves and the clutch's order, from the raw
    bytes of what `OrderSender.valves` has made: nothing here comes from the codec. For whoever
    holds it against the command that the guard has passed."""
    *times, orders = (int.from_bytes(frame.data, "little") for frame in frames)
    actions = [orders >> ORDER_BITS_AT + 2 * valve & 3 for valve in range(COUNT)]
    found = [0] * COUNT
    timed = [valve for valve in range(COUNT) if actions[valve] >= ValveAction.OFF_AT]
    if timed:
        found[timed[0]] = orders >> TIME_AT & WORD
    for time in times:
        if time >> 12 & 0xF != orders >> 8 & 0xF:
            raise ValueError("a ValveTime of other orders")
        found[time >> 16 & 0xF] = time >> 20 & WORD
    return actions, found, orders >> CLUTCH_AT & 3


class OrdersPassedOn:
    """Hands the orders on as they are: to a board that hears classic frames itself."""

    def __init__(self) -> None:
        self.ids: Final = OrderIntake().ids
        """The identifiers that this takes."""

    def take(self, frame: Frame) -> list[Frame]:
        """The frame."""
        return [frame]


class OrderIntake:
    """Makes the commands of meshpoint.dbc again."""

    def __init__(self) -> None:
        self._orders, self._time = ClassicEar("ValveOrders"), ClassicEar("ValveTime")
        self._valves, self._clutch = InnerChannel("ValveCommand"), InnerChannel("ClutchCommand")
        self._waits: dict[int, tuple[int, int]] = {}
        """By valve the activation time heard last, and of which orders it is."""
        self.incomplete = 0
        """Orders whose times were not all there: not obeyed."""

    @property
    def ids(self) -> frozenset[int]:
        """The identifiers that this takes."""
        return frozenset({self._orders.can_id, self._time.can_id})

    def take(self, frame: Frame) -> list[Frame]:
        """The commands that a frame of `ids` completes."""
        if frame.can_id == self._time.can_id:
            self._note(self._time.hear(frame))
            return []
        hearing = self._orders.hear(frame)
        if hearing.heard is Heard.DAMAGED:
            return [self._valves.damaged(), self._clutch.damaged()]
        if hearing.heard is Heard.REPEATED:
            return [*self._valves.again(), *self._clutch.again()]
        return self._commands(hearing)

    def _note(self, hearing: Hearing) -> None:
        if hearing.heard is Heard.OK and hearing.message.valve < COUNT:
            self._waits[hearing.message.valve] = (hearing.message.order, hearing.message.time_us)

    def _commands(self, hearing: Hearing) -> list[Frame]:
        *actions, clutch, first_us = hearing.message
        waits, self._waits = self._waits, {}
        timed = [valve for valve in range(COUNT) if actions[valve] in TIMED]
        times = [0] * COUNT
        for valve in timed[:1]:
            times[valve] = first_us
        for valve in timed[1:]:
            order, time_us = waits.get(valve, (None, 0))
            if order != hearing.counter:
                self.incomplete += 1
                return []
            times[valve] = time_us
        command = CODECS["ValveCommand"].message_type(*actions, *times)
        frames = [self._valves.frame(command, hearing.steps)]
        if clutch in ACTION_OF:
            made = ClutchCommand(action=ACTION_OF[clutch])
            frames.append(self._clutch.frame(made, hearing.steps))
        return frames


def orders_say(frames: list[Frame], command: Any, clutch: ClutchCommand | None) -> bool:
    """Whether the packed frames read back as this command and no other."""
    actions, times, clutch_order = read_orders(frames)
    wanted = [int(action) for action in command[:COUNT]]
    wanted_us = [
        time_us if action in TIMED else 0
        for action, time_us in zip(command[:COUNT], command[COUNT:], strict=True)
    ]
    expected = NO_CLUTCH if clutch is None else CLUTCH_OF[clutch.action]
    return (actions, times, clutch_order) == (wanted, wanted_us, expected)
