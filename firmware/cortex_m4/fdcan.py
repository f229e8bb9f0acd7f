"""The CAN FD controller (RM0440, chapter FDCAN): frames in and out, message RAM, bus-off.

A frame takes no time on its bus: the bus of the bench gives it one. What is requested is sent as
the processor has come to rest, so that all transmit buffers can be full; they are a FIFO, or a
queue that sends the lowest identifier first.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import ClassVar, Final, NamedTuple

from meshpoint.dbc.frame import Frame
from meshpoint.firmware.cortex_m4.registers import Peripheral, Register, field

DBTP, CCCR, NBTP, ECR, PSR, TDCR = 0x0C, 0x18, 0x1C, 0x40, 0x44, 0x48
IR, IE, ILS, ILE, RXGFC, RXF0S, RXF0A = 0x50, 0x54, 0x58, 0x5C, 0x80, 0x90, 0x94
TXBC, TXFQS, TXBRP, TXBAR, TXBCR, TXBTO = 0xC0, 0xC4, 0xC8, 0xCC, 0xD0, 0xD4
TXBCF, TXBTIE, CKDIV = 0xD8, 0xDC, 0x100
IS_QUEUE: Final = 1 << 24
"""Of TXBC: TFQM."""
INIT, CCE, FDOE, BRSE = 1, 2, 1 << 8, 1 << 9
BUS_OFF: Final = 1 << 7
RF0N, RF0F, RF0L, TC, TFE, BO = 1, 1 << 1, 1 << 2, 1 << 7, 1 << 9, 1 << 19
GROUPS: Final = (0x7, 0x38, 0x1C0, 0x1E00, 0xE000, 0x30000, 0xFC0000)
"""The bits of IR that each bit of ILS sends to a line: receive FIFO 0 and 1, messages sent,
transmit FIFO, miscellaneous, bits and lines, protocol."""
PROTECTED: Final = (DBTP, NBTP, TDCR, RXGFC, TXBC, CKDIV)
"""Written only while CCCR has INIT and CCE."""
FIFO: Final = 3
RAM: Final = 0x4000_A400
"""That of FDCAN1, at fixed places from here on."""
EXTENDED_FILTERS, RECEIVE_0, TRANSMIT = RAM + 0x070, RAM + 0x0B0, RAM + 0x278
ELEMENT: Final = 72
XTD, RTR, FDF, BRS = 1 << 30, 1 << 29, 1 << 21, 1 << 20
LENGTHS: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Of a frame, by its DLC (ISO 11898-1)."""
NOMINAL_BIT_S, DATA_BIT_S = 500_000, 2_000_000
SAMPLE_POINT: Final = range(75, 89)
"""Per cent of a bit; this bus has 80."""
RECOVERY_US: Final = 129 * 11 * 2
"""Bus-off is left after 129 times 11 recessive bits."""
RANGE, DUAL, CLASSIC = 0, 1, 2
TO_FIFO_0: Final = 1
_HEAD: Final = struct.Struct("<2I")


class MessageRam(NamedTuple):
    """The RAM that processor and controllers share (chapter FDCAN, message RAM), by addresses."""

    load: Callable[[int, int], bytes]
    store: Callable[[int, bytes], None]


