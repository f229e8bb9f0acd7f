"""README and docs name only files and tests that exist, and link only to what is there."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
OF_THE_READER = {
    "FILE.py", "NAME.py", "senders.py", "controller.py", "gate.py", "brake_time.py", "next_gap.py",
    "test_coach.py", "test_mine.py",
}  # fmt: skip
"""Names that stand for a file that the reader has or is told to write."""
PY_NAME = re.compile(r"(?<![\w/.*-])((?:[\w-]+/)*[\w-]+\.py)(?:::(\w+))?(?!\w)")
NEXT_TEST = re.compile(r"(?<![\w/])`::(\w+)`")
LINK = re.compile(r"\]\(([^)\s]+)\)")
SETTING = re.compile(r"`(\w+)\.(?!py`)(\w+)`")
TO_BE_ADDED = {"guard.supply_high_bar"}
"""A setting that docs/change.md adds for practice."""

every_document = pytest.mark.parametrize(
    "document", DOCUMENTS, ids=[path.relative_to(ROOT).as_posix() for path in DOCUMENTS]
)


def bare_names() -> set[str]:
    """Names of all Python files of the repository, without their folders."""
    folders = ("benchmarks", "controller", "dbc", "examples", "meshpoint", "rig_sim", "tests")
    return {path.name for folder in folders for path in (ROOT / folder).rglob("*.py")}


def anchors(document: Path) -> set[str]:
    """The anchors of a document's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", document.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-") for text in headings}


@every_document
def test_every_python_file_it_names_exists(document: Path) -> None:
    files, missing = bare_names(), []
    for name, _ in PY_NAME.findall(document.read_text(encoding="utf-8")):
        plain = name.rpartition("/")[2]
        found = (ROOT / name).is_file() or name in files
        if not found and plain not in OF_THE_READER:
            missing.append(name)
    assert missing == []


def test_the_walk_names_the_files_of_its_stages() -> None:
    """In the table of docs/frame_to_valve.md a bare name is of the stage named last."""
    text = (ROOT / "docs" / "frame_to_valve.md").read_text(encoding="utf-8")
    table = text[text.index("| stage |") : text.index("## How long it takes")]
    stage, named = ROOT, []
    for row in table.splitlines():
        folder = re.match(r"\| `([\w/]+)/` \|", row)
        stage = ROOT / folder.group(1) if folder else stage
        named += [stage / name for name, _ in PY_NAME.findall(row) if "/" not in name]
    assert len(named) > 40
    assert [str(path) for path in named if not path.is_file()] == []


def settings_by_table() -> dict[str, set[str]]:
    """The keys of each table of the settings, by the generated reference."""
    text = (ROOT / "docs" / "reference" / "settings.md").read_text(encoding="utf-8")
    _, *tables = re.split(r"^## `\[(\w+)\]`$", text, flags=re.MULTILINE)
    named = zip(tables[::2], tables[1::2], strict=True)
    return {name: set(re.findall(r"^\| `(\w+)` \|", rows, re.MULTILINE)) for name, rows in named}


@every_document
def test_every_setting_it_names_exists(document: Path) -> None:
    """Decisions may tell of settings that there were; data sheet and rig have an `engine` of their
    own."""
    if document.parent.name == "decisions":
        return
    tables = settings_by_table()
    del tables["engine"]
    assert "slip_low_rpm" in tables["guard"]
    named = SETTING.findall(document.read_text(encoding="utf-8"))
    missing = {f"{table}.{key}" for table, key in named if key not in tables.get(table, {key})}
    assert missing - TO_BE_ADDED == set()


@every_document
def test_every_test_it_names_exists(document: Path) -> None:
    missing, file = [], ""
    pattern = re.compile(rf"{PY_NAME.pattern}|{NEXT_TEST.pattern}")
    for name, first, further in pattern.findall(document.read_text(encoding="utf-8")):
        file = name or file
        test = first or further
        if test and f"def {test}(" not in (ROOT / file).read_text(encoding="utf-8"):
            missing.append(f"{file}::{test}")
    assert missing == []


@every_document
def test_every_link_leads_somewhere(document: Path) -> None:
    missing = []
    for link in LINK.findall(document.read_text(encoding="utf-8")):
        path, _, anchor = link.partition("#")
        if "://" in path:
            continue
        target = document.parent / path if path else document
        if not target.exists() or (anchor and anchor not in anchors(target)):
            missing.append(link)
    assert missing == []


def test_readme_is_read_at_one_sitting() -> None:
    assert (ROOT / "README.md").stat().st_size <= 7_500


def test_every_tab_of_the_site_has_a_name_of_its_own() -> None:
    """Pages that mkdocs.yml does not name get a tab of their folder's name."""
    site = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    tabs = re.findall(r"^  - (\w[^:\n]*):", site, re.MULTILINE)
    docs = ROOT / "docs"
    pages = [path.relative_to(docs).as_posix() for path in docs.rglob("*.md")]
    folders = {page.rpartition("/")[0] for page in pages if page not in site}
    tabs += [folder.capitalize() or "More" for folder in folders]
    assert "Reference" in tabs
    assert sorted(tabs) == sorted(set(tabs))


def test_each_change_names_files_a_command_and_a_test() -> None:
    text = (ROOT / "docs" / "change.md").read_text(encoding="utf-8")
    sections = re.split(r"^## ", text, flags=re.MULTILINE)[1:]
    changes = [section for section in sections if section.startswith("Another ")]
    assert len(changes) == 11
    for section in changes:
        title = section.splitlines()[0]
        steps = re.findall(r"^\d+\. .*", section, re.MULTILINE)
        assert len(steps) >= 2, title
        assert "```sh\n" in section, title
        assert re.search(r"`tests/\w+/test_\w+\.py`", section), title
