"""The shifts of one gearbox in virtual time, every frame of their bus kept."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Final, NamedTuple

from benchmarks.dataset.plan import AHEAD_US, MOMENTS, PAIRS, PROFILE, SHEET, STRATEGIES, Gearbox
from meshpoint.bus.settle import settle
from meshpoint.campaigns.draw import Draw, draw
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.campaigns.record import Conditions
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox import GearboxSheet, load_sheet
from meshpoint.results.rows import ShiftRow
from meshpoint.rig_sim.settings import Preset, Profile

SETTINGS: Final = ControllerSettings().with_strategy(STRATEGIES[0])
NOT_ENGAGED, NOT_KNOWN = "without a contact", "without a phase reference"
TOO_EARLY: Final = "with less than 45 ms from request to contact"


class Recorded(NamedTuple):
    """One shift as it was on the bus."""

    gearbox: Gearbox
    moment: int
    strategy: str
    row: ShiftRow
    frames: list[tuple[int, Frame]]
    """Each with its time on the bus (us), from the rest in the old gear on."""
    conditions: dict[str, float | None]
    """What was drawn, as `Conditions` has it; the controller knows none of it."""

    @property
    def shift_id(self) -> str:
        """As all tables name it."""
        return self.gearbox.shift_id(self.moment, self.strategy)


def record(gearbox: Gearbox) -> tuple[list[Recorded], Counter[str]]:
    """The shifts of a gearbox that a phase can be predicted of; what the others were, counted."""
    found, left = [], Counter[str]()
    for each in _shifts(gearbox):
        why = _unfit(each.row)
        if why is None and isinstance(each, Recorded):
            found.append(each)
        else:
            left[str(why)] += 1
    return found, left


class _Refused(NamedTuple):
    row: None = None


def _unfit(row: ShiftRow | None) -> str | None:
    """Why no phase can be predicted of this shift; None: it can."""
    if row is None or row.contact_us is None:
        return NOT_ENGAGED
    if row.reference != "known":
        return NOT_KNOWN
    return TOO_EARLY if (row.contact_us - row.request_us) % 2**32 < AHEAD_US else None


def _shifts(gearbox: Gearbox) -> Iterator[Recorded | _Refused]:
    settle()
    sheet = load_sheet(SHEET)
    drawn = draw_of(gearbox, sheet)
    frames: list[tuple[int, Frame]] = []
    bench = ClosedLoop(sheet, SETTINGS, Preset.TRUCK, drawn, log=frames)
    for _ in range(gearbox.learned):
        bench.shift()
        frames.clear()
    bench.change_conditions(drawn.judged)
    conditions = Conditions(sheet, bench.as_built).columns
    for moment in range(MOMENTS):
        frames.clear()
        bench.prepare()
        for strategy in reversed(STRATEGIES):
            loop = bench if strategy == STRATEGIES[0] else _copy(bench, strategy)
            row = loop.shift()
            if row is None:
                yield _Refused()
            else:
                yield Recorded(
                    gearbox, moment, strategy, row, list(loop.log or ()), dict(conditions)
                )


def draw_of(gearbox: Gearbox, sheet: GearboxSheet) -> Draw:
    """What the gearbox's seed draws."""
    pairs, shifts = PAIRS[gearbox.kind], gearbox.learned + MOMENTS
    return draw(gearbox.seed, sheet, Preset.TRUCK, pairs, shifts, {}, Profile(PROFILE))


def _copy(bench: ClosedLoop, strategy: str) -> ClosedLoop:
    copy = bench.fork()
    copy.use(SETTINGS.with_strategy(strategy), knows_all=False)
    return copy
