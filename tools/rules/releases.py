"""What a release says of itself: one version, a changelog that is read at one sitting."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator

from rules import ROOT

CHANGELOG_LINES = 120
KINDS = {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security", "Known limits"}
"""Keep a Changelog's, and what a user should know that a version does not do."""
VERSION = re.compile(r"^version: (.+)$", re.MULTILINE)


def version() -> str:
    """The one that pyproject.toml has: all else reads it there, or is held against it here."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return str(project["version"])


def wrong_in(changelog: str, version: str) -> Iterator[str]:
    """What a changelog lacks, or has too much of."""
    if len(changelog.splitlines()) > CHANGELOG_LINES:
        yield f"more than {CHANGELOG_LINES} lines"
    sections = re.findall(r"^## (.+)$", changelog, re.MULTILINE)
    if sections[:1] != ["[Unreleased]"]:
        yield "does not begin with [Unreleased]"
    if not any(section.startswith(f"[{version}]") for section in sections):
        yield f"no section [{version}], the version of pyproject.toml"
    for kind in re.findall(r"^### (.+)$", changelog, re.MULTILINE):
        if kind not in KINDS:
            yield f"no heading of Keep a Changelog: {kind}"


def findings() -> Iterator[str]:
    """Of CHANGELOG.md and CITATION.cff."""
    for wrong in wrong_in((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), version()):
        yield f"CHANGELOG.md: {wrong}"
    cited = VERSION.findall((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    if cited != [version()]:
        yield f"CITATION.cff: version {', '.join(cited)}, not {version()} of pyproject.toml"
