"""Documents name only files and tests that exist, and link only to what is there."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from rules import PRODUCT, ROOT, name_of

DOCUMENTS = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
OF_THE_READER = {
    "FILE.py", "NAME.py", "senders.py", "controller.py", "gate.py", "brake_time.py", "next_gap.py",
    "test_coach.py", "test_mine.py",
}  # fmt: skip
"""Names that stand for a file that the reader has or is told to write."""
WITH_PYTHON = ("benchmarks", "examples", "tests", "tools", *PRODUCT)
PY_NAME = re.compile(r"(?<![\w/.*-])((?:[\w-]+/)*[\w-]+\.py)(?:::(\w+))?(?!\w)")
NEXT_TEST = re.compile(r"(?<![\w/])`::(\w+)`")
LINK = re.compile(r"\]\(([^)\s]+)\)")
MERGE = re.compile(r"^(?:<{7}|>{7}) .*", re.MULTILINE)
SETTING = re.compile(r"`(\w+)\.(?!py`)(\w+)`")
TO_BE_ADDED = {"guard.supply_high_bar"}
"""A setting that docs/change.md adds for practice."""
README_BYTES = 7_500
"""What is read at one sitting."""
LEAST_WALK = 40
"""Files that docs/frame_to_valve.md names at least."""
CHANGES = 13
"""What docs/change.md says in its first line."""


@cache
def bare_names() -> set[str]:
    """Names of all Python files of the repository, without their folders."""
    return {path.name for folder in WITH_PYTHON for path in (ROOT / folder).rglob("*.py")}


@cache
def text_of(document: Path) -> str:
    """All of it."""
    return document.read_text(encoding="utf-8")


@cache
def anchors(document: Path) -> set[str]:
    """The anchors of a document's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", text_of(document), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-") for text in headings}


def files(document: Path) -> Iterator[str]:
    """Python files that it names and that there are not."""
    for name, _ in PY_NAME.findall(text_of(document)):
        plain = name.rpartition("/")[2]
        found = (ROOT / name).is_file() or name in bare_names()
        if not found and plain not in OF_THE_READER:
            yield f"no file {name}"


def tests(document: Path) -> Iterator[str]:
    """Tests that it names and that there are not."""
    file = ""
    pattern = re.compile(rf"{PY_NAME.pattern}|{NEXT_TEST.pattern}")
    for name, first, further in pattern.findall(text_of(document)):
        file = name or file
        test = first or further
        if test and f"def {test}(" not in text_of(ROOT / file):
            yield f"no test {file}::{test}"


def links(document: Path) -> Iterator[str]:
    """Links that lead nowhere."""
    for link in LINK.findall(text_of(document)):
        path, _, anchor = link.partition("#")
        if "://" in path:
            continue
        target = document.parent / path if path else document
        if not target.exists() or (anchor and anchor not in anchors(target)):
            yield f"leads nowhere: {link}"


def merges(document: Path) -> Iterator[str]:
    """Marks that git has left of two versions of a passage."""
    for line in MERGE.findall(text_of(document)):
        yield f"left of a merge: {line}"


@cache
def settings_by_table() -> dict[str, set[str]]:
    """The keys of each table of the settings, by the generated reference; data sheet and rig have
    an `engine` of their own."""
    text = text_of(ROOT / "docs" / "reference" / "settings.md")
    _, *tables = re.split(r"^## `\[(\w+)\]`$", text, flags=re.MULTILINE)
    named = zip(tables[::2], tables[1::2], strict=True)
    found = {name: set(re.findall(r"^\| `(\w+)` \|", rows, re.MULTILINE)) for name, rows in named}
    del found["engine"]
    return found


def settings(document: Path) -> Iterator[str]:
    """Settings that it names and that there are not; decisions and changelog may tell of those that
    there were."""
    if document.parent.name == "decisions" or document.name == "CHANGELOG.md":
        return
    tables = settings_by_table()
    named = SETTING.findall(text_of(document))
    missing = {f"{table}.{key}" for table, key in named if key not in tables.get(table, {key})}
    for name in sorted(missing - TO_BE_ADDED):
        yield f"no setting {name}"


def walk() -> Iterator[str]:
    """In the table of docs/frame_to_valve.md a bare name is of the stage named last."""
    page = ROOT / "docs" / "frame_to_valve.md"
    text = text_of(page)
    table = text[text.index("| stage |") : text.index("## How long it takes")]
    stage, named = ROOT, []
    for row in table.splitlines():
        folder = re.match(r"\| `([\w/]+)/` \|", row)
        stage = ROOT / folder.group(1) if folder else stage
        named += [stage / name for name, _ in PY_NAME.findall(row) if "/" not in name]
    if len(named) <= LEAST_WALK:
        yield f"{name_of(page)}: names {len(named)} files of its stages"
    for path in named:
        if not path.is_file():
            yield f"{name_of(page)}: no file {name_of(path)}"


def tabs() -> Iterator[str]:
    """Pages that mkdocs.yml does not name get a tab of their folder's name: none that there is."""
    site = text_of(ROOT / "mkdocs.yml")
    names = re.findall(r"^  - (\w[^:\n]*):", site, re.MULTILINE)
    docs = ROOT / "docs"
    pages = [path.relative_to(docs).as_posix() for path in docs.rglob("*.md")]
    folders = {page.rpartition("/")[0] for page in pages if page not in site}
    names += [folder.capitalize() or "More" for folder in folders]
    if "Reference" not in names:
        yield "mkdocs.yml: no tab Reference"
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield f"mkdocs.yml: two tabs {name}"


def changes() -> Iterator[str]:
    """Each change of docs/change.md names files, a command and a test."""
    page = ROOT / "docs" / "change.md"
    sections = re.split(r"^## ", text_of(page), flags=re.MULTILINE)[1:]
    found = [section for section in sections if section.startswith("Another ")]
    if len(found) != CHANGES:
        yield f"{name_of(page)}: {len(found)} changes, not {CHANGES}"
    for section in found:
        title = section.splitlines()[0]
        if len(re.findall(r"^\d+\. .*", section, re.MULTILINE)) < 2:
            yield f"{name_of(page)}: {title}: fewer than two steps"
        if "```sh\n" not in section:
            yield f"{name_of(page)}: {title}: no command"
        if not re.search(r"`tests/\w+/test_\w+\.py`", section):
            yield f"{name_of(page)}: {title}: no test"


def findings() -> Iterator[str]:
    """Of every document, and of those with a rule of their own."""
    for document in DOCUMENTS:
        for rule in (files, tests, links, merges, settings):
            for finding in rule(document):
                yield f"{name_of(document)}: {finding}"
    if (ROOT / "README.md").stat().st_size > README_BYTES:
        yield f"README.md: more than {README_BYTES} bytes"
    yield from walk()
    yield from tabs()
    yield from changes()
