"""The strategies by name. A new one: a file in this folder, and a line here.

Its name is a value of the DBC's value table `Strategy`, in lower case, so that the frames can tell
which strategy acted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from meshpoint.controller.plan.strategies.base import EngagementStrategy
from meshpoint.controller.plan.strategies.own import OwnStrategy
from meshpoint.controller.plan.strategies.speed_window import SpeedWindow
from meshpoint.controller.plan.strategies.speed_window_anticipating import (
    SpeedWindowAnticipating,
)
from meshpoint.controller.plan.strategies.target_phase import TargetPhase
from meshpoint.controller.settings.settings import STRATEGY_NAMES, ControllerSettings
from meshpoint.gearbox import GearboxSheet

MakeStrategy = Callable[[GearboxSheet, ControllerSettings], EngagementStrategy]

STRATEGIES: Final[Mapping[str, MakeStrategy]] = {
    "speed_window": SpeedWindow,
    "speed_window_anticipating": SpeedWindowAnticipating,
    "target_phase": TargetPhase,
}
AIMING: Final = frozenset(name for name in STRATEGY_NAMES if vars(STRATEGIES[name])["aims"])
"""Those that aim at a phase."""


def make_strategy(sheet: GearboxSheet, settings: ControllerSettings) -> EngagementStrategy:
    """The strategy that the settings ask for. StrategyError where a user's own cannot be made."""
    if settings.strategy_file is not None:
        return OwnStrategy(settings.strategy_file, sheet, settings)
    return STRATEGIES[settings.strategy_name](sheet, settings)
