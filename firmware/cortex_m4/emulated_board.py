"""The board with its linked image: a chip, a processor, and what is at its pins (docs/firmware.md).

Pins are those of docs/bench.md. Edges and scans of a cycle come at its read, when the rig has them.
In the loop code and conversions take no time; a board that `takes_time` has them take theirs.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from typing import Final

from meshpoint.dbc.frame import Frame
from meshpoint.firmware.board import Analogue, Failure
from meshpoint.firmware.cortex_m4.chip import PAGES, Chip, Outside
from meshpoint.firmware.cortex_m4.iwdg import LSI_HZ
from meshpoint.firmware.cortex_m4.processor import Processor
from meshpoint.firmware.cortex_m4.rcc import BROWN_OUT_RESET, PIN_RESET
from meshpoint.firmware.cortex_m4.registers import WORD
from meshpoint.firmware.elf import segments

US_PER_S: Final = 1_000_000
SENSOR_CLOCK: Final = ("TIM2", "TIM3")
WHEELS: Final = (("A", 0), ("B", 10), ("A", 6), ("B", 0))
WHEEL_LEVELS: Final = (("A", 7), ("C", 4), ("C", 5), ("A", 4))
SLEEVES: Final = (("C", 0), ("C", 1), ("C", 2), ("C", 3))
SLOW: Final = (("B", 1), ("B", 11), ("B", 12), ("A", 1))
VALVES: Final = (*(("C", pin) for pin in range(6, 13)), ("B", 13), ("B", 14))
CLUTCH: Final = ("B", 15)
SOURCES_OHM: Final = dict.fromkeys((*SLEEVES, *SLOW), 1_000) | dict.fromkeys(WHEEL_LEVELS, 2_200)
"""What lies before each analogue pin at the most."""
RANGES: Final = ((0, 50_000), (0, 50_000), (4_000, 30_000), (0, 10_000))
SLEEVE_RANGE: Final = (-20_000, 20_000)
"""Of each transmitter in steps of the wire, over 10 to 90 % of full scale."""
LOWEST, HIGHEST, FULL = 6_552, 58_968, 65_520
BROKEN: Final = 0
PAIRS: Final = 0xAA
"""The lower valve of each sleeve's two."""
AWAY_US: Final = 1_000_000
"""Longer than the board sleeps: no output will be switched before."""


