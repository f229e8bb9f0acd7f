"""Whether the sensors of the four shafts count as the data sheet says, whoever turns them.

Edges are counted by their running index, which goes on at any speed, by hand too, where the time
between edges is too long for the 16 bits of a stamp. Two shafts that a sleeve couples must count
at the ratio of their gears: a wheel with another tooth count, or two sensors that are plugged into
each other's place, do not.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from enum import StrEnum
from fractions import Fraction
from typing import Any, Final, NamedTuple

from meshpoint.commission.finding import Finding, Verdict
from meshpoint.controller.measure.gearbox_view import GearboxView
from meshpoint.dbc.edges import EDGES as WHEEL_EDGES
from meshpoint.dbc.messages import GearboxSensors, Message, SleevesAux, SleevesMain
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import MainGear
from meshpoint.gearbox.wheels import Wheel

GROUP: Final = "shafts"
INDEX_MODULUS: Final = 1 << 16
LEAST_EDGES: Final = 60
"""Of the slower counting wheel of a pair: its ratio is then known to some per cent."""
SLACK_EDGES: Final = 3
"""By which the counts of two wheels may differ for nothing: where each begins and ends."""
SLACK_SHARE: Final = 0.005
FEW_EDGES: Final = 3
"""A wheel that was turned by hand has counted at least this many."""


class Shaft(StrEnum):
    """The shafts that carry a sensor wheel, from the engine to the road."""

    INPUT = "input"
    LAYSHAFT = "layshaft"
    MAIN = "main"
    PROPELLER = "propeller"


EDGES: Final[dict[type[Message], tuple[Shaft, int]]] = {
    message: (shaft, falling)
    for shaft in Shaft
    for falling, message in enumerate(WHEEL_EDGES[shaft])
}
PAIRS: Final = (
    (Shaft.INPUT, Shaft.LAYSHAFT),
    (Shaft.LAYSHAFT, Shaft.MAIN),
    (Shaft.MAIN, Shaft.PROPELLER),
)


CLASSIC_SHAFTS: Final = (Shaft.LAYSHAFT, Shaft.MAIN)
"""Whose edges are on a bus of the classic profile."""


class Coupled(NamedTuple):
    """Two shafts in mesh, driving and driven, by the step that couples them."""

    driving: Shaft
    driven: Shaft
    step: str
    ratio: Fraction
    """Turns of the driven shaft for one of the driving."""


class WheelCount:
    """Edges of one wheel: rising and falling."""

    def __init__(self) -> None:
        self.edges = [0, 0]
        self._index: list[int | None] = [None, None]
        self.restarts = 0
        self.faults = 0
        """Frames whose sensor says that it is out of range."""

    def take(self, falling: int, index: int, sensor_fault: bool) -> None:
        """One edge frame."""
        before, self._index[falling] = self._index[falling], index
        self.faults += sensor_fault
        if before is None:
            return
        fresh = (index - before) % INDEX_MODULUS
        if fresh >= INDEX_MODULUS // 2:
            self.restarts += 1
        else:
            self.edges[falling] += fresh


def count_edges(wheels: dict[Shaft, WheelCount], message: Message) -> bool:
    """Counts on if this is an edge frame; whether it was one."""
    edges = EDGES.get(type(message))
    if edges is None:
        return False
    shaft, falling = edges
    frame: Any = message  # all edge messages have these fields
    wheels[shaft].take(falling, frame.newest_index, frame.sensor_fault)
    return True


class ShaftCounts:
    """All four wheels, and what turned with what, over a time of listening."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._sheet = sheet
        self._view = GearboxView(sheet)
        self.wheels = {shaft: WheelCount() for shaft in Shaft}
        self.together: dict[Coupled, Counter[Shaft]] = {}
        """Rising edges of both shafts while they were in mesh."""
        self._before: dict[Shaft, int] | None = None

    def take(self, message: Message) -> None:
        """Any message of the sensor side."""
        if count_edges(self.wheels, message):
            return
        if isinstance(message, SleevesMain):
            self._view.sleeves_main(message, message.sample_time_us)
        elif isinstance(message, SleevesAux):
            self._view.sleeves_aux(message, message.sample_time_us)
        elif isinstance(message, GearboxSensors):
            self._account()

    def _account(self) -> None:
        """Once a read: what has turned since the read before, in what was in mesh by then."""
        now = {shaft: wheel.edges[0] for shaft, wheel in self.wheels.items()}
        before, self._before = self._before, now
        if before is None:
            return
        for coupled in self._coupled():
            turned = self.together.setdefault(coupled, Counter())
            for shaft in (coupled.driving, coupled.driven):
                turned[shaft] += now[shaft] - before[shaft]

    def _coupled(self) -> Iterator[Coupled]:
        view, sheet = self._view, self._sheet
        view.work_out()
        if view.split is not None:
            exact = sheet.split_mesh(view.split).exact
            yield Coupled(*PAIRS[0], f"splitter {view.split.name.lower()}", exact)
        if view.main_gear not in (None, MainGear.NEUTRAL):
            exact = sheet.main_mesh(view.main_gear).exact
            yield Coupled(*PAIRS[1], f"main gear {view.main_gear.name.lower()}", exact)
        if view.range_ is not None:
            exact = sheet.range_mesh(view.range_).exact
            yield Coupled(*PAIRS[2], f"range {view.range_.name.lower()}", exact)

    def wheel(self, shaft: Shaft) -> Wheel:
        """A shaft's wheel by the data sheet."""
        return self._sheet.wheels.rows[shaft]

    def edges_a_turn(self, shaft: Shaft) -> int:
        """Rising edges in a turn by the data sheet: teeth that were left out give none."""
        wheel = self.wheel(shaft)
        return wheel.teeth - len(wheel.missing)

    def findings(self, is_classic: bool = False) -> Iterator[Finding]:
        """Each sensor alone, then each pair of shafts. is_classic: the bus has rising edges of
        layshaft and main shaft alone."""
        for shaft, wheel in self.wheels.items():
            if not is_classic:
                yield _judge_wheel(shaft, wheel)
            elif shaft in CLASSIC_SHAFTS:
                yield _judge_wheel(shaft, wheel, only_rising=True)
        for coupled, turned in sorted(self.together.items()):
            if not is_classic or {coupled.driving, coupled.driven} == set(CLASSIC_SHAFTS):
                yield self._judge_pair(coupled, turned)

    def _judge_pair(self, coupled: Coupled, turned: Counter[Shaft]) -> Finding:
        driving, driven = coupled.driving, coupled.driven
        subject = f"{driving} to {driven}, {coupled.step}"
        a, b = turned[driving], turned[driven]
        teeth_a, teeth_b = self.edges_a_turn(driving), self.edges_a_turn(driven)
        expected = float(coupled.ratio * teeth_b / teeth_a)
        if max(a, b) < LEAST_EDGES:
            return Finding(
                GROUP, subject, Verdict.UNKNOWN,
                f"{a} and {b} edges, at least {LEAST_EDGES} wanted: turn them on",
            )  # fmt: skip
        slack = SLACK_EDGES * (1.0 + expected) + SLACK_SHARE * b
        text = f"{a} and {b} edges"
        if abs(b - expected * a) <= slack:
            return Finding(
                GROUP, subject, Verdict.GOOD, f"{text}, as {teeth_a} and {teeth_b} teeth give"
            )
        text += f", where {teeth_a} and {teeth_b} teeth give {expected * a:.0f} for {a}"
        if not a or not b:
            silent = driving if not a else driven
            return Finding(
                GROUP, subject, Verdict.BAD, f"{text}: the sensor of the {silent} shaft is silent"
            )
        one = teeth_a * expected * a / b
        other = teeth_b * b / (expected * a)
        text += f"; it would fit if {driving} had {one:.1f} teeth, or {driven} {other:.1f}"
        return Finding(GROUP, subject, Verdict.BAD, f"{text}, or their sensors are miswired")


