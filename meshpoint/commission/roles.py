"""Which sensor sits on which shaft, and whether the sleeves tell the truth, by how shafts turn.

Input shaft and layshaft turn with the engine whatever gear is in, the layshaft at another ratio in
the other split. The main shaft turns at another ratio in another gear, the propeller shaft in
another range too. And the gears' ratios rise from crawl to third, from low to high. No data sheet
is needed for any of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from meshpoint.commission.edge_log import EdgeLog, State, Window
from meshpoint.commission.finding import Finding, Verdict
from meshpoint.commission.shafts import Shaft
from meshpoint.commission.trial import EXPECTED
from meshpoint.commission.wheels import GEAR_STATES, HIGH_STATE, SPLIT_STATES
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.gearbox.gears import (
    MAIN_GEARS,
    SLEEVE_OF_MAIN,
    MainGear,
    Range,
    Sleeve,
    SleeveSide,
    Split,
)
from meshpoint.units import TURN, US

GROUP: Final = "turning"
SAME: Final = 0.01
"""Edges a turn of the engine differ by less than this share where nothing was changed between."""
FEW: Final = 20
"""Edges in a window: less is a wheel that does not count."""


def rate(log: EdgeLog, shaft: Shaft, window: Window) -> float:
    """Rising edges a turn of the engine."""
    times, numbers = log.edges(shaft, window)
    if numbers.size < FEW or not window.engine_rad_s:
        return 0.0
    seconds = float(times[-1] - times[0]) * US
    mean = sum(window.engine_rad_s) / len(window.engine_rad_s)
    return float(numbers[-1] - numbers[0]) / (seconds * mean / TURN)


class Turning:
    """Rates of all sensors in all windows."""

    def __init__(self, log: EdgeLog) -> None:
        self.rates: dict[State, dict[Shaft, float]] = {
            window.state: {shaft: rate(log, shaft, window) for shaft in Shaft}
            for window in log.windows
        }

    def _same(self, sensor: Shaft, one: State, other: State) -> bool:
        a, b = self.rates[one][sensor], self.rates[other][sensor]
        return abs(a - b) <= SAME * max(a, b)

    @property
    def is_whole(self) -> bool:
        """Whether everything was turned that is needed to tell shafts apart."""
        wanted = (*GEAR_STATES.values(), *SPLIT_STATES.values(), HIGH_STATE)
        return all(state in self.rates for state in wanted)

    @property
    def silent(self) -> list[Shaft]:
        """Sensors that have counted in no window."""
        return [shaft for shaft in Shaft if not any(seen[shaft] for seen in self.rates.values())]

    def shaft_of(self, sensor: Shaft) -> Shaft | None:
        """The shaft on which this sensor sits; None where what it counts fits none."""
        crawl, first = GEAR_STATES[MainGear.CRAWL], GEAR_STATES[MainGear.FIRST]
        third = GEAR_STATES[MainGear.THIRD]
        with_engine = self._same(sensor, crawl, first) and self._same(sensor, first, third)
        if with_engine:
            same = self._same(sensor, SPLIT_STATES[Split.LOW], SPLIT_STATES[Split.HIGH])
            return Shaft.INPUT if same else Shaft.LAYSHAFT
        return Shaft.MAIN if self._same(sensor, third, HIGH_STATE) else Shaft.PROPELLER

    def sensors(self) -> Iterator[Finding]:
        """Each sensor: on its shaft, on another's, or on none."""
        places = {sensor: self.shaft_of(sensor) for sensor in Shaft}
        for sensor, place in places.items():
            subject = f"{sensor} sensor turned"
            if sensor in self.silent:
                yield Finding(
                    GROUP,
                    subject,
                    Verdict.BAD,
                    "it counts nothing: not wired, or too far from its wheel",
                )
            elif place is sensor:
                yield Finding(GROUP, subject, Verdict.GOOD, f"it counts as the {place} shaft turns")
            elif place is not None and places[place] is sensor:
                text = f"the sensors of {sensor} and {place} are exchanged"
                yield Finding(GROUP, subject, Verdict.BAD, text)
            else:
                text = f"it counts as the {place} shaft turns"
                yield Finding(GROUP, subject, Verdict.BAD, text)

    def order(self) -> Iterator[tuple[Sleeve, bool]]:
        """Of each sleeve whose two sides have been turned: whether the side that it reported is the
        one whose ratio was measured."""
        lay, main, propeller = Shaft.LAYSHAFT, Shaft.MAIN, Shaft.PROPELLER
        gears = [self.rates[GEAR_STATES[gear]][main] for gear in MAIN_GEARS]
        rank = {
            gear: sorted(gears).index(value) for gear, value in zip(MAIN_GEARS, gears, strict=True)
        }
        for sleeve in (Sleeve.FIRST_SECOND, Sleeve.CRAWL_THIRD):
            own = [gear for gear in MAIN_GEARS if SLEEVE_OF_MAIN[gear].sleeve is sleeve]
            yield sleeve, all(rank[gear] == MAIN_GEARS.index(gear) for gear in own)
        splits = [self.rates[SPLIT_STATES[split]][lay] for split in Split]
        yield Sleeve.SPLITTER, splits[0] < (1.0 - SAME) * splits[1]
        low, high = self.rates[GEAR_STATES[MainGear.THIRD]], self.rates[HIGH_STATE]
        ends = low[propeller] / max(low[main], SAME), high[propeller] / max(high[main], SAME)
        yield Sleeve.RANGE, ends[0] < (1.0 - SAME) * ends[1]


