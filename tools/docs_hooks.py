"""A hook of `mkdocs build`: files of the repository that a page links to come with the site."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
OUTSIDE = re.compile(r"\]\(\.\./((?:examples|meshpoint)/[\w./-]+)\)")
PLACE = "source"


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
