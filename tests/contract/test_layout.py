"""The house: one name for everything, and every folder with code is part of the package."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PRODUCT = ("controller", "dbc", "meshpoint", "rig_sim")
OLD_NAMES = {"bus", "controller", "dbc", "gearbox", "rig_sim", "testbench"}
SOURCES = sorted(
    path for folder in (*PRODUCT, "tests", "benchmarks") for path in (ROOT / folder).rglob("*.py")
)


MAY_IMPORT = re.compile(
    rf"^\s*(?:from|import) (?:.*[ ,])?(?:{'|'.join(OLD_NAMES)})\b", re.MULTILINE
)


def imported(path: Path) -> set[str]:
    """First names of everything a file imports; none where no line of it can hold an old one."""
    names: set[str] = set()
    text = path.read_text(encoding="utf-8")
    if not MAY_IMPORT.search(text):
        return names
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names.update(alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.add(node.module.partition(".")[0])
    return names


@pytest.mark.parametrize("folder", [*PRODUCT, "tests", "benchmarks"])
def test_everything_is_imported_under_the_one_name(folder: str) -> None:
    paths = [path for path in SOURCES if path.relative_to(ROOT).parts[0] == folder]
    assert paths
    found = {str(path.relative_to(ROOT)): imported(path) & OLD_NAMES for path in paths}
    assert not {path: names for path, names in found.items() if names}


def test_every_folder_with_code_is_a_package_that_says_what_it_is() -> None:
    folders = {path.parent for path in SOURCES if path.relative_to(ROOT).parts[0] in PRODUCT}
    assert len(folders) > 25
    for folder in sorted(folders):
        start = folder / "__init__.py"
        assert start.is_file(), f"{folder}: no __init__.py, so a wheel would lose it"
        assert ast.get_docstring(ast.parse(start.read_text(encoding="utf-8"))), start


def hidden_imports(path: Path) -> bool:
    """Whether a file imports something for the type checker alone."""
    text = path.read_text(encoding="utf-8")
    return "TYPE_CHECKING" in text and any(
        isinstance(node, ast.If)
        and "TYPE_CHECKING" in ast.unparse(node.test)
        and any(isinstance(part, (ast.Import, ast.ImportFrom)) for part in node.body)
        for node in ast.walk(ast.parse(text))
    )


def test_no_import_is_hidden_from_the_import_graph() -> None:
    paths = [
        path for path in SOURCES if path.relative_to(ROOT).parts[0] in PRODUCT[:1] + PRODUCT[3:]
    ]
    assert len(paths) > 100
    assert not [path for path in paths if hidden_imports(path)]
