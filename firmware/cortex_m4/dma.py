"""DMA and its request multiplexer (RM0440, chapters DMA and DMAMUX), peripheral to memory alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import ClassVar, Final

from meshpoint.firmware.cortex_m4.registers import Peripheral, Register, field

ISR, IFCR = 0x00, 0x04
CCR, CNDTR, CPAR, CMAR = 0x08, 0x0C, 0x10, 0x14
STRIDE: Final = 0x14
CHANNELS: Final = 8
EN, TCIE, HTIE, TEIE = 1, 1 << 1, 1 << 2, 1 << 3
DIR, CIRC, PINC, MINC, MEM2MEM = 1 << 4, 1 << 5, 1 << 6, 1 << 7, 1 << 14
GLOBAL, COMPLETE, HALF = 1, 2, 4
ERROR: Final = 8


class Dmamux(Peripheral):
    """Which request each channel serves: DMA1 has the first eight channels, DMA2 the others."""

    TABLE: ClassVar = {
        **{4 * i: Register(f"C{i}CR", 0x7F) for i in range(2 * CHANNELS)},
        0x80: Register("CSR", 0),
        0x84: Register("CFR", 0xFFFF),
    }

    def channels(self, request: int) -> list[int]:
        """The channels that serve a request, counted over both controllers."""
        return [i for i in range(2 * CHANNELS) if self.value[4 * i] == request]


def _channels() -> dict[int, Register]:
    table = {ISR: Register("ISR", 0), IFCR: Register("IFCR")}
    for i in range(CHANNELS):
        names = ((CCR, "CCR", 0x7FFF), (CNDTR, "CNDTR", 0xFFFF), (CPAR, "CPAR", 0xFFFF_FFFF),
                 (CMAR, "CMAR", 0xFFFF_FFFF))  # fmt: skip
        table |= {at + STRIDE * i: Register(f"{name}{i + 1}", mask) for at, name, mask in names}
    return table


class Dma(Peripheral):
    """One controller of eight channels."""

    TABLE: ClassVar = _channels()

    def __init__(
        self,
        name: str,
        load: Callable[[int], int],
        store: Callable[[int, bytes], None],
        interrupt: Callable[[int, bool], None],
    ) -> None:
        """load: reads a register. store: writes to memory. interrupt: a channel's line, counted
        from 0."""
        super().__init__(name)
        self._load, self._store, self._interrupt = load, store, interrupt
        self._count = [0] * CHANNELS  # what CNDTR was as the channel was enabled

    def write(self, offset: int, value: int, now_us: int) -> None:
        """RegisterError where a channel that is enabled would be changed."""
        if offset == IFCR:
            for channel in range(CHANNELS):
                cleared = value >> 4 * channel & 0xF
                cleared = 0xF if cleared & GLOBAL else cleared
                self.value[ISR] &= ~(cleared << 4 * channel)
                self._show(channel)
            return
        channel = (offset - CCR) // STRIDE
        place = offset - STRIDE * channel
        control = CCR + STRIDE * channel
        if offset == ISR or offset not in self.TABLE:
            super().write(offset, value, now_us)
            return
        is_enabled = self.value[control] & EN
        if is_enabled and (place != CCR or (value ^ self.value[control]) & ~0xF):
            raise self.error(offset, f"is written while CCR{channel + 1}.EN is 1")
        super().write(offset, value, now_us)
        if place == CCR and value & EN and not is_enabled:
            self._enable(channel)
        if place == CCR:
            self._show(channel)

    def take(self, channel: int, address: int, values: Sequence[int]) -> bool:
        """A peripheral's request for each value of its register; whether the channel is on."""
        base = STRIDE * channel
        control = self.value[CCR + base]
        if not control & EN or not self.value[CNDTR + base]:
            return False
        if self.value[CPAR + base] != address:
            raise self.error(CPAR + base, f"0x{self.value[CPAR + base]:08X}, and the request is of "
                                          f"the register at 0x{address:08X}")  # fmt: skip
        size = 1 << field(control, 10, 2)
        mask = (1 << 8 * min(size, 1 << field(control, 8, 2))) - 1
        content = b"".join((value & mask).to_bytes(size, "little") for value in values)
        while content:
            left, count = self.value[CNDTR + base], self._count[channel]
            if not left:
                break
            half = count - count // 2
            until = left - half if left > half else left
            part, content = content[: until * size], content[until * size :]
            self._store(self.value[CMAR + base] + (count - left) * size, part)
            left -= len(part) // size
            if left == half or not left:
                flag = COMPLETE if not left else HALF
                self.value[ISR] |= (flag | GLOBAL) << 4 * channel
            self.value[CNDTR + base] = count if not left and control & CIRC else left
        self._show(channel)
        return True

    def fetch(self, channel: int) -> None:
        """A request of no register's: what the channel's own address reads is taken."""
        base = STRIDE * channel
        if self.value[CCR + base] & EN:
            address = self.value[CPAR + base]
            self.take(channel, address, [self._load(address)])

    def _enable(self, channel: int) -> None:
        base = STRIDE * channel
        control = self.value[CCR + base]
        if control & (DIR | PINC | MEM2MEM) or not control & MINC:
            raise self.error(CCR + base, f"0x{control:08X}: only from one register to memory that "
                                         "goes on is modelled")  # fmt: skip
        self._count[channel] = self.value[CNDTR + base]

    def _show(self, channel: int) -> None:
        """Sets the channel's interrupt line: the enable bits lie where the flags do."""
        enabled = self.value[CCR + STRIDE * channel] & (TCIE | HTIE | TEIE)
        self._interrupt(channel, bool(self.value[ISR] >> 4 * channel & enabled))
