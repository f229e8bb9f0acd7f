"""What a campaign runs: everything its results depend on, so that a worker needs nothing else."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from meshpoint.base.provenance import gearbox_words, provenance
from meshpoint.base.version import product_version
from meshpoint.bus.profile import WireProfile
from meshpoint.campaigns.sweep import BASE_POINT, SweepPoint, at_point
from meshpoint.controller.plan.strategist import AIMING
from meshpoint.controller.settings.settings import STRATEGY_NAMES, ControllerSettings
from meshpoint.controller.settings.strategy_file import StrategyFile
from meshpoint.dbc import DBC_SHA256
from meshpoint.gearbox import GearboxSheet
from meshpoint.rig_sim.settings import DEFAULT_PROFILE, Preset, Profile

TRUE_STATE: Final = "true_state"
TRUE_STATE_STRATEGY: Final = "target_phase"
"""The strategy that is given the true state."""
SEEDS_APART: Final = 1_000_000
"""Run k of campaign seed S has seed S * 10^6 + k: no two campaigns share a draw."""


@dataclass(frozen=True, slots=True)
class Job:
    """One run: its seed, and the point of the sweep it is made at."""

    seed: int
    point: SweepPoint = BASE_POINT


def is_blind(strategy: str) -> bool:
    """Whether a strategy of ours fires without any knowledge of the phase."""
    return strategy in STRATEGY_NAMES and strategy not in AIMING


@dataclass(frozen=True)
class CampaignSpec:
    """A campaign. `learn` shifts of each run come before its `judged` ones."""

    sheet: GearboxSheet
    settings: ControllerSettings
    preset: Preset
    strategies: tuple[str, ...]
    true_state: bool
    pairs: tuple[tuple[int, int], ...]
    learn: int
    judged: int
    seed: int
    as_built: Mapping[str, float] = field(default_factory=dict)
    sweep: tuple[SweepPoint, ...] = ()
    strategy_files: Mapping[str, StrategyFile] = field(default_factory=dict)
    """The users' own among `strategies`, by name."""
    profile: Profile = DEFAULT_PROFILE
    wire: WireProfile = WireProfile.FD
    judged_blind: int | None = None
    """Of the judged shifts of a run, this many are also made by strategies that are blind to the
    phase, if they are not the controller's own. None: all."""
    rest_us: int | None = None
    """In the old gear before a request; None: until the driveline has settled."""

    @property
    def names(self) -> tuple[str, ...]:
        """The strategies compared, `true_state` last."""
        return (*self.strategies, TRUE_STATE) if self.true_state else self.strategies

    @property
    def gearbox_words(self) -> str:
        """Which gearboxes it is of, as titles say it."""
        return gearbox_words(self.sheet, self.preset, self.profile, self.as_built)

    @property
    def own(self) -> str:
        """The strategy that the bench learns by and goes on by from shift to shift."""
        return self.settings.strategy_name

    def jobs(self, runs: int) -> list[Job]:
        """The runs: all of the base first, then of each point of the sweep the same seeds."""
        seeds = range(SEEDS_APART * self.seed, SEEDS_APART * self.seed + runs)
        return [Job(seed, point) for point in (BASE_POINT, *self.sweep) for seed in seeds]

    def at(self, point: SweepPoint) -> CampaignSpec:
        """The campaign as it is made at a point of its sweep."""
        sheet, settings, fixed = at_point(point, self.sheet, self.settings, self.preset)
        as_built = {**self.as_built, **fixed}
        return dataclasses.replace(self, sheet=sheet, settings=settings, as_built=as_built)

    def judges(self, shift: int) -> tuple[str, ...]:
        """The strategies that make a judged shift, by its number in the run."""
        if self.judged_blind is None or shift < self.judged_blind:
            return self.names
        return tuple(name for name in self.names if name == self.own or not is_blind(name))

    def engagement(self, name: str) -> ControllerSettings:
        """The controller's settings for a strategy or for `true_state`."""
        strategy = TRUE_STATE_STRATEGY if name == TRUE_STATE else name
        return self.settings.with_strategy(strategy, self.strategy_files.get(strategy))

    def to_json(self) -> dict[str, Any]:
        """Everything but what the hashes of the provenance say."""
        files = {name: file.sha256 for name, file in self.strategy_files.items()}
        wire = {} if self.wire is WireProfile.FD else {"wire": self.wire.value}
        return (
            ({"strategy_files": files} if files else {})
            | wire
            | ({} if self.judged_blind is None else {"judged_shifts_blind": self.judged_blind})
            | ({} if self.rest_us is None else {"rest_us": self.rest_us})
            | {
                "strategies": list(self.names),
                "pairs": [list(pair) for pair in self.pairs],
                "learning_shifts": self.learn,
                "judged_shifts": self.judged,
                "settings": self.settings.values(),
                "profile": self.profile,
                "as_built": dict(self.as_built),
                "sweep": [str(point) for point in self.sweep],
                "provenance": provenance(self.sheet, self.seed, self.preset.value, self.profile),
            }
        )

    @property
    def sha256(self) -> str:
        """Hash of all that a run's result depends on but its job: results of one hash go together.
        What is swept may be added to later, and so may runs."""
        values = self.to_json() | {"dbc": DBC_SHA256, "version": product_version()}
        del values["sweep"]
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