def judge_turning(log: EdgeLog, wires: Mapping[SleeveSide, ValveName]) -> Iterator[Finding]:
    """Sensors by shafts; then what the standing part has left open, valves or position sensors.
    One thing wrong is reported at a time: it is mended, and all is done again."""
    turning = Turning(log)
    if not turning.is_whole:
        yield Finding(GROUP, "shafts", Verdict.UNKNOWN, "not everything was turned")
        return
    crossed: dict[Sleeve, set[Sleeve]] = {}
    for side, valve in wires.items():
        meant = SleeveSide(*EXPECTED[valve])
        if side != meant:
            crossed.setdefault(meant.sleeve, set()).add(side.sleeve)
    if not crossed:
        sensors = list(turning.sensors())
        yield from sensors
        if any(finding.verdict is Verdict.BAD for finding in sensors):
            return
    # Where outputs are crossed the wheels' sensors are believed, and tell what is: valves or
    # position sensors. With both wrong at once this contradicts itself, and is reported again
    # later.
    for sleeve, is_true in turning.order():
        name = sleeve.name.lower()
        seen = crossed.get(sleeve, set())
        yield _sleeve_finding(name, is_true, seen, sleeve)


def _sleeve_finding(name: str, is_true: bool, seen: set[Sleeve], sleeve: Sleeve) -> Finding:
    """seen: the sleeves that its two valves have moved, other than as named."""
    subject = f"{name} sleeve turned"
    if not seen and is_true:
        return Finding(GROUP, subject, Verdict.GOOD, "the ratios are those of the sides it says")
    if not seen:
        text = (
            "the ratios are those of other sides than it says, though its valves move it as named"
        )
        return Finding(GROUP, subject, Verdict.BAD, text)
    if is_true:
        text = "what it says is true: its valves are exchanged, not its position sensor"
    elif seen == {sleeve}:
        text = "its position sensor is mounted the other way round; its valves are right"
    else:
        others = " and ".join(sorted(other.name.lower() for other in seen - {sleeve}))
        text = f"its position sensor is exchanged with that of {others}; its valves are right"
    return Finding(GROUP, subject, Verdict.BAD, text)


RANGE_STATES: Final = {Range.LOW: GEAR_STATES[MainGear.THIRD], Range.HIGH: HIGH_STATE}
