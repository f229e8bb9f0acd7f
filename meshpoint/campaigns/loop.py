"""One gearbox and its controller in closed loop, that can be copied between two shifts.

Cores are pure, so a copy goes on exactly as the original would: the learning shifts of a run are
made once, and each strategy then goes on from a copy (docs/decisions/0008-campaign.md).
"""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final

from meshpoint.base.version import product_version
from meshpoint.bench.bench import BenchCore
from meshpoint.bench.bench_builder import Onlooker, virtual_bench
from meshpoint.bench.pauses import Pauses, pauses_of
from meshpoint.bench.setup import Setup
from meshpoint.bench.simulate import FOR_LOGS, LIMIT_US_PER_SHIFT
from meshpoint.bus.profile import WireProfile
from meshpoint.campaigns.draw import Draw
from meshpoint.campaigns.scorer import NO_STEP_US, SCORED_IDS, Scorer
from meshpoint.campaigns.true_state import TrueState
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.header import new_header
from meshpoint.controller.settings.learned import Calibration
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ReferenceEncoder, ReferencePhase
from meshpoint.gearbox import GearboxSheet
from meshpoint.results.rows import LOCK_WAIT_US, ShiftRow
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import Preset, Profile

LOCKED_US: Final = 100_000
"""A campaign rests for no longer than a pause is for. Before a request the filters settle in the
old gear: 0.1 s after its lock phases are known as well as after 0.2 s (40 runs of each; 20 ms are
too few). The truck's clutch takes longer than that to close, and once it has nothing is left to
wait for."""
LEARNED_US: Final = 100_000
"""A new gear is left when its phase is known, but not before this: its reference gains by every
look, and the clutch closes meanwhile, which it would else do in the old gear."""
FAST_RETURN_RAMP_S: Final = 0.05
"""From the new gear's speeds to the old one's. As fast as this the wheels' teeth are still counted
without a loss; it is the bench's doing and no part of a shift."""
UNREAD: Final = frozenset((*FOR_LOGS, ReferenceEncoder, ReferencePhase))
"""What these say nobody acts on here."""
SHARED: Final = tuple(CODECS.values())
"""What a copy shares with its original: it never changes."""


def short_pauses(sheet: GearboxSheet, profile: Profile, rest_us: int | None = None) -> Pauses:
    """As everywhere on a driveline that twists, which the profile alone says here, whatever the
    preset; on a rigid one no longer than what each is for. `rest_us`: in place of either, from when
    the controller says that it is in the old gear with its clutch closed."""
    if rest_us is not None:
        return Pauses(settle_us=rest_us, learned_us=LEARNED_US)
    usual = pauses_of(sheet, profile)
    return replace(usual, settle_us=0, locked_us=LOCKED_US, learned_us=LEARNED_US)


