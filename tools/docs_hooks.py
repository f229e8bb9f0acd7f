"""Hooks of `mkdocs build`: every page is reachable, and files that pages link to are there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
OUTSIDE = re.compile(r"\]\(\.\./((?:examples|meshpoint)/[\w./-]+)\)")
PLACE = "source"


def on_config(config: Any) -> Any:
    """Adds the pages that the navigation does not name: under their folder's name, or "More"."""
    named = set(re.findall(r"[\w/]+\.md", str(config.nav)))
    docs = Path(config.docs_dir)
    others: dict[str, list[str]] = {}
    for page in sorted(path.relative_to(docs).as_posix() for path in docs.rglob("*.md")):
        if page not in named:
            folder, _, _ = page.rpartition("/")
            others.setdefault(folder.capitalize() or "More", []).append(page)
    config.nav += [{title: pages} for title, pages in others.items()]
    return config


def on_files(files: Files, config: Any) -> Files:
    """Adds every file outside of docs/ that a page in it links to."""
    for page in list(files.documentation_pages()):
        for path in OUTSIDE.findall(page.content_string):
            name = f"{PLACE}/{path}"
            if (ROOT / path).is_file() and files.get_file_from_path(name) is None:
                files.append(File.generated(config, name, abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Links to them as they lie in the site."""
    return OUTSIDE.sub(rf"]({PLACE}/\1)", markdown)
