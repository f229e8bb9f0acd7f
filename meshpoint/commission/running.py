"""The commissioning node with turning shafts: after the standing part, before the first shift.

The output is free (wheels lifted, or a stand without load). Each main gear is pushed in at
standstill and turned by the engine; then, with the main shaft coasting, layshaft and input shaft
are driven, released and braked in both splits. All is listened to and recorded; nothing of the data
sheet is used but its air and its speed limit. Every manoeuvre waits for a consent of its own, has
a longest time, and ends with all valves off and the clutch open.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from functools import partial
from typing import Any, Final

from meshpoint.bus.core import Step
from meshpoint.commission.core import (
    CONSENT_US,
    LEAD_US,
    LONGER_US,
    LONGEST_PULSE_US,
    NEUTRAL_M,
    SHORT_PULSE_US,
    STATIONARY_US,
    TICK_US,
)
from meshpoint.commission.edge_log import EdgeLog, State
from meshpoint.commission.hearing import HearingCore
from meshpoint.commission.shafts import Shaft
from meshpoint.commission.trial import MOVED_M
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import checked_request
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import (
    EEC1,
    TSC1,
    ClutchAction,
    ClutchCommand,
    GearboxSensors,
    Message,
    SleevesAux,
    SleevesMain,
    TscOverrideMode,
    ValveAction,
    ValveCommand,
)
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import (
    MAIN_GEARS,
    MAIN_SLEEVES,
    SLEEVE_OF_MAIN,
    MainGear,
    Range,
    Sleeve,
    SleeveSide,
    Split,
)
from meshpoint.results.road_speed import span_us
from meshpoint.units import MM, RPM, US

NEEDED: Final = (GearboxSensors, SleevesMain, SleevesAux, EEC1)
IN_M: Final = 8.0 * MM
"""A main sleeve this far from neutral is in its gear."""
STEP_IN_M: Final = 4.0 * MM
"""The sleeve of splitter or range this far from its middle is in one of its steps."""
CREEP_RPM: Final = 700.0
"""Engine speed at which a gear is turned in."""
GEAR_RPM: Final = 1200.0
DRIVEN_RPM: Final = (1250.0, 1400.0, 1320.0, 1450.0, 1280.0, 1380.0)
"""Engine speeds before the layshaft is released, in turn."""
PULSES_US: Final = (90_000, 160_000, 0, 230_000, 120_000, 190_000)
"""How long the brake is on in each of these."""
COUNT_US: Final = 2_500_000
COAST_US: Final = 250_000
STROKES: Final = 3
"""Times that a sleeve is pushed to each gear's dog teeth at standstill beside the one that engages
it."""
TRIES: Final = 12
INCH_US: Final = 400_000
"""A clutch that is closed just until the gear moves: no longer than so, then it rests so long."""
INCH_EDGES: Final = 2
NEAR_END: Final = 0.03
LEAST_TRAVEL: Final = 4
SETTLED_SHARE: Final = 0.02
SETTLE_US: Final = 600_000
MOVE_US: Final = 1_500_000
SPIN_US: Final = 12_000_000
STAND_US: Final = 30_000_000
BRAKED: Final = 2
"""Input shaft and layshaft. Main shaft and output may coast on."""
QUIET_US: Final = 250_000
"""A shaft of which no edge comes for so long stands."""
OVER_SHARE: Final = 1.15
"""An engine that is this much faster than asked for is out of hand."""

SPLITS: Final = {
    Split.LOW: SleeveSide(Sleeve.SPLITTER, -1),
    Split.HIGH: SleeveSide(Sleeve.SPLITTER, 1),
}
RANGES: Final = {Range.LOW: SleeveSide(Sleeve.RANGE, -1), Range.HIGH: SleeveSide(Sleeve.RANGE, 1)}
Program = Generator[None, None, None]


class GivenUpError(Exception):
    """Why the rest is not done."""


class RunningCore(HearingCore):
    """Turns the box. `question` is the manoeuvre that waits for a consent."""

    def __init__(
        self,
        sheet: GearboxSheet,
        wires: Mapping[SleeveSide, ValveName],
        *,
        consents: bool = False,
        transmitter: Transmitter | None = None,
    ) -> None:
        """wires: which output moves which sleeve which way, as the standing part has seen.
        consents: every manoeuvre is consented to, without being asked about."""
        super().__init__(sheet, consents, transmitter)
        self._wires, self._now_us = dict(wires), 0
        self._valve: tuple[ValveName, int] | None = None
        """The output that is driven, and since when."""
        self._off_us: int | None = None
        """Until when; None: until further notice."""
        self._clutch = ClutchAction.OPEN
        self._travel: list[tuple[int, float]] = []
        self._engine_rad_s: float | None = None
        self._requests = 0
        self._events: list[str] = []
        self._answer: tuple[bool, int] | None = None
        self._edges = dict.fromkeys(Shaft, 0)
        self._edge_us = dict.fromkeys(Shaft, 0)
        """Of each wheel: how many have come, and when the last one did."""
        self._coasting: set[Shaft] = set()
        """Shafts that did not stand when the others were brought to a stand."""
        self._program: Program | None = self._whole()
        self.log = EdgeLog()
        self.question: str | None = None
        self.declined: set[str] = set()
        self.closing_s: list[float] = []
        self.opening_s: list[float] = []
        """From one end of the clutch's travel to the other, of each travel."""
        self.closings: list[list[tuple[int, float]]] = []
        """Samples of the clutch on its way: log's time (us), share of the travel from open."""
        self.stopped = ""
        """Why it ended before its end; empty if it did not."""

    @property
    def done(self) -> bool:
        """Whether there is nothing more to do."""
        return self._program is None

    @property
    def is_asking(self) -> bool:
        """Whether a manoeuvre waits for a person's consent."""
        return self.question is not None and not self._consents and self._answer is None

    def answer(self, is_yes: bool, now_us: int) -> None:
        """A person's answer to `question`."""
        if self.question is not None:
            self._answer = (is_yes, now_us)

    def step(self, now_us: int) -> Step:
        """Takes in what was heard, goes on with the program, commands."""
        self._now_us, self._due_us = now_us, now_us + TICK_US
        self._take_in(now_us)
        counted = dict.fromkeys(Shaft, 0)
        for (shaft, _), track in self.log.tracks.items():
            counted[shaft] += track.numbers[-1] if track.numbers else 0
        self._edge_us |= {shaft: now_us for shaft in Shaft if counted[shaft] != self._edges[shaft]}
        self._edges = counted
        if self._program is not None:
            try:
                self._look_out()
                next(self._program)
            except StopIteration:
                self._end("")
            except GivenUpError as given_up:
                self._end(str(given_up))
        events, self._events = self._events, []
        return Step(self._frames(), events)

    def shutdown(self, now_us: int) -> Step:  # noqa: ARG002
        """All valves off, the clutch open, nothing asked of the engine."""
        self._end(self.stopped)
        return Step(self._frames(), ["all valves off"])

    def _end(self, why: str) -> None:
        self._program, self.stopped, self.question = None, why, None
        self._valve = self._off_us = None
        self._clutch, self._engine_rad_s = ClutchAction.OPEN, None
        if why:
            self._events.append(f"given up: {why}")

    def _hear(self, message: Message) -> None:
        super()._hear(message)
        self.log.take(message)
        if isinstance(message, GearboxSensors):
            at_us = self.log.now_us + span_us(message.sample_time_us, self.log.now_us & 0xFFFF_FFFF)
            self._time_clutch(at_us, message.clutch_position_fraction)

    def _time_clutch(self, at_us: int, closed: float) -> None:
        """A travel from end to end by its samples within the ends, at even speed."""
        travel, closes = self._travel, self._clutch is ClutchAction.CLOSE
        if NEAR_END < closed < 1.0 - NEAR_END:
            travel.append((at_us, closed))
            return
        if len(travel) >= LEAST_TRAVEL:
            (t0, x0), (t1, x1) = travel[0], travel[-1]
            way = x1 - x0 if closes else x0 - x1
            if way > 0.5:
                times = self.closing_s if closes else self.opening_s
                times.append((t1 - t0) * US / way)
                if closes:
                    self.closings.append(list(travel))
        travel.clear()

    def _look_out(self) -> None:
        """Raises GivenUpError where nothing may be driven on."""
        if not self._complete():
            if self.log.windows or self._valve is not None:
                raise GivenUpError("an input is lost")
            return
        sensors, engine = self._sensors, self.log.engine_rad_s
        if sensors is None or engine is None:
            return
        if self._lacks_air(sensors):
            raise GivenUpError("too little air")
        most = min(self._sheet.limits.input_max_rad_s, OVER_SHARE * max(DRIVEN_RPM) * RPM)
        if engine > most:
            raise GivenUpError("the engine is faster than it was asked to be")

    def _complete(self) -> bool:
        known = self._sensors is not None and len(self._positions_m) == len(Sleeve)
        return known and self._receiver.all_valid(NEEDED)

    def _whole(self) -> Program:
        yield from self._until(self._complete, STATIONARY_US, "inputs are missing")
        yield from self._to_neutral()
        for range_ in (Range.LOW, Range.HIGH):
            if range_ is Range.HIGH and MainGear.THIRD.name.lower() in self.declined:
                continue
            yield from self._stand()
            yield from self._step_in(Split.LOW)
            yield from self._change(RANGES[range_])
            for gear in MAIN_GEARS if range_ is Range.LOW else (MainGear.THIRD,):
                name = gear.name.lower()
                if (yield from self._consented(f"{name}, range {range_.name.lower()}", name)):
                    yield from self._turn_in(gear, range_)
        # The main shaft coasts on from third: its teeth are seen beside the layshaft's.
        for split in Split:
            name = f"split_{split.name.lower()}"
            if (yield from self._consented(f"input shaft and layshaft, {name}", name)):
                yield from self._drive_and_brake(split)
        yield from self._stand()

    def _consented(self, what: str, name: str) -> Generator[None, None, bool]:
        """Whether a person says yes, now; not asked where all is consented to."""
        while not self._consents:
            self.question, self._answer = f"may the engine turn {what}? (yes/no)", None
            self._events.append(self.question)
            while (answer := self._taken_answer()) is None:
                yield
            is_yes, at_us = answer
            if is_yes and self._now_us - at_us <= CONSENT_US:
                return True
            if not is_yes:
                self.declined.add(name)
                return False
            self._events.append("the consent has run out")
        return True

    def _taken_answer(self) -> tuple[bool, int] | None:
        """The answer, once; the question is none any more."""
        answer, self._answer = self._answer, None
        if answer is not None:
            self.question = None
        return answer

    def _turn_in(self, gear: MainGear, range_: Range) -> Program:
        """A gear is pushed in at standstill, turned, counted, and taken out again."""
        side = SLEEVE_OF_MAIN[gear]
        yield from self._stand()
        yield from self._strokes(side, STROKES if range_ is Range.LOW else 0)
        yield from self._inch_in(side, gear.name.lower())
        yield from self._spin(GEAR_RPM)
        yield from self._count(State(Split.LOW, gear, range_), COUNT_US)
        if range_ is Range.LOW:
            yield from self._spin(CREEP_RPM)
        yield from self._let_go()
        # Out of gear before the brake: it would brake what is behind the output, too.
        yield from self._to_neutral()

    def _strokes(self, side: SleeveSide, times: int) -> Program:
        """A sleeve is pushed at standstill, and comes back to neutral."""
        for _ in range(times):
            yield from self._drive(side, lambda: False, 150_000)
            yield from self._to_neutral((side.sleeve,))

    def _step_in(self, split: Split, strokes: int = 0) -> Program:
        """The splitter into a step: by its cones while it turns, by dog teeth as a main gear."""
        side = SPLITS[split]
        if not self._sheet.has_dog_splitter:
            yield from self._change(side)
        elif strokes or not self._at(side, IN_M):
            yield from self._stand(BRAKED)
            yield from self._to_neutral((side.sleeve,))
            yield from self._strokes(side, strokes)
            yield from self._inch_in(side, f"split_{split.name.lower()}")

    def _inch_in(self, side: SleeveSide, name: str) -> Program:
        """Pushes a sleeve in. One that meets a tooth stays on it until the clutch, which closes
        only until the first edges come, has turned the gear under it a little."""
        self._push(side)
        yield from self._hold(200_000)
        self._engine_rad_s = CREEP_RPM * RPM
        for _ in range(TRIES):
            if self._at(side, IN_M):
                break
            still, end_us = self._turned, self._now_us + INCH_US
            self._clutch = ClutchAction.CLOSE
            while self._now_us < end_us and self._turned < still + INCH_EDGES:
                yield
            self._clutch = ClutchAction.OPEN
            yield from self._hold(INCH_US)
        if not self._at(side, IN_M):
            raise GivenUpError(f"{name}: does not go in")
        yield from self._hold(100_000)
        self._valve = None

    def _drive_and_brake(self, split: Split) -> Program:
        yield from self._step_in(split, STROKES)
        for number, (rpm, pulse_us) in enumerate(zip(DRIVEN_RPM, PULSES_US, strict=True)):
            yield from self._spin(rpm)
            if number == 0:
                yield from self._count(State(split, MainGear.NEUTRAL, Range.HIGH), COUNT_US)
            yield from self._let_go()
            if pulse_us:
                yield from self._pulse(ValveName.BRAKE, pulse_us)
            yield from self._hold(COAST_US)

    def _spin(self, rpm: float) -> Program:
        """The engine turns the input shaft at a speed that settles."""
        self._engine_rad_s, self._clutch = rpm * RPM, ClutchAction.CLOSE
        since = [self._now_us]

        def is_settled() -> bool:
            engine, sensors = self.log.engine_rad_s or 0.0, self._sensors
            closed = sensors is not None and sensors.clutch_position_fraction >= 0.99
            if not closed or abs(engine / (rpm * RPM) - 1.0) > SETTLED_SHARE:
                since[0] = self._now_us
            return self._now_us - since[0] >= SETTLE_US

        yield from self._until(is_settled, SPIN_US, "the engine does not come to its speed")

    def _let_go(self) -> Program:
        self._clutch = ClutchAction.OPEN
        yield from self._until(
            lambda: self._sensors is not None and self._sensors.clutch_position_fraction <= 0.01,
            MOVE_US,
            "the clutch does not open",
        )
        yield from self._hold(100_000)

    def _stand(self, shafts: int = len(Shaft)) -> Program:
        """Neutral, clutch open, brake on, until this many shafts stand; the output is left to
        itself, or a person brakes it."""
        self._engine_rad_s, self._clutch = None, ClutchAction.OPEN
        self._activate(ValveName.BRAKE)
        yield from self._hold(200_000)
        yield from self._until(
            lambda: len(self._turning()) <= len(Shaft) - shafts, STAND_US, "the shafts do not stop"
        )
        self._coasting = self._turning()
        self._valve = None
        yield from self._hold(300_000)

    def _turning(self) -> set[Shaft]:
        return {s for s, at_us in self._edge_us.items() if self._now_us - at_us <= QUIET_US}

    @property
    def _turned(self) -> int:
        """Edges of the shafts that stood."""
        return sum(count for shaft, count in self._edges.items() if shaft not in self._coasting)

    def _change(self, *sides: SleeveSide) -> Program:
        """Splitter and range to these sides."""
        for side in sides:
            if not self._at(side, STEP_IN_M):
                name = side.sleeve.name.lower()
                is_there = partial(self._at, side, STEP_IN_M)
                yield from self._drive(side, is_there, MOVE_US, f"{name}: not moved")

    def _to_neutral(self, sleeves: tuple[Sleeve, ...] = MAIN_SLEEVES) -> Program:
        """By pulses that grow until the sleeve moves: one that is pulled for longer flies through
        neutral into the other gear."""
        for sleeve in sleeves:
            pulse_us = SHORT_PULSE_US
            while not self._in_neutral(sleeve):
                if pulse_us > LONGEST_PULSE_US:
                    raise GivenUpError(f"{sleeve.name.lower()}: does not come to neutral")
                before_m = self._positions_m[sleeve]
                back = SleeveSide(sleeve, -1 if before_m > 0.0 else 1)
                yield from self._pulse(self._wires[back], pulse_us)
                yield from self._hold(150_000)
                if abs(self._positions_m[sleeve] - before_m) < MOVED_M:
                    pulse_us += LONGER_US

    def _drive(
        self, side: SleeveSide, until: Callable[[], bool], most_us: int, why: str = ""
    ) -> Program:
        """One output until something is so, at most so long; GivenUpError with `why` after that."""
        self._push(side)
        end_us = self._now_us + LEAD_US + most_us
        while not until() and self._now_us < end_us:
            yield
        self._valve = None
        if why and not until():
            raise GivenUpError(why)
        yield from self._hold(150_000)

    def _pulse(self, valve: ValveName, during_us: int) -> Program:
        """Off at a time as exact as on: a fit of the pressure's fall goes by it."""
        self._activate(valve)
        # Not before it is on: a valve keeps one pending activation. And not long before it is off:
        # one that is further ahead than 100 ms is refused.
        on_us = max(during_us, LEAD_US)
        yield from self._hold(on_us)
        if self._valve is not None:
            self._off_us = (self._valve[1] + during_us) & 0xFFFF_FFFF
        yield from self._hold(during_us + 2 * LEAD_US - on_us)
        self._valve = self._off_us = None

    def _push(self, side: SleeveSide) -> None:
        self._activate(self._wires[side])

    def _activate(self, valve: ValveName) -> None:
        sensors = self._sensors
        if sensors is not None:
            self._valve = valve, (sensors.sample_time_us + LEAD_US) & 0xFFFF_FFFF

    def _at(self, side: SleeveSide, way_m: float) -> bool:
        return self._positions_m[side.sleeve] * side.direction > way_m

    def _in_neutral(self, sleeve: Sleeve) -> bool:
        return abs(self._positions_m[sleeve]) < NEUTRAL_M

    def _count(self, state: State, during_us: int) -> Program:
        self.log.begin(state)
        yield from self._hold(during_us)
        self.log.end()

    def _hold(self, during_us: int) -> Program:
        end_us = self._now_us + during_us
        while self._now_us < end_us:
            yield

    def _until(self, condition: Callable[[], bool], most_us: int, why: str) -> Program:
        end_us = self._now_us + most_us
        while not condition():
            if self._now_us > end_us:
                raise GivenUpError(why)
            yield

    def _frames(self) -> list[Frame]:
        values: dict[str, Any] = {}
        if self._valve is not None:
            name, activation_us = self._valve
            is_off = self._off_us is not None
            values = {
                f"{name.name.lower()}_action": ValveAction.OFF_AT if is_off else ValveAction.ON_AT,
                f"{name.name.lower()}_time_us": self._off_us if is_off else activation_us,
            }
        request = TSC1()
        if self._engine_rad_s is not None:
            mode = TscOverrideMode.SPEED_CONTROL
            request = TSC1(override_control_mode=mode, requested_speed_rad_s=self._engine_rad_s)
        encode = self._transmitter.encode
        self._requests += 1
        return [
            encode(ValveCommand(**values)),
            encode(ClutchCommand(action=self._clutch)),
            checked_request(encode(request), self._requests),
        ]