class ClosedLoop:
    """Controller, rig, bench operator and scorer on one virtual bus."""

    def __init__(
        self,
        sheet: GearboxSheet,
        settings: ControllerSettings,
        preset: Preset,
        drawn: Draw,
        log: list[tuple[int, Frame]] | None = None,
        wire: WireProfile = WireProfile.FD,
        known: tuple[GearboxSheet, Calibration | None] | None = None,
        rest_us: int | None = None,
    ) -> None:
        """`log`: every frame of the bus with its time is put in here; a copy has its own. `known`:
        the data sheet and calibration that the controller has, where they are not the gearbox's.
        `rest_us`: as in `short_pauses`."""
        self._sheet = sheet
        self.log = log
        setup = Setup(
            sheet,
            settings,
            preset,
            drawn.seed,
            as_built=drawn.as_built,
            profile=drawn.profile,
            wire=wire,
        )
        self._rig = RigCore(sheet, setup.rig(drawn.plan[0], FAST_RETURN_RAMP_S))
        self._settings = settings
        self._made = self._refused = 0
        believed, calibration = known or (sheet, None)
        self.controller = ControllerCore(
            new_header(product_version(), believed, settings, calibration)
        )
        """The controller itself, to be looked at."""
        self._bench = BenchCore(drawn.plan, short_pauses(sheet, drawn.profile, rest_us))
        self._scorer = Scorer(sheet, settings.aim.target_rad(sheet.dog.backlash_rad))
        if log is None and wire is WireProfile.FD:
            self.controller.skip_unsubscribed(UNREAD)
            self._rig.skip_unsubscribed(UNREAD)
        self._driver = virtual_bench(
            setup,
            self.controller,
            self._rig,
            self._bench,
            Onlooker(self._scorer, SCORED_IDS, NO_STEP_US),
            on_frame=None if log is None else self._write,
        ).time

    @property
    def simulated_s(self) -> float:
        """Virtual time so far."""
        return self._driver.now_us / 1e6

    @property
    def bus_load(self) -> float:
        """The share of the time so far that the bus was taken, frames of average length."""
        return self._driver.bus.busy_us / max(1, self._driver.now_us)

    @property
    def rig_truth(self) -> Any:
        """What the rig knows of itself, for studies in the same process."""
        return self._rig.truth

    @property
    def as_built(self) -> dict[str, Any]:
        """What was drawn for the rig; nothing for the preset thesis."""
        return self._rig.as_built or {}

    def change_conditions(self, values: Mapping[str, float]) -> None:
        """Other oil, load, slope and supply from now on, by their as-built names."""
        self._rig.change_conditions(values)

    @property
    def strategy_errors(self) -> Counter[str]:
        """What was wrong with a user's own strategy, and how many shifts ended of it."""
        return Counter(self.controller.strategy_errors)

    def prepare(self) -> None:
        """Up to the request for the next shift, which no strategy has a say in."""
        bench, made = self._bench, self._made
        self._run(lambda: bench.index == made and bench.is_asking)

    def shift(self) -> ShiftRow | None:
        """The next shift of the plan, up to its outcome; None where it came to none, or was
        refused (`refusal`)."""
        self.prepare()
        bench, rows = self._bench, self._scorer.rows
        made, before, self._refused = self._made, len(rows), len(self._scorer.refusals)
        self._run(lambda: len(rows) > before or bench.index > made)
        self._made += 1
        if len(rows) > before:
            self._until_the_row_is_complete(rows)
        return rows[-1] if len(rows) > before else None

    @property
    def refusal(self) -> str | None:
        """The fault for which the last shift was refused; None: it was not."""
        return next(iter(self._scorer.refusals[self._refused :]), None)

    def _until_the_row_is_complete(self, rows: list[ShiftRow]) -> None:
        """Goes on until the gear of the last row has locked and the clutch's plates have met, if
        they do."""

        def is_complete() -> bool:
            return rows[-1].impact_complete and rows[-1].phases.closing_ms is not None

        self._driver.run(is_complete, self._driver.now_us + LOCK_WAIT_US)

    def _run(self, until: Callable[[], bool]) -> None:
        limit_us = self._driver.now_us + LIMIT_US_PER_SHIFT
        if not until() and not self._driver.run(until, limit_us):
            raise TimeoutError(
                f"shift {self._made + 1}: not over after {LIMIT_US_PER_SHIFT / 1e6:g} s"
            )

    def _write(self, time_us: int, frame: Frame) -> None:
        if self.log is not None:
            self.log.append((time_us, frame))

    def fork(self) -> ClosedLoop:
        """A copy that goes on as this one would."""
        memo = {id(shared): shared for shared in (*SHARED, self._sheet, self._settings)}
        return copy.deepcopy(self, memo)

    def use(self, settings: ControllerSettings, knows_all: bool) -> None:
        """Other engagement settings from here on; `knows_all`: by the rig's truth."""
        self.controller.change_settings(settings)
        if knows_all:
            self.controller.take_predictor_from(TrueState(self._sheet, self._rig.truth))
