"""Which strategy a recorded run is repeated with.

A log never brings code along: what a user's own strategy commanded can be repeated only where the
user names its file, and verified only where that is the file as it was then.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from meshpoint.controller.header import RunHeader
from meshpoint.controller.strategy_file import FORM, StrategyFile
from meshpoint.testbench.logs.replay import NotVerifiableError


class Chosen(NamedTuple):
    """The strategy that `--strategy` names; `file` where it is a user's own."""

    name: str
    file: StrategyFile | None


def header_for(header: RunHeader, chosen: Chosen | None, verify: bool) -> RunHeader:
    """The header to build the controller from. NotVerifiableError where the recorded strategy is
    needed and is not at hand."""
    settings, was = header.settings, header.settings.strategy_file
    if chosen is None:
        if was is None:
            return header
        raise NotVerifiableError(
            f"own strategy {was.name} is missing: the log was made with a user's own, name its "
            f"file with --strategy {FORM}"
        )
    if was is not None and chosen.file is not None and _is_same(was, chosen.file):
        # under its recorded name, so that the run hash is the recorded one
        return replace(header, settings=settings.with_strategy(was.name, chosen.file))
    if verify:
        raise NotVerifiableError(_why(header, chosen))
    return replace(header, settings=settings.with_strategy(chosen.name, chosen.file))


def _is_same(was: StrategyFile, now: StrategyFile) -> bool:
    return (was.sha256, was.class_name) == (now.sha256, now.class_name)


def _why(header: RunHeader, chosen: Chosen) -> str:
    """Why a run cannot be verified with another strategy than made it."""
    settings, was = header.settings, header.settings.strategy_file
    if was is None or chosen.file is None:
        return f"recorded with strategy {settings.strategy_name}, asked for is {chosen.name}"
    if was.class_name != chosen.file.class_name:
        return f"recorded with own strategy {was.name}, asked for is {chosen.name}"
    return (
        f"own strategy {was.name} has changed: recorded with SHA-256 {was.sha256[:16]}, "
        f"{chosen.file.path} has {chosen.file.sha256[:16]}"
    )