class EmulatedBoard:
    """As `Board`. CommandError where the image uses a register as it must not be used."""

    def __init__(
        self, elf: bytes, *, is_free: bool = False, takes_time: bool = False, lsi_hz: int = LSI_HZ
    ) -> None:
        """elf: the image. is_free: TIM6 triggers the scans as it comes round, and not `read`, and
        each instruction is counted. takes_time: the same, and instructions take their cycles, at
        the most that they can be, and conversions their time. lsi_hz: of the watchdog's
        oscillator."""
        is_free = is_free or takes_time
        self.processor = Processor(
            segments(elf), PAGES, counts=is_free, spend=self._spend if takes_time else None
        )
        self.is_on = False
        self.resets = self.coils_together = self.own_us = self.driven = 0
        self.clutch: bool | None = None
        self.changes: list[tuple[int, int]] = []
        """Own time in us and the valves driven, as they were switched."""
        self.outputs: list[tuple[int, tuple[str, int], bool]] = []
        """As timers have switched pins: own time in us, port and pin, level."""
        self.voltages = dict.fromkeys(WHEEL_LEVELS, LOWEST) | dict.fromkeys(
            (*SLEEVES, *SLOW), (LOWEST + HIGHEST) // 2
        )
        """At port and pin, 65,520 is full scale; good ones."""
        self._preset = 0
        self._is_bus_dead = False
        self._edges: deque[tuple[int, int]] = deque()
        self._until_us = self._cycles = 0  # the processor may run so long; what is left of a us
        self._outside = Outside(
            self.processor.read_memory, self.processor.write_memory, self.voltages,
            self._on_output, self._on_timer, is_free, takes_time, lsi_hz, SOURCES_OHM,
        )  # fmt: skip
        self.chip = Chip(self._outside, 0, PIN_RESET | BROWN_OUT_RESET)

    def power_on(self, sensor_us: int) -> None:
        """Starts it, or resets it; the sensor clock shows this as its timer begins."""
        self.is_on = True
        self._preset = sensor_us
        self._reset(PIN_RESET | BROWN_OUT_RESET)

    @property
    def sensor_us(self) -> int:
        """Its sensor clock, TIM2."""
        return self.chip.timers["TIM2"].count(self.own_us)

    def set_sensor_us(self, sensor_us: int) -> None:
        """TIM2 shows this now, and TIM3 its lower half."""
        if self.sensor_us != sensor_us & WORD:
            for name in SENSOR_CLOCK:
                self.chip.timers[name].show(sensor_us, self.own_us)

    def advance(self, for_us: int) -> None:
        """Idle time is skipped to the next event."""
        self._until_us = end_us = self.own_us + for_us
        self._run()  # what time has ended in the middle of
        while (at_us := self.chip.next_us) is not None and at_us <= end_us:
            self._go_to(max(at_us, self.own_us))
            self.chip.step()
            self._run()
        self._go_to(max(end_us, self.own_us))

    def _come(self) -> None:
        """The edges that are due, each at what its timer counted then."""
        while self._edges and self._edges[0][0] <= self.own_us:
            at_us, channel = self._edges.popleft()
            self.capture(channel, [self.chip.timers["TIM2"].count(at_us)])

    def receive(self, frame: Frame) -> None:
        """Into the CAN controller, where its pins are set up."""
        if self.chip.has_can:
            self.chip.fdcan.receive(frame)
            self._run()

    def capture(self, channel: int, stamps_us: Sequence[int]) -> None:
        """Through the timer that captures them, at these counts."""
        self.chip.edges(WHEELS[channel // 2], rising=channel % 2 == 0, counts=stamps_us)

    def pulse(self, channel: int, at_us: Iterable[int]) -> None:
        """Edges of a channel that come at these own times, which lie ahead."""
        self._edges = deque(sorted((*self._edges, *((each, channel) for each in at_us))))

    def read(self, analogue: Analogue) -> None:
        """Ten scans, the oldest first, each by a trigger of the ADCs."""
        for pin, value, (low, high) in zip(SLOW, analogue.slow, RANGES, strict=True):
            self.voltages[pin] = _voltage(value, low, high)
        for samples in zip(*(reversed(each) for each in analogue.sleeves), strict=True):
            for place, um in enumerate(samples):
                is_bad = analogue.bad_sleeves >> place & 1
                self.voltages[SLEEVES[place]] = BROKEN if is_bad else _voltage(um, *SLEEVE_RANGE)
            self.chip.scan(self.own_us - self.chip.adcs["ADC1"].middle_us(SLEEVES))
        self._run()

    def take_sent(self) -> list[Frame]:
        """What its CAN controller has sent."""
        sent, self.chip.fdcan.sent = self.chip.fdcan.sent, []
        return sent

    @property
    def wake_us(self) -> int:
        """Until TIM5 comes to a time that was set: both clocks' times are in it."""
        at_us = self.chip.timers["TIM5"].next_us
        return AWAY_US if at_us is None else at_us - self.own_us

    def fail(self, failure: Failure) -> None:
        """As on silicon where it can be: the bus is shorted, an instruction is none."""
        if failure is Failure.BUS_OFF:
            self._is_bus_dead = self.chip.fdcan.is_bus_dead = True
            self.chip.fdcan.go_bus_off()
            self._run()
        elif failure is Failure.STUCK:
            self.processor.stick(True)
        elif failure is Failure.DEAF:
            self.chip.nvic.is_deaf = True
        else:
            self.processor.fault()
            self._run()

    def mend(self) -> None:
        """The bus is whole, and main loop and interrupts go on."""
        self._is_bus_dead = self.chip.fdcan.is_bus_dead = False
        self.chip.nvic.is_deaf = False
        self.processor.stick(False)
        self._run()

    def _reset(self, why: int) -> None:
        """All registers begin anew, and outputs are inputs; memories keep what they have."""
        self.chip = Chip(self._outside, self.own_us, why)
        self.chip.fdcan.is_bus_dead = self._is_bus_dead
        for name in SENSOR_CLOCK:
            self.chip.timers[name].preset = self._preset
        self._on_output("C", 0)
        self.processor.reset(self.chip)
        self._run()
        self.clutch = None  # what was written while it started is no command

    def _go_to(self, now_us: int) -> None:
        self.own_us = self.chip.now_us = now_us
        if self._edges:
            self._come()

    def _spend(self, cycles: int) -> bool:
        """The processor takes time; whether what there was of it is over."""
        self._cycles += cycles
        per_us = self.chip.rcc.hclk_hz // US_PER_S
        while self._cycles >= per_us:
            self._cycles -= per_us
            self._go_to(self.own_us + 1)
            self.chip.step()
        return self.own_us >= self._until_us

    def _run(self) -> None:
        """Lets the processor do what there is, and the CAN controller send, until both rest."""
        self.processor.run()
        while not self.chip.reset_by and self.chip.fdcan.transmit():
            self.processor.run()
        if self.chip.reset_by:
            self.resets += 1
            self._preset = 0  # the timer begins anew, and nobody has set it
            self._reset(self.chip.reset_by)

    def _on_output(self, port: str, written: int) -> None:
        """A port's output register was written."""
        ports = self.chip.ports
        levels = {name: ports[name].driven for name in ("B", "C")}
        if port == CLUTCH[0] and (written | written >> 16) >> CLUTCH[1] & 1:
            self.clutch = bool(levels["B"] >> CLUTCH[1] & 1)
        driven = sum((levels[name] >> pin & 1) << i for i, (name, pin) in enumerate(VALVES))
        if driven != self.driven:
            self.driven = driven
            self.changes.append((self.own_us, driven))
            self.coils_together += bool(driven & driven >> 1 & PAIRS)

    def _on_timer(self, pin: tuple[str, int], is_high: bool, at_us: int) -> None:
        self.outputs.append((at_us, pin, is_high))


def _voltage(value: int, low: int, high: int) -> int:
    """Of a transmitter that shows this, as the ADC's step nearest to it."""
    span = HIGHEST - LOWEST
    voltage = LOWEST + (2 * (value - low) * span + high - low) // (2 * (high - low))
    return min(max(voltage, 0), FULL)
