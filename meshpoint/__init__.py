"""meshpoint: a transmission controller that fires a sleeve so that tooth meets gap, and a rig.

    import meshpoint

    with meshpoint.Bench(seed=1, as_built="clean") as bench:
        bench.learn(10)
        print(bench.shift(10).contact)

The names in `__all__` are the Python API (docs/api.md); they follow semantic versioning, all else
may change in any version. They are loaded where they are asked for, so that importing meshpoint
costs next to nothing. The packages:

    meshpoint.controller   the node under test; in the repository the folder controller/
    meshpoint.rig_sim      the virtual gearbox; rig_sim/
    meshpoint.dbc          the wire contract; dbc/
    meshpoint.firmware     the board: C sources, and what builds and runs them; firmware/
    meshpoint.gearbox      the data sheet
    meshpoint.bus          how frames travel
    meshpoint.bench        controller and rig on one bus
    meshpoint.cli          the command line
    meshpoint.run, logs, replays, identify, commission, campaigns, bridges
                           commands and what they do, by task
    meshpoint.results, report
                           what a run gives, and the pages drawn of it
    meshpoint.api          what `import meshpoint` gives

docs/decisions/0012-one-name.md says why four of them lie beside this folder in the repository.
"""

import os
from typing import TYPE_CHECKING, Any

# All matrices here are small: a thread pool waits longer than they take, and two processes with a
# pool each wait for each other. It must be said before numpy is loaded.
for _library in ("OPENBLAS", "MKL", "OMP"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

if TYPE_CHECKING:
    from meshpoint.api import (
        Bench,
        Campaign,
        CommandError,
        ControllerSettings,
        Core,
        EngagementStrategy,
        Frame,
        GearboxSheet,
        JudgedRow,
        LiveBench,
        Log,
        LogError,
        Receiver,
        ReleasePlan,
        Replay,
        RunError,
        ShiftError,
        ShiftRow,
        Simulation,
        Step,
        StrategyError,
        Summary,
        TableError,
        Transmitter,
        Verification,
        __version__,
        campaign,
        load_gearbox,
        load_settings,
        messages,
        replay,
        shifts_table,
        simulate,
    )

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


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from meshpoint import api

    return getattr(api, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
