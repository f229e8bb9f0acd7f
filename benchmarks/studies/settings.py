"""The settings of all studies: `studies.toml`, and over it a file of the user's."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final

from benchmarks.studies.record import Common, Given, Study
from benchmarks.studies.registry import STUDY_NAMES
from meshpoint.gearbox import GearboxSheet, load_sheet
from meshpoint.gearbox.tables import TableError, load_toml, merged_tables, read_group

SHIPPED: Final = "studies.toml"
COMMON: Final = "common"


@dataclass(frozen=True)
class StudySettings:
    """Tables by study as they stand in the files, and what all share."""

    tables: dict[str, dict[str, Any]]
    source: str
    """For errors: which file is meant."""
    common: Common
    sheet: GearboxSheet

    def given(self, study: Study[Any]) -> Given[Any]:
        """What a study starts from. TableError names file, table, key, found and allowed."""
        where = f"{self.source} [{study.name}]"
        own = read_group(study.settings, self.tables.get(study.name, {}), where)
        return Given(self.common, own, self.sheet)


def shipped_text() -> str:
    """The file to copy and change."""
    return (resources.files("benchmarks.studies") / SHIPPED).read_text(encoding="utf-8")


def load_study_settings(path: Path | None) -> StudySettings:
    """The shipped settings; what the user's file names wins. TableError says what is wrong."""
    with resources.as_file(resources.files("benchmarks.studies") / SHIPPED) as shipped:
        tables = load_toml(shipped)
    source = SHIPPED
    if path is not None:
        source = path.name
        for name, table in load_toml(path).items():
            if name not in tables:
                allowed = ", ".join((COMMON, *STUDY_NAMES))
                raise TableError(f"{source}: unknown table [{name}], allowed are {allowed}")
            if not isinstance(table, dict):
                raise TableError(f"{source}: {name} = {table!r}, allowed is a table")
            tables[name] = merged_tables(tables[name], table)
    common = read_group(Common, tables[COMMON], f"{source} [{COMMON}]")
    return StudySettings(tables, source, common, load_sheet(common.gearbox))


def si_values(given: Given[Any]) -> dict[str, Any]:
    """A study's settings by attribute, SI: what its record carries."""
    own: dict[str, Any] = dataclasses.asdict(given.own)
    return {"common": dataclasses.asdict(given.common)} | own
