"""The python-can interface `meshpoint_simulated`: like `virtual`, but a CAN bus.

Nodes of one process that open the same channel share a bus on which frames take their time, compete
by identifier, are destroyed and sent again, and on which a node can go bus-off and come back:

    with can.Bus(interface="meshpoint_simulated", channel="bench") as bus:
        bus.destroy_frames(3)        # error frames on demand
        bus.go_bus_off()             # and bus-off
"""

from __future__ import annotations

import errno
from typing import Any, Final

import can
from can.typechecking import AutoDetectedConfig, CanFilters, Channel

from meshpoint.bus.simulated.confinement import ErrorState
from meshpoint.bus.simulated.core import QUEUE_LENGTH, QueueOrder
from meshpoint.bus.simulated.events import ErrorKind
from meshpoint.bus.simulated.frame_bits import BitTiming
from meshpoint.bus.simulated.messages import wire_frame_of
from meshpoint.bus.simulated.wire import Port, close_port, open_channels, open_port

INTERFACE: Final = "meshpoint_simulated"
MAX_BITRATE: Final = 20_000_000
_STATES: Final = {
    ErrorState.ACTIVE: can.BusState.ACTIVE,
    ErrorState.PASSIVE: can.BusState.PASSIVE,
    ErrorState.BUS_OFF: can.BusState.ERROR,
}


class SimulatedBus(can.BusABC):
    """A node on a simulated bus of this process.

    channel: name of the bus; nodes that open the same name are on the same bus.
    bitrate, data_bitrate: bits a second in the arbitration and in the data phase; equal for all.
    timing: python-can's other way to say them; its sample points have no meaning here.
    queue: `fifo`, frames leave in the order given, or `priority`; equal for all.
    tx_queue_size: frames that may wait to be sent.
    rx_queue_size: messages that may wait to be read; the newest is lost where it is full.
    error_frames: whether `recv` returns error frames (coded as by SocketCAN).
    restart_ms: time from bus-off to the beginning of the way back; 0: only when asked.

    Raises CanInitializationError for what cannot be.
    """

    def __init__(
        self,
        channel: Channel | None = None,
        can_filters: CanFilters | None = None,
        *,
        bitrate: int = 500_000,
        data_bitrate: int = 2_000_000,
        timing: can.BitTiming | can.BitTimingFd | None = None,
        queue: str = QueueOrder.FIFO.value,
        tx_queue_size: int = QUEUE_LENGTH,
        rx_queue_size: int = 100_000,
        receive_own_messages: bool = False,
        error_frames: bool = True,
        restart_ms: int = 0,
        **kwargs: Any,
    ) -> None:
        self._is_open = False
        name = "default" if channel is None else str(channel)
        if isinstance(timing, can.BitTimingFd):
            bitrate, data_bitrate = timing.nom_bitrate, timing.data_bitrate
        elif timing is not None:
            bitrate = timing.bitrate
        try:
            form = (BitTiming(_bit_ns(bitrate), _bit_ns(data_bitrate)), _queue_order(queue))
            for what, value, least in (
                ("tx_queue_size", tx_queue_size, 1),
                ("rx_queue_size", rx_queue_size, 1),
                ("restart_ms", restart_ms, 0),
            ):
                _check_least(what, value, least)

            def port(number: int) -> Port:
                restart_ns = restart_ms * 1_000_000
                return Port(number, rx_queue_size, receive_own_messages, error_frames, restart_ns)

            self._wire, self._port = open_port(name, form, tx_queue_size, port)
        except (ValueError, TypeError) as error:
            raise can.CanInitializationError(f"{INTERFACE}: {error}") from error
        self._is_open = True
        self._can_protocol = can.CanProtocol.CAN_FD
        self.channel_info = f"{INTERFACE} channel {name}"
        super().__init__(channel=name, can_filters=can_filters, **kwargs)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Hands a frame to the transmit queue, waiting for a place in it.

        An error frame destroys the next frame on the bus. FD data are padded with zeros to a
        length that CAN FD has. timeout: seconds to wait, None for ever.

        Raises CanTimeoutError where the queue stays full, CanOperationError (ENETDOWN) where this
        node is bus-off, ValueError for a frame no CAN bus could carry."""
        self._check_open()
        if msg.is_error_frame:
            self._wire.destroy(1, ErrorKind.STUFF, None, self._port.number)
            return
        sent = self._wire.send(self._port, wire_frame_of(msg), timeout)
        if sent is None:
            raise can.CanOperationError(f"{INTERFACE}: bus-off", errno.ENETDOWN)
        if not sent:
            raise can.CanTimeoutError(f"{INTERFACE}: transmit queue full", errno.ENOBUFS)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self._check_open()
        return self._wire.receive(self._port, timeout), False

    def destroy_frames(
        self, count: int = 1, kind: ErrorKind = ErrorKind.BIT, *, own_only: bool = False
    ) -> None:
        """The next `count` frames on the bus are destroyed, or the next of this node. Each is sent
        again, and error counters follow: 32 in a row bring their sender to bus-off."""
        if count < 1:
            raise ValueError(f"count {count}, allowed is 1 or more")
        self._check_open()
        self._wire.destroy(count, kind, self._port.number if own_only else None, None)

    def go_bus_off(self) -> None:
        """This node goes bus-off now; what waits in its queue is thrown away."""
        self._check_open()
        self._wire.bus_off(self._port)

    def restart(self) -> None:
        """Begins the way back from bus-off: 128 times 11 recessive bits."""
        self._check_open()
        self._wire.restart(self._port)

    @property
    def state(self) -> can.BusState:
        """ACTIVE, PASSIVE (error-passive) or ERROR (bus-off)."""
        return _STATES[self._wire.state(self._port)[0]]

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        if new_state is not can.BusState.ACTIVE:  # python-can's way to say that a bus cannot
            raise NotImplementedError(f"{INTERFACE}: only ACTIVE, which restarts, can be set")
        self.restart()

    @property
    def error_counters(self) -> tuple[int, int]:
        """Transmit and receive error counter."""
        _, transmit, receive = self._wire.state(self._port)
        return transmit, receive

    @property
    def frames_lost(self) -> int:
        """Messages that found the receive queue full."""
        return self._port.lost

    def shutdown(self) -> None:
        """Leaves the bus; a frame on it goes through."""
        super().shutdown()
        if self._is_open:
            self._is_open = False
            close_port(self._wire, self._port)

    def _check_open(self) -> None:
        if not self._is_open:
            raise can.CanOperationError(f"{INTERFACE}: the bus is shut down")

    @staticmethod
    def _detect_available_configs() -> list[AutoDetectedConfig]:
        return [{"interface": INTERFACE, "channel": name} for name in open_channels()]


def _check_least(what: str, value: int, least: int) -> None:
    if value < least:
        raise ValueError(f"{what} {value}, allowed is {least} or more")


def _queue_order(name: str) -> QueueOrder:
    orders = {order.value: order for order in QueueOrder}
    if name not in orders:
        raise ValueError(f"queue {name}, allowed are {', '.join(orders)}")
    return orders[name]


def _bit_ns(bitrate: int) -> int:
    """Length of a bit; ValueError unless it is a whole number of nanoseconds."""
    if not 0 < bitrate <= MAX_BITRATE or 1_000_000_000 % bitrate:
        raise ValueError(
            f"bit rate {bitrate}, allowed are those with a bit of whole nanoseconds up to "
            f"{MAX_BITRATE}"
        )
    return 1_000_000_000 // bitrate
