"""README as the wheel carries it: a package index has none of the files beside README."""

from __future__ import annotations

import re
import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
import setuptools.command.build_py  # noqa: F401 (setup.py finds it loaded)

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def description(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], str]:
    built_with = SimpleNamespace(find_packages=None, setup=None)
    monkeypatch.setitem(sys.modules, "setuptools", built_with)
    return cast("Callable[[str], str]", runpy.run_path(str(ROOT / "setup.py"))["description"])


def test_no_picture_and_no_link_into_the_repository_is_left(
    description: Callable[[str], str],
) -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = description(readme)
    assert "![" in readme and "](docs/" in readme
    assert "![" not in shown
    assert not re.search(r"\]\((?!https?:)", shown)
    assert "without its pictures" in shown.split("```")[0]


def test_a_link_becomes_the_name_of_its_file_and_code_stays(
    description: Callable[[str], str],
) -> None:
    shown = description(
        "# Title\n\n![A\npicture](a.png)\n\nIn the [glossary](docs/glossary.md#x), "
        "[docs/ci.md](docs/ci.md), [examples/](examples), [here](https://example.org).\n"
        "```python\nrow = cells[0](docs)\n```\n"
    )
    assert shown.startswith("# Title\n\n*")
    assert shown.endswith(
        "\n\nIn the glossary (docs/glossary.md), docs/ci.md, examples/, [here](https://example.org)."
        "\n```python\nrow = cells[0](docs)\n```\n"
    )
