"""Hooks of `mkdocs build`: every page is reachable, and files that pages link to are there; a
notebook as a page with its pictures."""

from __future__ import annotations

import base64
import json
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files, InclusionLevel

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
            if path.endswith(".ipynb"):
                _add_notebook(files, config, path)
            elif (ROOT / path).is_file() and files.get_file_from_path(name) is None:
                files.append(File.generated(config, name, abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Links to them as they lie in the site."""
    return OUTSIDE.sub(lambda link: f"]({PLACE}/{_as_page(link[1])})", markdown)


def _as_page(path: str) -> str:
    return path.replace(".ipynb", ".md")


def _add_notebook(files: Files, config: Any, path: str) -> None:
    """A page of the notebook's cells and of what they showed, and its pictures beside it."""
    page = f"{PLACE}/{_as_page(path)}"
    if files.get_file_from_path(page) is not None:
        return
    texts: list[str] = []
    for number, cell in enumerate(json.loads((ROOT / path).read_text("utf-8"))["cells"]):
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            texts.append(_to_pages(source, path))
            continue
        texts.append(f"```python\n{source}\n```")
        for shown in _shown(cell):
            if isinstance(shown, str):
                texts.append(f"```text\n{shown.rstrip()}\n```")
                continue
            picture = page.replace(".md", f"_{number}.png")
            files.append(File.generated(config, picture, content=shown))
            texts.append(f"![What the cell draws]({posixpath.basename(picture)})")
    files.append(
        File.generated(
            config, page, content="\n\n".join(texts), inclusion=InclusionLevel.NOT_IN_NAV
        )
    )


def _shown(cell: dict[str, Any]) -> Iterator[str | bytes]:
    """Texts and pictures (PNG) that a cell's outputs are."""
    for output in cell["outputs"]:
        data = output.get("data", {"text/plain": output.get("text", "")})
        if "image/png" in data:
            yield base64.b64decode(data["image/png"])
        else:
            yield "".join(data["text/plain"])


def _to_pages(markdown: str, path: str) -> str:
    """A notebook's links to files beside it and to pages, as they lie in the site."""
    back = "../" * (path.count("/") + 1)
    return markdown.replace("](../docs/", f"]({back}").replace(".ipynb)", ".md)")
