"""The commissioning node, of the call shape of controller and rig: no clock, no I/O.

The box stands, with air. Outputs are armed one at a time, each by a consent of its own that holds
for one pulse and runs out by itself. Every other output is commanded off in every frame. A pulse
ends at once when a shaft turns by more than a pulse can turn it, air fails, or an input is lost.
"""

from __future__ import annotations

from collections import deque
from enum import Enum, auto
from typing import Any, Final

from meshpoint.bus.core import Step
from meshpoint.commission.hearing import HearingCore
from meshpoint.commission.shafts import Shaft, WheelCount, count_edges
from meshpoint.commission.trial import EXPECTED, Trial
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import (
    ClutchCommand,
    GearboxSensors,
    Message,
    SleevesAux,
    SleevesMain,
    ValveAction,
    ValveCommand,
    ValveStatus,
)
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import MAIN_SLEEVES, Sleeve
from meshpoint.units import MM

TICK_US: Final = 10_000
LEAD_US: Final = 30_000
PULSE_US: Final = 300_000
AFTER_US: Final = 400_000
"""How long is looked on after the valve is off."""
STILL_US: Final = 300_000
"""Shafts and valves rest for so long before an output is armed."""
CONSENT_US: Final = 10_000_000
MOST_TRIALS: Final = 3
RETURNS: Final = 30
"""This often an output may be driven to bring its sleeve back to neutral."""
SHORT_PULSE_US: Final = 18_000
"""The first pulse that pulls a gear out: too short to move a sleeve that lies in its detent."""
LONGER_US: Final = 2_000
"""Each further pulse is longer by so much, until the sleeve leaves its gear; a sleeve that is
pulled for longer than that flies through neutral into the other gear."""
LONGEST_PULSE_US: Final = 100_000
MOST_EDGES: Final = 4
"""Of a wheel within `STILL_US` before an output is armed: creeping is not turning."""
MOST_PULSED_EDGES: Final = 12
"""Of a wheel within `STILL_US` while an output is driven: a sleeve that sets out, an axle that
relaxes and plates that drag turn a shaft a little. 45 teeth at 53 rpm, which is no slip that a
sleeve may not meet."""
TURNS: Final = "a shaft turns; stop what drives it, also an engine that idles"
NEUTRAL_M: Final = 1.5 * MM
NEEDED: Final = (GearboxSensors, SleevesMain, SleevesAux, ValveStatus)
STATIONARY_US: Final = 30_000_000
"""So long is waited for a box that stands."""


class Stage(Enum):
    """What it is at."""

    RESTING = auto()
    ASKING = auto()
    PULSING = auto()
    LOOKING = auto()
    DONE = auto()


