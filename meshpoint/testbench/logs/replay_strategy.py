"""Which strategy a recorded run is repeated with, and which one is asked beside it.

A log never brings code along: what a user's own strategy commanded can be repeated only where the
user names its file, and verified only where that is the file as it was then.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from meshpoint.controller.header import RunHeader
from meshpoint.controller.settings import ControllerSettings
from meshpoint.controller.strategy_file import FORM, StrategyFile
from meshpoint.testbench.logs.replay import NotVerifiableError


class Chosen(NamedTuple):
    """The strategy that `--strategy` names; `file` where it is a user's own."""

    name: str
    file: StrategyFile | None


def recorded_header(header: RunHeader, chosen: Chosen | None, verify: bool) -> RunHeader:
    """The header to repeat the recorded controller from. NotVerifiableError where its strategy is
    not at hand, or where a run shall be verified with another one."""
    settings, was = header.settings, header.settings.strategy_file
    if chosen is not None and _is_same(settings, chosen):
        # under its recorded name, so that the run hash is the recorded one
        return replace(header, settings=settings.with_strategy(settings.strategy_name, chosen.file))
    if chosen is not None and verify:
        raise NotVerifiableError(_why(settings, chosen))
    if was is None:
        return header
    if chosen is None:
        raise NotVerifiableError(
            f"own strategy {was.name} is missing: the log was made with a user's own, name its "
            f"file with --strategy {FORM}"
        )
    raise NotVerifiableError(
        f"own strategy {was.name} made this log: without it the state in which each shift was "
        f"begun cannot be repeated, so {chosen.name} cannot be judged from there"
    )


def other_settings(header: RunHeader, chosen: Chosen) -> ControllerSettings:
    """The recorded settings with the strategy that is asked about."""
    return header.settings.with_strategy(chosen.name, chosen.file)


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
