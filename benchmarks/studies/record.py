"""What a study finds: statements with verdicts, figures, charts and tables. Data, no drawing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, StrEnum
from typing import Any, Final, Generic, Protocol, TypeVar

import numpy as np

from meshpoint.base.errors import CommandError
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.tables import TableError, count, group, quantity, text
from meshpoint.kernels.records import Vector
from meshpoint.rig_sim.settings import Profile
from meshpoint.units import RPM

RECORD_DIGITS: Final = 9
"""Significant digits of figures: less than the last bits, in which processors may differ."""


class ThesisVerdict(Enum):
    """Whether ours agrees with the thesis. The value is what the JSON says."""

    AGREES = True
    DIFFERS = False
    BY_CONSTRUCTION = "by construction"
    """It agrees, and had to: rig, data sheet or study was given the figure that is read out."""
    NOT_COMPARABLE = "not comparable"


@dataclass(frozen=True)
class Statement:
    """One thing the thesis says, ours beside it, and why the verdict is what it is."""

    thesis: str
    ours: str
    verdict: ThesisVerdict
    reason: str


class Style(StrEnum):
    """How a line of a chart is drawn."""

    LINE = "line"
    DASHED = "dashed"
    POINTS = "points"
    JOINED = "joined"
    BARS = "bars"


@dataclass(frozen=True)
class Line:
    """A series of a panel. x and y are of one length; NaN breaks the line."""

    name: str
    x: Sequence[float] | Vector
    y: Sequence[float] | Vector
    style: Style = Style.LINE


@dataclass(frozen=True)
class Panel:
    """Lines over the chart's x axis; `levels` are horizontal lines, such as the thesis's figures,
    `moments` vertical ones, by name."""

    y_title: str
    lines: tuple[Line, ...]
    levels: Mapping[str, float] = field(default_factory=dict)
    moments: Mapping[str, float] = field(default_factory=dict)
    y_range: tuple[float, float] | None = None
    log_y: bool = False


@dataclass(frozen=True)
class Chart:
    """One picture: panels above each other over one x axis."""

    name: str
    title: str
    x_title: str
    panels: tuple[Panel, ...]
    log_x: bool = False
    x_names: tuple[str, ...] = ()
    """Where x is not a quantity but a choice: the names of x = 1, 2, 3..."""


@dataclass(frozen=True)
class Table:
    """Rows of figures, written as CSV and shown on the page."""

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str | float | int | None, ...], ...]


@dataclass(frozen=True)
class Finding:
    """What a study comes to."""

    statements: tuple[Statement, ...]
    figures: Mapping[str, Any]
    """Ours: figures by name with their units, plain values for JSON."""
    charts: tuple[Chart, ...] = ()
    tables: tuple[Table, ...] = ()

    @property
    def verdict(self) -> ThesisVerdict:
        """Differs where any statement does; else agrees where any does that could have differed."""
        verdicts = {statement.verdict for statement in self.statements}
        for verdict in (
            ThesisVerdict.DIFFERS,
            ThesisVerdict.AGREES,
            ThesisVerdict.BY_CONSTRUCTION,
        ):
            if verdict in verdicts:
                return verdict
        return ThesisVerdict.NOT_COMPARABLE


class StudyJob(Protocol):
    """A piece of work worth a process of its own: a frozen dataclass, equal where its result is.

    Equal jobs of several studies are done once."""

    def __hash__(self) -> int:
        """Of its values."""

    def run(self) -> Any:
        """The work: a function of the job's values alone."""


@dataclass(frozen=True)
class Braking:
    """The upshift of sections 6.3 and 6.4: the layshaft is free from 0 on and turns at a speed,
    brake on, brake off, and some time after."""

    layshaft_rad_s: float = quantity("layshaft_rpm", 100.0, 5000.0, RPM)
    on_ms: int = count("brake_on_ms", 0, 5000)
    off_ms: int = count("brake_off_ms", 1, 5000)
    until_ms: int = count("until_ms", 10, 10000)

    def __post_init__(self) -> None:
        if not self.on_ms < self.off_ms < self.until_ms:
            raise TableError("brake_on_ms, brake_off_ms and until_ms must rise")


@dataclass(frozen=True)
class Common:
    """What all studies share."""

    seed: int = count("seed", 0, 2**31 - 1)
    gearbox: str = text("gearbox")
    profile: str = text("profile", *Profile)
    friction_nms: float = quantity("friction_nms", 0.0, 2.0)
    """Friction `c_tot` of 4.11 where a study is compared with figures that depend on it: the thesis
    does not give its own."""
    shift: Braking = group(Braking)


S = TypeVar("S")


@dataclass(frozen=True)
class Given(Generic[S]):
    """What a study starts from: settings, data sheet, and the results of its jobs."""

    common: Common
    own: S
    sheet: GearboxSheet
    results: Mapping[StudyJob, Any] = field(default_factory=dict)

    @property
    def eased(self) -> Given[S]:
        """The same on a sheet with the friction of `common`."""
        shafts = replace(self.sheet.shafts, friction_nms=self.common.friction_nms)
        return replace(self, sheet=replace(self.sheet, shafts=shafts))

    @property
    def profile(self) -> Profile:
        """From which ranges the gearboxes of the preset truck are drawn."""
        return Profile(self.common.profile)


def no_jobs(_given: Given[Any]) -> tuple[StudyJob, ...]:
    """Most studies take less time than a process needs to start."""
    return ()


@dataclass(frozen=True)
class Study(Generic[S]):
    """One study; `registry` says how to add another."""

    name: str
    title: str
    of: tuple[str, ...]
    """What of the thesis it reproduces, as `figure 6.1`, `table 6.1`, `section 7.2`."""
    settings: type[S]
    """A frozen dataclass as `meshpoint.gearbox.tables` reads it; its values stand in
    studies.toml."""
    conclude: Callable[[Given[S]], Finding]
    """From settings and the results of the jobs to the finding."""
    jobs: Callable[[Given[S]], tuple[StudyJob, ...]] = no_jobs


def figures(values: Any) -> Any:
    """The same values, rounded to `RECORD_DIGITS`, with numpy's types made Python's."""
    if isinstance(values, Mapping):
        return {str(key): figures(value) for key, value in values.items()}
    if isinstance(values, (list, tuple, np.ndarray)):
        return [figures(value) for value in values]
    if isinstance(values, (bool, np.bool_)):
        return bool(values)
    if isinstance(values, (float, np.floating)):
        return float(f"{values:.{RECORD_DIGITS}g}")
    if isinstance(values, np.integer):
        return int(values)
    return values


def rms(errors: Sequence[float] | Vector) -> float:
    """Thesis 5.10. CommandError on no errors: a study's settings left it nothing to look at."""
    values = np.asarray(errors, dtype=np.float64)
    if not values.size:
        raise CommandError("a study's settings leave no sample to take an RMS of")
    return float(np.sqrt(np.mean(values * values)))