class CommissionCore(HearingCore):
    """Drives each valve of a standing box. `question` is the output that waits for a consent."""

    def __init__(
        self,
        sheet: GearboxSheet,
        *,
        consents: bool = False,
        transmitter: Transmitter | None = None,
    ) -> None:
        """consents: every output is consented to, without being asked about."""
        super().__init__(sheet, consents, transmitter)
        self._wheels = {shaft: WheelCount() for shaft in Shaft}
        self._counts: deque[tuple[int, list[int]]] = deque()
        self._status: ValveStatus | None = None
        self._stage = Stage.RESTING
        self._since_us: int | None = None
        self._trial: Trial | None = None
        self._consented_us: int | None = None
        self._tries = dict.fromkeys(ValveName, 0)
        self._pulls = dict.fromkeys(ValveName, 0)
        self.question: ValveName | None = None
        self.trials: list[Trial] = []
        self.declined: set[ValveName] = set()
        self.supply_pa: list[float] = []
        self.stopped = ""
        """Why it ended before its end; empty if it did not."""

    @property
    def done(self) -> bool:
        """Whether there is nothing more to drive."""
        return self._stage is Stage.DONE

    @property
    def is_asking(self) -> bool:
        """Whether an output waits for a person's consent."""
        return self._stage is Stage.ASKING and not self._consents and self._consented_us is None

    def answer(self, is_yes: bool, now_us: int) -> None:
        """A person's answer to `question`."""
        if self.question is None:
            return
        if is_yes:
            self._consented_us = now_us
        else:
            self.declined.add(self.question)
            self.question, self._stage, self._since_us = None, Stage.RESTING, now_us

    def step(self, now_us: int) -> Step:
        """Takes in what was heard, goes on, commands all valves but one off."""
        self._since_us = now_us if self._since_us is None else self._since_us
        self._take_in(now_us)
        self._counts.append((now_us, self._edges()))
        while self._counts and now_us - self._counts[0][0] > STILL_US:
            self._counts.popleft()
        events = self._go_on(now_us)
        self._due_us = now_us + TICK_US
        # The clutch stays open: nothing may drive the box while a person stands at it.
        command = self._command()
        return Step([self._transmitter.encode(m) for m in (command, ClutchCommand())], events)

    def shutdown(self, now_us: int) -> Step:  # noqa: ARG002
        """All valves off."""
        frames = [self._transmitter.encode(m) for m in (ValveCommand(), ClutchCommand())]
        return Step(frames, ["all valves off"])

    def _edges(self) -> list[int]:
        return [wheel.edges[0] for wheel in self._wheels.values()]

    def _hear(self, message: Message) -> None:
        super()._hear(message)
        count_edges(self._wheels, message)
        if isinstance(message, ValveStatus):
            self._status = message
        if self._trial is not None:
            self._trial.take(message)

    def _missing(self) -> str:
        heard = {
            GearboxSensors: self._sensors is not None,
            SleevesMain: Sleeve.CRAWL_THIRD in self._positions_m,
            SleevesAux: Sleeve.RANGE in self._positions_m,
            ValveStatus: self._status is not None,
        }
        return ", ".join(kind.__name__ for kind, is_heard in heard.items() if not is_heard)

    def _refusal(self) -> str:
        """Why no output may be driven now; empty if one may."""
        if self._sensors is None or self._status is None or len(self._positions_m) < len(Sleeve):
            return (
                f"inputs are missing: {self._missing()}; are the other nodes on, and on this bus?"
            )
        if not self._receiver.all_valid(NEEDED):
            return "an input is lost"
        if self._lacks_air(self._sensors):
            return "too little air"
        (_, before), (_, now) = self._counts[0], self._counts[-1]
        most = MOST_PULSED_EDGES if self._stage is Stage.PULSING else MOST_EDGES
        if any(b - a > most for a, b in zip(before, now, strict=True)):
            return TURNS
        return ""

    def _go_on(self, now_us: int) -> list[str]:
        if self._stage is Stage.DONE:
            return []
        waited_us = now_us - (self._since_us or 0)
        refusal = self._refusal()
        match self._stage:
            case Stage.RESTING:
                return self._rest(now_us, waited_us, refusal)
            case Stage.ASKING:
                return self._ask(now_us, waited_us, refusal)
            case Stage.PULSING:
                if refusal or waited_us > LEAD_US + self._pulse_us():
                    if self._trial is not None:
                        self._trial.cut_short = refusal
                    self._enter(Stage.LOOKING, now_us)
                    return [f"pulse ended: {refusal}"] if refusal else []
            case _:
                if waited_us > AFTER_US:
                    return self._conclude(now_us)
        return []

    def _enter(self, stage: Stage, now_us: int) -> None:
        self._stage, self._since_us = stage, now_us

    def _rest(self, now_us: int, waited_us: int, refusal: str) -> list[str]:
        if refusal:
            if waited_us > STATIONARY_US:
                self.stopped = refusal
                self._enter(Stage.DONE, now_us)
                return [f"given up: {refusal}"]
            return []
        if waited_us < STILL_US:
            return []
        valve = self._next_valve()
        if valve is None:
            self._enter(Stage.DONE, now_us)
            return []
        self.question, self._consented_us = valve, None
        self._enter(Stage.ASKING, now_us)
        return [] if self._consents else [f"may {valve.name.lower()} be driven once? (yes/no)"]

    def _next_valve(self) -> ValveName | None:
        """An output that has shown nothing yet. A main sleeve is moved while the other one is in
        neutral, as far as positions say."""
        shown = {trial.valve for trial in self.trials if trial.is_conclusive}
        open_ = [
            valve
            for valve in ValveName
            if valve not in shown | self.declined and self._tries[valve] < MOST_TRIALS
        ]
        free = [valve for valve in open_ if self._is_free(valve)]
        if open_ and not free:
            way = self._way_to_neutral()
            # Where names are known to be wrong, they say nothing of which sleeve would move. The
            # box stands: a second gear would lock it, and is taken out again.
            if way is not None or not self._is_crossed():
                return way
            return min(open_, key=lambda valve: (self._tries[valve], valve))
        free.sort(key=lambda valve: (self._tries[valve], self._stands_there(valve), valve))
        return free[0] if free else None

    def _way_to_neutral(self) -> ValveName | None:
        """An output that has been seen to bring the main sleeve that is in gear out of it."""
        for trial in self.trials:
            for sleeve, direction in trial.moved:
                away = sleeve in MAIN_SLEEVES and self._positions_m[sleeve] * direction < -NEUTRAL_M
                if away and trial.valve not in self.declined and self._tries[trial.valve] < RETURNS:
                    return trial.valve
        return None

    def _returns(self, trial: Trial) -> bool:
        """Whether this output is known to move a main sleeve, and its sleeve lies on the other
        side: the pulse brings it back to neutral."""
        return any(
            sleeve in MAIN_SLEEVES and trial.before_m[sleeve] * direction < -NEUTRAL_M
            for known in self.trials
            if known.valve is trial.valve
            for sleeve, direction in known.moved
        )

    def _pulse_us(self) -> int:
        trial = self._trial
        if trial is None or not self._returns(trial):
            return PULSE_US
        return min(SHORT_PULSE_US + LONGER_US * self._pulls[trial.valve], LONGEST_PULSE_US)

    def _is_crossed(self) -> bool:
        """Whether an output has moved another sleeve than its own."""
        return any(
            sleeve is not EXPECTED[trial.valve][0]
            for trial in self.trials
            if trial.valve in EXPECTED
            for sleeve, _ in trial.moved
        )

    def _is_free(self, valve: ValveName) -> bool:
        """Whether no second main gear could get in: the other main sleeve is in neutral."""
        sleeve, _ = EXPECTED.get(valve, (None, 0))
        if sleeve is None or sleeve not in MAIN_SLEEVES:
            return True
        other = MAIN_SLEEVES[1 - MAIN_SLEEVES.index(sleeve)]
        return abs(self._positions_m[other]) < NEUTRAL_M

    def _stands_there(self, valve: ValveName) -> bool:
        """Whether the sleeve is where this valve would push it: another one comes first."""
        sleeve, direction = EXPECTED.get(valve, (None, 0))
        return sleeve is not None and self._positions_m[sleeve] * direction > NEUTRAL_M

    def _ask(self, now_us: int, waited_us: int, refusal: str) -> list[str]:
        if self._consents and self._consented_us is None:
            self._consented_us = now_us
        if self._consented_us is None:
            return []
        if refusal or now_us - self._consented_us > CONSENT_US:
            why = refusal or "the consent has run out"
            self.question = None
            self._enter(Stage.RESTING, now_us)
            return [f"not driven after {waited_us / 1e6:.1f} s: {why}"]
        sensors, valve = self._sensors, self.question
        if sensors is None or valve is None:
            return []
        self.supply_pa.append(sensors.supply_pressure_pa)
        activation_us = (sensors.sample_time_us + LEAD_US) & 0xFFFF_FFFF
        self._trial = Trial(
            valve, activation_us, dict(self._positions_m), sensors.brake_pressure_pa
        )
        self._tries[valve] += 1
        self._enter(Stage.PULSING, now_us)
        return []

    def _conclude(self, now_us: int) -> list[str]:
        trial, self._trial, self.question = self._trial, None, None
        self._enter(Stage.RESTING, now_us)
        if trial is None:
            return []
        if self._returns(trial):
            # What has moved its sleeve is long enough; the next pull begins a little shorter.
            self._pulls[trial.valve] = max(0, self._pulls[trial.valve] + (-1 if trial.moved else 1))
        self.trials.append(trial)
        moved = ", ".join(
            f"{sleeve.name.lower()} {'+' if way > 0 else '-'}" for sleeve, way in trial.moved
        )
        brake = "brake pressure" if trial.has_braked else ""
        nothing = "not known, its pulse was cut short" if trial.cut_short else "nothing moved"
        return [f"{trial.valve.name.lower()}: {moved or brake or nothing}"]

    def _command(self) -> ValveCommand:
        trial = self._trial
        if self._stage is not Stage.PULSING or trial is None:
            return ValveCommand()
        name = trial.valve.name.lower()
        # The same activation again and again: it is armed once, and holds. Its end follows when it
        # has passed, since a valve keeps one pending activation, and not long before it comes: one
        # that is further ahead than 100 ms is refused.
        pulse_us = self._pulse_us()
        has_begun = self._due_us - TICK_US - (self._since_us or 0) >= max(pulse_us, LEAD_US)
        ends_us = (trial.activation_us + pulse_us) & 0xFFFF_FFFF
        values: dict[str, Any] = {
            f"{name}_action": ValveAction.OFF_AT if has_begun else ValveAction.ON_AT,
            f"{name}_time_us": ends_us if has_begun else trial.activation_us,
        }
        return ValveCommand(**values)
