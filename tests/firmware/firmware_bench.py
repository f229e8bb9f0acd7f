"""A board at a bench: commands in, outputs and ValveStatus out."""

from __future__ import annotations

import pytest

from meshpoint.base.errors import CommandError
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Transmitter, read_alone
from meshpoint.dbc.messages import ClutchAction, ClutchCommand, Message, ValveAction, ValveCommand
from meshpoint.dbc.node import Node
from meshpoint.firmware.board import Analogue, Board
from meshpoint.firmware.build import IMAGES, image, source_folder
from meshpoint.firmware.cortex_m4.emulated_board import EmulatedBoard
from meshpoint.firmware.native_board import CHANGES, Memory, NativeBoard

VALVES = [name.removesuffix("_action") for name in ValveCommand._fields if "_action" in name]
WRAP = 1 << 32
PAIRS = (("split_low", "split_high"), ("main_first", "main_second"),
         ("main_crawl", "main_third"), ("range_low", "range_high"))  # fmt: skip
AT_REST = Analogue([[0] * 10] * 4, (5_065, 47_565, 18_000, 10_000))
BY_ID = {codec.spec.can_id: codec for codec in CODECS.values()}
Order = ValveAction | tuple[ValveAction, int]


def names(driven: int) -> set[str]:
    """The valves of a mask."""
    return {name for place, name in enumerate(VALVES) if driven >> place & 1}


def command(orders: dict[str, Order]) -> ValveCommand:
    """Of the valves that are not named: off now."""
    fields: dict[str, int] = {}
    for name, order in orders.items():
        action, time_us = order if isinstance(order, tuple) else (order, 0)
        fields |= {f"{name}_action": action, f"{name}_time_us": time_us % WRAP}
    return ValveCommand(**fields)


def emulated_board(by: str, name: str = "both") -> EmulatedBoard:
    """One with this image, by a compiler; skips with the reason where that, or unicorn, is not
    installed."""
    pytest.importorskip("unicorn", reason="meshpoint[firmware] is not installed")
    try:
        return EmulatedBoard(image(source_folder(), IMAGES[name], by))
    except CommandError as error:
        pytest.skip(str(error))


class CommandBench:
    """A board that has been switched on and heard three commands: it obeys the next one."""

    def __init__(self, board: Board, sensor_us: int = 1_000_000) -> None:
        self.board = board
        self._sender = Transmitter(Node.TRANSMISSION_CONTROL)
        board.power_on(sensor_us)
        self.be_heard()

    def be_heard(self) -> None:
        """Three commands that ask for nothing: the channel is valid with the third."""
        for _ in range(3):
            self.command()

    @property
    def now_us(self) -> int:
        """The sensor clock."""
        return self.board.sensor_us

    @property
    def memory(self) -> Memory:
        """Of a native board."""
        assert isinstance(self.board, NativeBoard)
        return self.board.memory

    def valve_frame(self, **orders: Order) -> Frame:
        return self._sender.encode(command(orders))

    def command(self, **orders: Order) -> None:
        self.board.receive(self.valve_frame(**orders))

    def clutch_frame(self, action: ClutchAction) -> Frame:
        return self._sender.encode(ClutchCommand(action=action))

    def wait(self, for_us: int) -> None:
        self.board.advance(for_us)

    @property
    def driven(self) -> set[str]:
        return names(self.board.driven)

    def switched(self) -> list[tuple[int, set[str]]]:
        """When the outputs were switched, and what was driven then; own time."""
        newest = self.memory.change_count
        places = range(max(0, newest - CHANGES), newest)
        changes = [self.memory.changes[place % CHANGES] for place in places]
        return [(each.own_us, names(each.driven)) for each in changes]

    def read(self) -> dict[str, Message]:
        """What the board says of a cycle, by its name; each frame is whole."""
        self.board.take_sent()
        self.board.read(AT_REST)
        return self.sent()

    def sent(self) -> dict[str, Message]:
        """What it has sent, by name; each frame is whole."""
        found = {}
        for frame in self.board.take_sent():
            message = read_alone(BY_ID[frame.can_id], frame)
            assert message is not None, frame
            found[type(message).__name__] = message
        return found
