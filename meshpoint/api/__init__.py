"""The Python API: what `import meshpoint` gives (docs/api.md)."""

from meshpoint.api.bench import Bench
from meshpoint.api.choices import load_gearbox, load_settings
from meshpoint.api.live_bench import LiveBench
from meshpoint.api.logs import Log, shifts_table
from meshpoint.api.runs import Campaign, Replay, Simulation, campaign, replay, simulate
from meshpoint.api.watching import ShiftError
from meshpoint.base.errors import CommandError, RunError
from meshpoint.base.version import product_version
from meshpoint.bus.core import Core, Step
from meshpoint.bus.logs.reader import LogError
from meshpoint.controller.plan.strategy import EngagementStrategy, ReleasePlan
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.settings.strategy_file import StrategyError
from meshpoint.dbc import messages
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver, Transmitter
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.tables import TableError
from meshpoint.replays.session import Verification
from meshpoint.report.judged_rows import JudgedRow
from meshpoint.results.rows import ShiftRow, Summary

__version__ = product_version()

__all__ = [
    "Bench",
    "Campaign",
    "CommandError",
    "ControllerSettings",
    "Core",
    "EngagementStrategy",
    "Frame",
    "GearboxSheet",
    "JudgedRow",
    "LiveBench",
    "Log",
    "LogError",
    "Receiver",
    "ReleasePlan",
    "Replay",
    "RunError",
    "ShiftError",
    "ShiftRow",
    "Simulation",
    "Step",
    "StrategyError",
    "Summary",
    "TableError",
    "Transmitter",
    "Verification",
    "__version__",
    "campaign",
    "load_gearbox",
    "load_settings",
    "messages",
    "replay",
    "shifts_table",
    "simulate",
]