class Fdcan(Peripheral):
    """One controller on a bus of 500 kbit/s and 2 Mbit/s."""

    TABLE: ClassVar = {
        0x00: Register("CREL", 0, reset=0x3214_1218),
        0x04: Register("ENDN", 0, reset=0x8765_4321),
        DBTP: Register("DBTP", 0x009F_1FFF, reset=0xA33),
        CCCR: Register("CCCR", 0xF3E7, reset=INIT),
        NBTP: Register("NBTP", 0xFFFF_FF7F, reset=0x0600_0A03),
        ECR: Register("ECR", 0),
        PSR: Register("PSR", 0, reset=0x707),
        TDCR: Register("TDCR", 0x7F7F),
        IR: Register("IR", 0xFF_FFFF),
        IE: Register("IE", 0xFF_FFFF),
        ILS: Register("ILS", 0x7F),
        ILE: Register("ILE", 3),
        RXGFC: Register("RXGFC", 0x0F1F_033F),
        RXF0S: Register("RXF0S", 0),
        RXF0A: Register("RXF0A", 7),
        TXBC: Register("TXBC", IS_QUEUE),
        TXFQS: Register("TXFQS", 0),
        TXBRP: Register("TXBRP", 0),
        TXBAR: Register("TXBAR", 7),
        TXBCR: Register("TXBCR", 7),
        TXBTO: Register("TXBTO", 0),
        TXBCF: Register("TXBCF", 0),
        TXBTIE: Register("TXBTIE", 7),
        CKDIV: Register("CKDIV", 0),
    }

    def __init__(
        self,
        name: str,
        ram: MessageRam,
        clock_hz: Callable[[], int],
        interrupt: Callable[[int, bool], None],
    ) -> None:
        """clock_hz: of the kernel clock. interrupt: line 0 or 1."""
        super().__init__(name)
        self._ram, self._clock_hz, self._interrupt = ram, clock_hz, interrupt
        self._get = self._fill = self._put = self._send = 0
        self.sent: list[Frame] = []
        """What has gone onto the bus; whoever takes it empties it."""
        self.is_bus_dead = False
        """A fault put in: the bus is shorted, and bus-off cannot be left."""
        self.is_alone = False
        """A fault put in: nobody acknowledges, and what is sent is sent again for ever."""
        self.next_us: int | None = None
        """When bus-off is over."""

    @property
    def is_on_bus(self) -> bool:
        """Whether it takes part in traffic."""
        return not self.value[CCCR] & INIT and not self.value[PSR] & BUS_OFF

    def receive(self, frame: Frame) -> None:
        """A frame from the bus, into FIFO 0 where filters let it; lost where that is full."""
        if not self.is_on_bus or not self._is_wanted(frame):
            return
        if self._fill == FIFO:
            self._raise(RF0L)
            return
        place = RECEIVE_0 + ELEMENT * ((self._get + self._fill) % FIFO)
        self._store(place, frame)
        self._fill += 1
        self._raise(RF0N | (RF0F if self._fill == FIFO else 0))

    def transmit(self) -> bool:
        """Sends what is requested, in the order of FIFO or queue; whether there was something."""
        if not self.value[TXBRP] or not self.is_on_bus or self.is_alone:
            return False
        flags = TFE
        while self.value[TXBRP]:
            buffer = self._lowest() if self.value[TXBC] & IS_QUEUE else self._send
            self.sent.append(self._load(TRANSMIT + ELEMENT * buffer))
            self._send = (buffer + 1) % FIFO
            self.value[TXBRP] &= ~(1 << buffer)
            self.value[TXBTO] |= 1 << buffer
            flags |= TC if self.value[TXBTIE] >> buffer & 1 else 0
        self._find_free()
        self._raise(flags)
        return True

    def go_bus_off(self) -> None:
        """Its own errors have taken it off the bus."""
        self.value[PSR] |= BUS_OFF
        self.value[CCCR] |= INIT
        self._raise(BO)

    def step(self, now_us: int) -> None:
        """Bus-off is over, unless the bus is dead."""
        self.next_us = None
        if self.is_bus_dead:
            self.next_us = now_us + RECOVERY_US
            return
        self.value[PSR] &= ~BUS_OFF

    def read(self, offset: int, now_us: int) -> int:
        """The FIFOs' states are worked out as they are read."""
        if offset == RXF0S:
            put = (self._get + self._fill) % FIFO
            return self._fill | self._get << 8 | put << 16 | (self._fill == FIFO) << 24
        if offset == TXFQS:
            free = FIFO - self.value[TXBRP].bit_count()
            if self.value[TXBC] & IS_QUEUE:
                return self._put << 16 | (not free) << 21
            return free | self._send << 8 | self._put << 16 | (not free) << 21
        return super().read(offset, now_us)

    def write(self, offset: int, value: int, now_us: int) -> None:
        """RegisterError: what is protected, or a bit timing of another bus."""
        if offset == IR:
            self.value[IR] &= ~value
        elif offset == CCCR:
            self._control(value, now_us)
        elif offset == RXF0A:
            self._acknowledge(value)
        elif offset == TXBAR:
            self._request(value)
        elif offset == TXBCR:
            self._cancel(value)
        else:
            control = self.value[CCCR]
            if offset in PROTECTED and not (control & INIT and control & CCE):
                raise self.error(offset, "is written while CCCR does not have INIT and CCE")
            super().write(offset, value, now_us)
        self._show()

    def _control(self, value: int, now_us: int) -> None:
        old = self.value[CCCR]
        if value & CCE and not (old | value) & INIT:
            raise self.error(CCCR, "CCE is set while INIT is 0")
        changed = (value ^ old) & ~(INIT | CCE)
        if changed and not (old & INIT and old & CCE):
            raise self.error(CCCR, f"bits 0x{changed:04X} are changed without INIT and CCE")
        super().write(CCCR, value, now_us)
        if value & CCE and not old & CCE:  # the FIFOs begin anew
            self._get = self._fill = self._put = self._send = 0
            self.value[TXBRP] = 0
        if not value & INIT:
            self.value[CCCR] &= ~CCE
            if old & INIT:
                self._check_bits()
                if self.value[PSR] & BUS_OFF:
                    self.next_us = now_us + RECOVERY_US

    def _check_bits(self) -> None:
        """Whether these bits are this bus's."""
        nominal, data = self.value[NBTP], self.value[DBTP]
        self._check_bit(NBTP, NOMINAL_BIT_S, field(nominal, 16, 9), field(nominal, 8, 8),
                        field(nominal, 0, 7))  # fmt: skip
        self._check_bit(DBTP, DATA_BIT_S, field(data, 16, 5), field(data, 8, 5), field(data, 4, 4))

    def _check_bit(self, offset: int, bit_s: int, prescaler: int, before: int, behind: int) -> None:
        quanta = before + behind + 3
        rate = self._clock_hz() / ((prescaler + 1) * quanta)
        sample = 100 * (before + 2) // quanta
        if rate != bit_s or sample not in SAMPLE_POINT:
            raise self.error(
                offset, f"{rate:.0f} bit/s, sampled at {sample} %; this bus has {bit_s} and 80"
            )

    def _request(self, value: int) -> None:
        for buffer in range(FIFO):
            if not value >> buffer & 1:
                continue
            is_next = buffer == self._put or self.value[TXBC] & IS_QUEUE
            if not is_next or self.value[TXBRP] >> buffer & 1:
                raise self.error(TXBAR, f"buffer {buffer} is requested; next is {self._put}, and "
                                        f"TXBRP is {self.value[TXBRP]}")  # fmt: skip
            self.value[TXBRP] |= 1 << buffer
            self.value[TXBTO] &= ~(1 << buffer)
            self.value[TXBCF] &= ~(1 << buffer)
            self._put = (buffer + 1) % FIFO
            self._find_free()

    def _cancel(self, value: int) -> None:
        if not self.value[TXBC] & IS_QUEUE:
            raise self.error(TXBCR, "is written while TXBC.TFQM is 0: a FIFO is not for that")
        if self.value[CCCR] & CCE:
            raise self.error(TXBCR, "is written while CCCR has CCE")
        self.value[TXBCF] |= self.value[TXBRP] & value
        self.value[TXBRP] &= ~value
        self._find_free()

    def _find_free(self) -> None:
        """A queue is filled where the first buffer is free."""
        if self.value[TXBC] & IS_QUEUE:
            free = [i for i in range(FIFO) if not self.value[TXBRP] >> i & 1]
            self._put = free[0] if free else 0

    def _lowest(self) -> int:
        """The buffer whose frame is first by its identifier, of equal ones the lower buffer."""
        pending = [i for i in range(FIFO) if self.value[TXBRP] >> i & 1]
        return min(pending, key=lambda i: (self._load(TRANSMIT + ELEMENT * i).can_id, i))

    def _acknowledge(self, index: int) -> None:
        """Gives back all elements up to this one."""
        count = (index - self._get) % FIFO + 1
        if index >= FIFO or count > self._fill:
            raise self.error(RXF0A, f"element {index} is given back, of {self._fill} from "
                                    f"{self._get} on")  # fmt: skip
        self._get, self._fill = (self._get + count) % FIFO, self._fill - count

    def _is_wanted(self, frame: Frame) -> bool:
        settings = self.value[RXGFC]
        if not frame.is_extended:
            if field(settings, 16, 5):
                raise self.error(RXGFC, "filters of 11 bits are not modelled")
            return field(settings, 4, 2) == 0
        for i in range(field(settings, 24, 4)):
            first, second = _HEAD.unpack(
                self._ram.load(EXTENDED_FILTERS + _HEAD.size * i, _HEAD.size)
            )
            if first >> 29 and _matches(first & 0x1FFF_FFFF, second, frame.can_id):
                return bool(first >> 29 == TO_FIFO_0)
        return field(settings, 2, 2) == 0

    def _store(self, place: int, frame: Frame) -> None:
        """As an element of a receive FIFO; the controller fills up to the length of a DLC."""
        code = next(i for i, length in enumerate(LENGTHS) if length >= len(frame.data))
        identifier = frame.can_id | XTD if frame.is_extended else frame.can_id << 18
        formats = (FDF | BRS) if frame.is_fd else 0
        data = frame.data.ljust(LENGTHS[code], b"\0")
        self._ram.store(place, _HEAD.pack(identifier, code << 16 | formats) + data)

    def _load(self, place: int) -> Frame:
        """An element of the transmit FIFO."""
        element = self._ram.load(place, ELEMENT)
        identifier, control = _HEAD.unpack_from(element)
        is_fd = bool(control & FDF and self.value[CCCR] & FDOE)
        length = LENGTHS[min(field(control, 16, 4), 15 if is_fd else 8)]
        is_extended = bool(identifier & XTD)
        if identifier & RTR or is_fd != bool(control & BRS and self.value[CCCR] & BRSE):
            raise self.error(TXBAR, f"a frame of 0x{identifier:08X}, 0x{control:08X}: remote, or "
                                    "CAN FD without the bit rate switch of this bus")  # fmt: skip
        can_id = identifier & 0x1FFF_FFFF if is_extended else identifier >> 18 & 0x7FF
        data = element[_HEAD.size : _HEAD.size + length]
        return Frame(can_id, data, is_fd, is_extended)

    def _raise(self, flags: int) -> None:
        self.value[IR] |= flags
        self._show()

    def _show(self) -> None:
        """Sets both interrupt lines."""
        active = self.value[IR] & self.value[IE]
        second = sum(group for i, group in enumerate(GROUPS) if self.value[ILS] >> i & 1)
        self._interrupt(0, bool(active & ~second and self.value[ILE] & 1))
        self._interrupt(1, bool(active & second and self.value[ILE] & 2))


def _matches(first: int, second: int, can_id: int) -> bool:
    """An extended filter: a range, two identifiers, or one with a mask."""
    kind, second = second >> 30, second & 0x1FFF_FFFF
    if kind == DUAL:
        return can_id in (first, second)
    if kind == CLASSIC:
        return (can_id ^ first) & second == 0
    return first <= can_id <= second
