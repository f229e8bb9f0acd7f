"""What a recorded run is repeated with, and which other controller is asked beside it.

A log never brings code along: what a user's own strategy commanded can be repeated only where the
user names its file, and verified only where that is the file as it was then.
"""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

from meshpoint.controller.run.kept import read_file
from meshpoint.controller.settings.header import RunHeader
from meshpoint.controller.settings.settings import ControllerSettings, load_settings
from meshpoint.controller.settings.strategy_file import StrategyFile
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.tables import key_of, load_toml
from meshpoint.logs.consumed import NotVerifiableError


class Chosen(NamedTuple):
    """What the other controller has otherwise than the recorded one; None: as recorded."""

    name: str | None = None
    """Its strategy; `file` where it is a user's own."""
    file: StrategyFile | None = None
    settings: Path | None = None
    """A settings file: what it holds is otherwise, the rest as recorded."""
    estimator: str | None = None
    calibration: Path | None = None
    """What it starts the run with."""
    sheet: GearboxSheet | None = None

    @property
    def changes(self) -> bool:
        """Whether there is another controller at all."""
        return any(part is not None for part in self)

    def __str__(self) -> str:
        parts = [
            self.name,
            f"settings {self.settings.name}" if self.settings else None,
            f"estimator {self.estimator}" if self.estimator else None,
            f"calibration {self.calibration.name}" if self.calibration else None,
            f"gearbox {self.sheet.name}" if self.sheet else None,
        ]
        return ", ".join(part for part in parts if part)


def recorded_header(header: RunHeader, chosen: Chosen | None, verify: bool) -> RunHeader:
    """The header to repeat the recorded controller from. NotVerifiableError where its strategy is
    not at hand, or where a run shall be verified with another one."""
    settings, was = header.settings, header.settings.strategy_file
    if chosen is not None and chosen.name is None:
        chosen = None
    if chosen is not None and _is_same(settings, chosen):
        # under its recorded name, so that the run hash is the recorded one
        return replace(header, settings=settings.with_strategy(settings.strategy_name, chosen.file))
    if chosen is not None and verify:
        raise NotVerifiableError(_why(settings, chosen))
    if was is None:
        return header
    if chosen is None:
        raise NotVerifiableError(
            f"the log was made with a strategy of the user's own, whose file a log does not bring "
            f"along: name it with --strategy {was.name}"
        )
    raise NotVerifiableError(
        f"own strategy {was.name} made this log: without it the state in which each shift was "
        f"begun cannot be repeated, so {chosen.name} cannot be judged from there"
    )


def other_header(header: RunHeader, chosen: Chosen) -> RunHeader:
    """The recorded header with what is asked about. TableError and CalibrationError name what is
    wrong in a file."""
    settings, sheet = header.settings, chosen.sheet or header.sheet
    if chosen.settings is not None:
        loaded, table = load_settings(chosen.settings), load_toml(chosen.settings)
        settings = replace(settings, **_held(loaded, table, settings))
        if "strategy" in table:
            settings = replace(settings, strategy_file=None)
    if chosen.name is not None:
        settings = settings.with_strategy(chosen.name, chosen.file)
    if chosen.estimator is not None:
        settings = replace(settings, estimator_name=chosen.estimator)
    calibration = header.calibration
    if chosen.calibration is not None:
        calibration = read_file(chosen.calibration, sheet)
    return replace(header, settings=settings, sheet=sheet, calibration=calibration)


def _held(loaded: Any, table: dict[str, Any], recorded: Any) -> dict[str, Any]:
    """The attributes that a file's table sets; groups with what it leaves out as recorded."""
    held = {}
    for field in fields(recorded):
        if not field.metadata or key_of(field) not in table:
            continue
        value, was = getattr(loaded, field.name), getattr(recorded, field.name)
        if "group" in field.metadata:
            value = replace(was, **_held(value, table[key_of(field)], was))
        held[field.name] = value
    return held


def _is_same(settings: ControllerSettings, chosen: Chosen) -> bool:
    was, now = settings.strategy_file, chosen.file
    if was is None or now is None:
        return was is None and now is None and settings.strategy_name == chosen.name
    return (was.sha256, was.class_name) == (now.sha256, now.class_name)


def _why(settings: ControllerSettings, chosen: Chosen) -> str:
    """Why a run cannot be verified with another strategy than made it."""
    was = settings.strategy_file
    if was is None or chosen.file is None:
        return f"recorded with strategy {settings.strategy_name}, asked for is {chosen.name}"
    if was.class_name != chosen.file.class_name:
        return f"recorded with own strategy {was.name}, asked for is {chosen.name}"
    return (
        f"own strategy {was.name} has changed: recorded with SHA-256 {was.sha256[:16]}, "
        f"{chosen.file.path} has {chosen.file.sha256[:16]}"
    )
