"""`meshpoint show settings`: every key of a controller's settings file."""

from __future__ import annotations

import argparse
import dataclasses
import sys
import textwrap
from typing import Any, Final

from meshpoint.base.errors import CommandError
from meshpoint.base.exits import Exit
from meshpoint.cli import arguments
from meshpoint.controller.settings.settings import SettingsFile
from meshpoint.gearbox.keys import KeyGroup, groups_of, rounded, to_toml
from meshpoint.results.output import console, write_json

SETTINGS_TITLE: Final = (
    "Settings of `meshpoint controller --settings FILE`: every key with its default. A key that is "
    "left out keeps it."
)
TOP = "top"
INDENT = "      "
WIDEST = 100


def add_parser(things: Any) -> None:
    """Its arguments."""
    show: argparse.ArgumentParser = things.add_parser(
        "settings",
        help="every setting of the controller: unit, range, default, meaning",
        description="Every key that --settings FILE may hold (docs/reference/settings.md).",
    )
    show.add_argument("group", nargs="?", metavar="GROUP", help="one table alone, as limits")
    show.add_argument(
        "--toml",
        action="store_true",
        help="print them as a file with all defaults: to copy and change",
    )
    arguments.add_json(show)
    show.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Prints them."""
    groups = _chosen(groups_of(SettingsFile), namespace.group)
    if namespace.toml:
        sys.stdout.write(settings_toml(groups))
        return Exit.DONE
    if namespace.json is not None:
        keys = [dataclasses.asdict(key) for group in groups for key in group.keys]
        write_json(namespace.json, {"keys": keys})
    if namespace.json != "-":
        out = console(namespace.json)
        for group in groups:
            lines = key_lines(group, min(out.width, WIDEST))
            out.print("\n".join([*lines, ""]), soft_wrap=True)
    return Exit.DONE


def settings_toml(groups: list[KeyGroup] | None = None) -> str:
    """A settings file with all defaults."""
    return to_toml(groups or groups_of(SettingsFile), SETTINGS_TITLE)


def _chosen(groups: list[KeyGroup], name: str | None) -> list[KeyGroup]:
    if name is None:
        return groups
    found = [group for group in groups if (group.name or TOP) == name]
    if not found:
        known = ", ".join(group.name or TOP for group in groups)
        raise CommandError(f"there is no group {name!r}; groups are {known}")
    return found


def key_lines(group: KeyGroup, width: int) -> list[str]:
    """One table of the file: each key with its default, unit and range, and its meaning below."""
    title = f"[{group.name}]  {group.meaning}" if group.name else group.meaning
    lines = textwrap.wrap(title, width, subsequent_indent="  ")
    for key in group.keys:
        value = "is not set" if key.default is None else f"= {rounded(key.default)}"
        lines.append(f"  {f'{key.name} {value} {key.unit}'.rstrip():42}  {key.allowed}")
        lines += textwrap.wrap(key.meaning, width, initial_indent=INDENT, subsequent_indent=INDENT)
    return lines
