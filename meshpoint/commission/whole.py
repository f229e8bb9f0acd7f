"""Both parts of commissioning one after the other, and all that was on the bus meanwhile."""

from __future__ import annotations

from meshpoint.bus.core import Step
from meshpoint.commission.core import CommissionCore
from meshpoint.commission.running import RunningCore
from meshpoint.commission.trial import EXPECTED
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.node import Node
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import SleeveSide


class WholeCommission:
    """Outputs on a standing box; then, where every output has a sleeve of its own, turning it."""

    def __init__(self, sheet: GearboxSheet, *, consents: bool = False, turns: bool = False) -> None:
        """turns: the output is free, and the engine may turn the box."""
        self._sheet, self._consents, self._turns = sheet, consents, turns
        self._transmitter = Transmitter(Node.TRANSMISSION_CONTROL)
        self.standing = CommissionCore(sheet, consents=consents, transmitter=self._transmitter)
        self.running: RunningCore | None = None
        self.recorded: list[tuple[int, Frame]] = []
        """Frames of the bus but for those while a person is asked, and the time of the step that
        took or sent each (us)."""
        self._inbox: list[Frame] = []

    @property
    def done(self) -> bool:
        """Whether there is nothing more to do."""
        return self.standing.done and (self.running is None or self.running.done)

    @property
    def is_asking(self) -> bool:
        """Whether something waits for a person's consent."""
        return self._now.is_asking

    @property
    def next_step_us(self) -> int:
        """Every 10 ms."""
        return self._now.next_step_us

    @property
    def _now(self) -> CommissionCore | RunningCore:
        return self.standing if self.running is None else self.running

    def receive(self, frame: Frame) -> None:
        """Keeps a frame for the next step."""
        self._inbox.append(frame)

    def answer(self, is_yes: bool, now_us: int) -> None:
        """A person's answer to what is asked."""
        self._now.answer(is_yes, now_us)

    def step(self, now_us: int) -> Step:
        """That of the part which is on."""
        inbox, self._inbox = self._inbox, []
        for frame in inbox:
            self._now.receive(frame)
        step = self._now.step(now_us)
        if self.standing.done and self.running is None and self._turns:
            wires = wires_of(self.standing)
            if wires is not None:
                self.running = RunningCore(
                    self._sheet, wires, consents=self._consents, transmitter=self._transmitter
                )
        if not self.is_asking:
            self.recorded.extend((now_us, frame) for frame in (*inbox, *step.frames))
        return step

    def shutdown(self, now_us: int) -> Step:
        """All valves off."""
        return self._now.shutdown(now_us)


def wires_of(core: CommissionCore) -> dict[SleeveSide, ValveName] | None:
    """Which output moves which sleeve to which side; None unless each moves one of its own, and the
    brake's its air."""
    wires: dict[SleeveSide, ValveName] = {}
    has_braked = False
    for trial in core.trials:
        if trial.valve is ValveName.BRAKE:
            has_braked = has_braked or (trial.has_braked and not trial.moved)
        elif len(trial.moved) == 1 and not trial.has_braked:
            wires[SleeveSide(*trial.moved[0])] = trial.valve
    is_whole = len(wires) == len(EXPECTED) == len(set(wires.values()))
    return wires if is_whole and has_braked else None