def _judge_wheel(shaft: Shaft, wheel: WheelCount, only_rising: bool = False) -> Finding:
    rise, fall = wheel.edges
    fall = rise if only_rising else fall
    subject = f"{shaft} sensor"
    if wheel.faults:
        return Finding(
            GROUP, subject, Verdict.BAD,
            f"{wheel.faults} frames say that the sensor's supply or signal is out of range",
        )  # fmt: skip
    if wheel.restarts:
        return Finding(
            GROUP, subject, Verdict.BAD,
            f"its count went back {wheel.restarts} times: the sensor side restarts, or two send",
        )  # fmt: skip
    if max(rise, fall) < FEW_EDGES:
        return Finding(
            GROUP, subject, Verdict.UNKNOWN,
            f"{rise} rising and {fall} falling edges: it was not turned, or does not count "
            "(--turn asks for each shaft)",
        )  # fmt: skip
    # The frames of one read come one after the other: half of a read's edges may be missing.
    if abs(rise - fall) > max(2, 0.02 * max(rise, fall)):
        return Finding(
            GROUP, subject, Verdict.BAD,
            f"{rise} rising and {fall} falling edges: one polarity is miswired or not captured",
        )  # fmt: skip
    counted = f"{rise} rising edges" if only_rising else f"{rise} rising and {fall} falling edges"
    return Finding(GROUP, subject, Verdict.GOOD, counted)


def judge_turned(asked: Shaft, turned: dict[Shaft, int]) -> Finding:
    """A person was asked to turn one shaft; `turned`: edges of each since then."""
    subject = f"{asked} turned by hand"
    others = {shaft: n for shaft, n in turned.items() if shaft is not asked and n >= FEW_EDGES}
    reported = ", ".join(f"{shaft} {n}" for shaft, n in turned.items())
    if turned[asked] >= FEW_EDGES:
        return Finding(GROUP, subject, Verdict.GOOD, f"edges: {reported}")
    if others:
        found = " and ".join(others)
        return Finding(
            GROUP, subject, Verdict.BAD,
            f"edges: {reported}; only {found} counted: the sensors are swapped or miswired",
        )  # fmt: skip
    return Finding(GROUP, subject, Verdict.UNKNOWN, f"edges: {reported}; nothing was turned")
