"""The sensor side's reads, and the engine: packed for a classic bus, and unpacked from it."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, Final

from meshpoint.bus.classic.edges import (
    INDEX_WRAP,
    LOW,
    READ_INDEX_WRAP,
    STAMPS,
    EdgeArray,
    EdgeReport,
    EdgeSender,
    SpeedWheel,
)
from meshpoint.bus.classic.inner import InnerChannel
from meshpoint.dbc.classic.codecs import (
    CLASSIC_CODECS,
    LENGTH,
    ClassicEar,
    ClassicSender,
    Heard,
    Hearing,
    plain_frame,
)
from meshpoint.dbc.classic.contract import (
    AUX_CYCLE_MS,
    ENGINE_CYCLE_MS,
    READ_CYCLE_MS,
    SLOW_CYCLE_MS,
    SPEEDS_CYCLE_MS,
)
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import (
    EEC1,
    GearboxSensors,
    SleevesAux,
    SleevesMain,
    ValveStatus,
)
from meshpoint.gearbox import GearboxSheet
from meshpoint.units import TURN

MOST_BRAKE_PA: Final = 4095 * 320.0
HALF_READ: Final = 5
"""Of the ten samples of a position, 1 ms apart, the second one that is sent."""
SAMPLES: Final = 10
MEASURED_US: Final = 15_000
"""A speed is taken over the newest edges of at least this time, as far as there are some."""
SPEED_HELD_US: Final = 3 * SPEEDS_CYCLE_MS * 1000
"""A speed heard longer ago than this is none."""
STATUS_FLAGS: Final = 18
COUNT_WRAP: Final = 16
LAYSHAFT, MAIN, INPUT, PROPELLER = (
    "EdgesLayshaftRise", "EdgesMainRise", "EdgesInputRise", "EdgesPropellerRise",
)  # fmt: skip


def edges_per_us(read: EdgeReport) -> float | None:
    """The speed that an array of edges shows, in edges a microsecond; None where it shows none, 0
    where the wheel stands."""
    if read.sensor_fault:
        return None
    if read.stopped:
        return 0.0
    lows, span_us, count = read.timestamp_low_us[: read.valid_stamps], 0, 0
    for newer, older in itertools.pairwise(lows):
        span_us += (newer - older) & LOW
        count += 1
        if span_us >= MEASURED_US:
            break
    return count / span_us if span_us and not read.long_interval else None


def coarser(value: float, step: float, steps: int) -> float:
    """A value that is whole steps, in whole numbers of `steps` of them; halves go up, as a board
    does it that has no floating point."""
    return (round(value / step) + steps // 2) // steps * (steps * step)


class SensorSender:
    """Packs a read of the rig, or of a sensor ECU, into classic frames."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._teeth = (sheet.wheels.input_.teeth, sheet.wheels.propeller.teeth)
        names = (
            "SensorRead", "EdgesLayshaft", "EdgesMain", "GearboxState", "SleevesMainShort",
            "SleevesAuxShort", "SlowSensors",
        )  # fmt: skip
        self._senders = {name: ClassicSender(name) for name in names}
        self._wheels = {
            LAYSHAFT: EdgeSender(self._senders["EdgesLayshaft"].message_type),
            MAIN: EdgeSender(self._senders["EdgesMain"].message_type),
        }
        self._reads = 0

    def pack(self, messages: dict[str, Any]) -> list[Frame]:
        """The frames of a read; messages: those of meshpoint.dbc, by name. What is not among them,
        as when the gearbox's node is away, is not sent."""
        self._reads += 1
        engine = self._engine(messages)
        if LAYSHAFT not in messages or "GearboxSensors" not in messages:
            return engine
        return [*self._edges(messages), *self._slow(messages), *self._state(messages), *engine]

    def restart(self) -> None:
        """The gearbox's node has been switched on anew: its counters begin again."""
        for name in self._senders:
            self._senders[name] = ClassicSender(name)

    def _frame(self, name: str, *values: Any) -> Frame:
        sender = self._senders[name]
        return sender.frame(sender.message_type(*values))

    def _is_due(self, cycle_ms: int) -> bool:
        return self._reads % (cycle_ms // READ_CYCLE_MS) == 0

    def _edges(self, messages: dict[str, Any]) -> list[Frame]:
        cut: dict[str, list[Any]] = {}
        for name, wheel in self._wheels.items():
            cut[name] = list(wheel.cut(EdgeReport._make(messages[name])))
        layshaft, main = messages[LAYSHAFT], messages[MAIN]
        first = self._frame(
            "SensorRead",
            layshaft.read_time_us,
            *(wheel.index % READ_INDEX_WRAP for wheel in self._wheels.values()),
            layshaft.stopped, main.stopped, layshaft.sensor_fault, main.sensor_fault,
        )  # fmt: skip
        frames = [first]
        for name, edges in (("EdgesLayshaft", LAYSHAFT), ("EdgesMain", MAIN)):
            frames += [self._senders[name].frame(message) for message in cut[edges]]
        return frames

    def _state(self, messages: dict[str, Any]) -> list[Frame]:
        """The rest of a read, behind its edges: whoever hears this has heard them all."""
        read = self._senders["SensorRead"].counter
        sensors: GearboxSensors = messages["GearboxSensors"]
        status: ValveStatus = messages["ValveStatus"]
        state = self._frame(
            "GearboxState",
            read,
            min(coarser(sensors.brake_pressure_pa, 20.0, 16), MOST_BRAKE_PA),
            coarser(sensors.clutch_position_fraction, 1e-4, 10),
            *status[1 : 1 + STATUS_FLAGS],
            status.refused_count % COUNT_WRAP,
            status.expired_count % COUNT_WRAP,
        )
        main: SleevesMain = messages["SleevesMain"]
        frames = [
            state,
            self._sleeves(
                "SleevesMainShort", main.sensor_fault, main.sleeve_first_second_m,
                main.sleeve_crawl_third_m,
            ),
        ]  # fmt: skip
        if self._is_due(AUX_CYCLE_MS):
            aux: SleevesAux = messages["SleevesAux"]
            frames.append(
                self._sleeves(
                    "SleevesAuxShort", aux.sensor_fault, aux.sleeve_splitter_m, aux.sleeve_range_m
                )
            )
        return frames

    def _sleeves(self, name: str, fault: int, *samples: tuple[float, ...]) -> Frame:
        read = self._senders["SensorRead"].counter
        pairs = [[coarser(row[k], 1e-6, 10) for k in (0, HALF_READ)] for row in samples]
        return self._frame(name, read % 4, fault, *pairs)

    def _slow(self, messages: dict[str, Any]) -> list[Frame]:
        frames: list[Frame] = []
        if self._is_due(SPEEDS_CYCLE_MS):
            frames.append(self._speeds(messages))
        if self._is_due(SLOW_CYCLE_MS):
            sensors = messages["GearboxSensors"]
            frames.append(
                self._frame("SlowSensors", sensors.supply_pressure_pa, sensors.oil_temperature_k)
            )
        return frames

    def _speeds(self, messages: dict[str, Any]) -> Frame:
        speeds = []
        for name, teeth in zip((INPUT, PROPELLER), self._teeth, strict=True):
            rate = edges_per_us(EdgeReport._make(messages[name]))
            speeds.append(None if rate is None else rate * 1e6 * TURN / teeth)
        message = CLASSIC_CODECS["ETC1"].message_type(
            input_shaft_speed_rad_s=speeds[0], output_shaft_speed_rad_s=speeds[1]
        )
        return plain_frame("ETC1", message)

    def _engine(self, messages: dict[str, Any]) -> list[Frame]:
        message: EEC1 | None = messages.get("EEC1")
        if message is None or not self._is_due(ENGINE_CYCLE_MS):
            return []
        return [plain_frame("EEC1", message)]


class SensorIntake:
    """Makes a read's messages of meshpoint.dbc again from classic frames."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._teeth = (sheet.wheels.input_.teeth, sheet.wheels.propeller.teeth)
        ears = (
            ("SensorRead", self._read), ("EdgesLayshaft", self._layshaft),
            ("EdgesMain", self._main), ("GearboxState", self._state),
            ("SleevesMainShort", self._sleeves_main), ("SleevesAuxShort", self._sleeves_aux),
            ("SlowSensors", self._slow),
        )  # fmt: skip
        self._ears: dict[int, tuple[ClassicEar, Callable[[Hearing], list[Frame]]]] = {}
        for name, heard in ears:
            ear = ClassicEar(name)
            self._ears[ear.can_id] = (ear, heard)
        self._speeds_id = CLASSIC_CODECS["ETC1"].spec.can_id
        self.ids: Final = frozenset({*self._ears, self._speeds_id})
        """The identifiers that this takes."""
        self._out = {
            name: InnerChannel(name)
            for name in (
                INPUT, LAYSHAFT, MAIN, PROPELLER, "GearboxSensors", "SleevesMain", "SleevesAux",
                "ValveStatus",
            )
        }  # fmt: skip
        self._arrays = {LAYSHAFT: EdgeArray(), MAIN: EdgeArray()}
        self._astray = dict.fromkeys(self._arrays, 0)
        """Reads in a row that did not go up to where they should."""
        self._wheels = {INPUT: SpeedWheel(), PROPELLER: SpeedWheel()}
        self._speeds: tuple[float | None, float | None] = (None, None)
        self._speeds_at: int | None = None
        self._opened: Any = None
        """The newest SensorRead, with its counter and the steps of it."""
        self._counter = 0
        self._waits: dict[str, int] = {}
        """Edge messages of this read that are not complete yet: the steps of their counters."""
        self._before: dict[str, tuple[int, tuple[float, ...]]] = {}
        """Of SleevesMain and SleevesAux: time and newest positions of the frame before."""
        self._slow_values: tuple[float, float] | None = None

    @property
    def filled(self) -> int:
        """Edges lost with a frame that were put between their neighbours."""
        return sum(array.filled for array in self._arrays.values())

    def take(self, frame: Frame) -> list[Frame]:
        """What a classic frame of `ids` comes to for the core: nothing yet, or some frames."""
        if frame.can_id == self._speeds_id:
            self._hear_speeds(frame)
            return []
        ear, heard = self._ears[frame.can_id]
        return heard(ear.hear(frame))

    def _hear_speeds(self, frame: Frame) -> None:
        if frame.is_fd or len(frame.data) != LENGTH or self._opened is None:
            return
        message = CLASSIC_CODECS["ETC1"].decode(frame.data)
        speeds = (message.input_shaft_speed_rad_s, message.output_shaft_speed_rad_s)
        self._speeds, self._speeds_at = speeds, self._opened.read_time_us

    def _read(self, hearing: Hearing) -> list[Frame]:
        frames = self._close()
        if hearing.heard is not Heard.OK:
            return frames + self._refused(hearing, LAYSHAFT, MAIN)
        self._opened, self._counter = hearing.message, hearing.counter
        frames += self._made_up()
        self._waits = dict.fromkeys(self._arrays, hearing.steps)
        return frames + self._complete()

    def _refused(self, hearing: Hearing, *names: str) -> list[Frame]:
        if hearing.heard is Heard.REPEATED:
            return [frame for name in names for frame in self._out[name].again()]
        return [self._out[name].damaged() for name in names]

    def _made_up(self) -> list[Frame]:
        """Input and propeller shaft, from their speeds; nothing where none is heard."""
        if self._speeds_at is None:
            return []
        read_us = self._opened.read_time_us
        if (read_us - self._speeds_at) % (1 << 32) > SPEED_HELD_US:
            return []
        frames = []
        for name, speed, teeth in zip(self._wheels, self._speeds, self._teeth, strict=True):
            if speed is not None:
                report = self._wheels[name].report(read_us, speed * teeth / TURN / 1e6)
                frames.append(self._inner(name, report, 1))
        return frames

    def _inner(self, name: str, report: EdgeReport, steps: int) -> Frame:
        return self._out[name].frame(CODECS[name].message_type._make(report), steps)

    def _targets(self) -> dict[str, tuple[int, bool, bool]]:
        read = self._opened
        return {
            LAYSHAFT: (read.layshaft_index, read.layshaft_stopped, read.layshaft_sensor_fault),
            MAIN: (read.main_index, read.main_stopped, read.main_sensor_fault),
        }

    def _complete(self) -> list[Frame]:
        """The edge messages of this read that are complete by now."""
        frames = []
        for name, (target, stopped, fault) in self._targets().items():
            array = self._arrays[name]
            if name in self._waits and array.is_up_to(target):
                self._astray[name] = 0
                report = array.report(self._opened.read_time_us, stopped, fault)
                frames.append(self._inner(name, report, self._waits.pop(name)))
        return frames

    def _close(self) -> list[Frame]:
        """The others, as far as they have come: what is missing was lost, or was never sent."""
        if self._opened is None:
            return []
        frames = []
        for name, (_, stopped, fault) in self._targets().items():
            if name not in self._waits:
                continue
            self._astray[name] += 1
            array = self._arrays[name]
            if self._astray[name] > 1:
                array.restart()
            report = array.report(self._opened.read_time_us, stopped, fault)
            frames.append(self._inner(name, report, self._waits.pop(name)))
        return frames

    def _layshaft(self, hearing: Hearing) -> list[Frame]:
        return self._edges(LAYSHAFT, hearing)

    def _main(self, hearing: Hearing) -> list[Frame]:
        return self._edges(MAIN, hearing)

    def _edges(self, name: str, hearing: Hearing) -> list[Frame]:
        if hearing.heard is Heard.DAMAGED:
            return [self._out[name].damaged()]
        if hearing.heard is Heard.REPEATED or self._opened is None:
            return []
        target = self._targets()[name][0]
        self._arrays[name].take(hearing.message, hearing.steps, self._opened.read_time_us, target)
        return self._complete()

    def _state(self, hearing: Hearing) -> list[Frame]:
        frames = self._close()
        names = ("GearboxSensors", "ValveStatus")
        if hearing.heard is not Heard.OK:
            return frames + self._refused(hearing, *names)
        message = hearing.message
        if self._opened is None or message.read != self._counter:
            return frames  # its SensorRead was lost: nobody knows when this was
        at_us, (_, brake_pa, clutch, *flags, refused, expired) = self._opened.read_time_us, message
        if self._slow_values is not None:
            sensors = GearboxSensors(at_us, brake_pa, *self._slow_values, clutch)
            frames.append(self._out["GearboxSensors"].frame(sensors, hearing.steps))
        status = ValveStatus._make((at_us, *flags, refused, expired))
        frames.append(self._out["ValveStatus"].frame(status, hearing.steps))
        return frames

    def _sleeves_main(self, hearing: Hearing) -> list[Frame]:
        return self._sleeves("SleevesMain", READ_CYCLE_MS, hearing)

    def _sleeves_aux(self, hearing: Hearing) -> list[Frame]:
        return self._sleeves("SleevesAux", AUX_CYCLE_MS, hearing)

    def _sleeves(self, name: str, cycle_ms: int, hearing: Hearing) -> list[Frame]:
        if hearing.heard is not Heard.OK:
            return self._refused(hearing, name)
        read, fault, *pairs = hearing.message
        if self._opened is None or read != self._counter % 4:
            return []
        at_us = self._opened.read_time_us
        before_us, before = self._before.get(name, (at_us, (None,) * len(pairs)))
        if (at_us - before_us) % (1 << 32) != 1000 * cycle_ms:
            before = (None,) * len(pairs)
        self._before[name] = (at_us, tuple(pair[0] for pair in pairs))
        rows = [
            between(newest, earlier, oldest, cycle_ms)
            for (newest, earlier), oldest in zip(pairs, before, strict=True)
        ]
        message = CODECS[name].message_type(at_us, fault, *rows)
        return [self._out[name].frame(message, hearing.steps)]

    def _slow(self, hearing: Hearing) -> list[Frame]:
        if hearing.heard is Heard.OK:
            supply_pa, oil_k = hearing.message
            self._slow_values = (supply_pa, oil_k)
        return []


def between(
    newest: float, earlier: float, oldest: float | None, cycle_ms: int
) -> tuple[float, ...]:
    """Ten positions 1 ms apart, newest first: of 0 and of 5 ms ago, and, where there is one, of a
    cycle ago; straight lines between them."""
    half, last = HALF_READ, earlier if oldest is None else oldest
    young = [newest + (earlier - newest) * k / half for k in range(half)]
    old = [earlier + (last - earlier) * k / (cycle_ms - half) for k in range(SAMPLES - half)]
    return (*young, *old)


__all__ = ["INDEX_WRAP", "STAMPS", "SensorIntake", "SensorSender", "between", "edges_per_us"]
