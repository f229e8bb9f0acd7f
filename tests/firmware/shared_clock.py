"""A sensor board and a valve board with a clock each, a wire between them, and the bus."""

from __future__ import annotations

from firmware_bench import AT_REST, BY_ID, WRAP, CommandBench

from meshpoint.dbc.frame import Frame
from meshpoint.firmware.native_board import NativeBoard

READ_US = 10_000
MILLION = 1_000_000


class TwoBoards(CommandBench):
    """The valve board is the one that is commanded, in the sensor board's clock. Its own one runs
    faster by `drift_ppm`, and starts elsewhere."""

    def __init__(self, sensor: NativeBoard, valve: NativeBoard, drift_ppm: int = 100) -> None:
        self.sensor = sensor
        self.drift_ppm = drift_ppm
        self.is_wired = self.is_sending = True
        self.late_us = 4_000
        """From a pulse until GearboxSensors has come."""
        self._passed_us = self._owed = 0
        self._read_us = READ_US
        self._on_bus: list[tuple[int, Frame]] = []
        sensor.power_on(WRAP - 200_000)
        super().__init__(valve)

    def be_heard(self) -> None:
        """As a bench with one board; wire and bus are whole, and have been for a while."""
        self.is_wired = self.is_sending = True
        self.late_us = 4_000
        self._on_bus.clear()
        self.wait(80_000)
        super().be_heard()

    @property
    def now_us(self) -> int:
        return self.sensor.memory.sensor_us

    @property
    def wrong_us(self) -> int:
        """By how much the valve board's sensor clock goes before the sensor board's."""
        return (self.memory.sensor_us - self.now_us + WRAP // 2) % WRAP - WRAP // 2

    def pulse(self) -> None:
        """An edge on the wire: the sensor board's, or a disturbance."""
        self.board.capture(0, [self.memory.sensor_us])

    def wait(self, for_us: int) -> None:
        end_us = self._passed_us + for_us
        while True:
            next_us = min([end_us, self._read_us, *(due_us for due_us, _ in self._on_bus)])
            self._go_on(next_us - self._passed_us)
            if next_us == self._read_us:
                self._read()
            for due in [due for due in self._on_bus if due[0] == next_us]:
                self._on_bus.remove(due)
                self.board.receive(due[1])
            if next_us == end_us:
                return

    def _go_on(self, for_us: int) -> None:
        self._passed_us += for_us
        self.sensor.advance(for_us)
        self._owed += for_us * (MILLION + self.drift_ppm)
        self.board.advance(self._owed // MILLION)
        self._owed %= MILLION

    def _read(self) -> None:
        self._read_us += READ_US
        before = self.sensor.memory.pulse_count
        self.sensor.memory.is_sending = bool(self._on_bus)
        self.sensor.read(AT_REST)
        if self.is_wired and self.sensor.memory.pulse_count != before:
            self.pulse()
        for frame in self.sensor.take_sent():
            if self.is_sending and BY_ID[frame.can_id].spec.name == "GearboxSensors":
                self._on_bus.append((self._passed_us + self.late_us, frame))
