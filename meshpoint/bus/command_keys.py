"""The keys of the commands, from a file."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from meshpoint.dbc.layout import CODECS
from meshpoint.gearbox.tables import TableError, load_toml, read_group, text

KEY_BYTES: Final = 16
_OTHERS: Final = 0o077


class KeysError(TableError):
    """A key file that cannot be used; names file, key and what is allowed, never a key."""


@dataclass(frozen=True)
class KeysFile:
    """The file: 32 hexadecimal digits for each command, all different."""

    valve_command: str = text("valve_command")
    clutch_command: str = text("clutch_command")
    engine_request: str = text("engine_request")


@dataclass(frozen=True, repr=False)
class CommandKeys:
    """AES-128 keys by the identifier of the command they prove."""

    by_id: dict[int, bytes]


_COMMANDS: Final = {
    "valve_command": "ValveCommand",
    "clutch_command": "ClutchCommand",
    "engine_request": "TSC1",
}


def make_keys(keys: dict[str, bytes], where: str) -> CommandKeys:
    """Keys by the names of the file; KeysError where one is of another length or there twice."""
    by_id = {CODECS[_COMMANDS[name]].spec.can_id: key for name, key in keys.items()}
    if any(len(key) != KEY_BYTES for key in by_id.values()):
        raise KeysError(f"{where}: a key has {2 * KEY_BYTES} hexadecimal digits")
    if len(set(by_id.values())) < len(_COMMANDS):
        raise KeysError(f"{where}: {', '.join(_COMMANDS)}: each has a key of its own")
    return CommandKeys(by_id)


def load_keys(path: Path) -> CommandKeys:
    """The keys of a TOML file that nobody but its owner can read. KeysError, TableError."""
    table = load_toml(path)
    if os.name == "posix" and path.stat().st_mode & _OTHERS:
        raise KeysError(f"{path}: others can read or write it; chmod 600 {path.name}")
    file = read_group(KeysFile, table, path.name)
    keys = {}
    for name in _COMMANDS:
        try:
            keys[name] = bytes.fromhex(getattr(file, name))
        except ValueError:
            raise KeysError(f"{path.name}: {name} has {2 * KEY_BYTES} hexadecimal digits") from None
    return make_keys(keys, path.name)
