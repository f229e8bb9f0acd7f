"""One HTML page with everything inside it: nothing fetched, every text escaped."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any, Final

POLICY: Final = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
)
"""The browser itself refuses whatever would come from elsewhere."""
Cell = tuple[str, str]
"""Text and class of a table's cell."""
NUMBER_CLASS: Final = "number"
STACKED: Final = "stacked"
"""A table whose rows a narrow page shows cell under cell."""


@dataclass(frozen=True)
class Page:
    """A page's contents: `data` is what scripts (of `own_text`) draw, with Plotly
    where they use it; each of `parts` stands in an element of its own, `data-NAME`, so that
    a page of many figures reads one when it draws it."""

    title: str
    body: list[str]
    data: dict[str, Any]
    plotly_js: str
    scripts: Sequence[str | Path]
    style: str = ""
    parts: Mapping[str, Any] = field(default_factory=dict)

    def text(self) -> str:
        """The whole page."""
        return "".join(self.pieces())

    def pieces(self) -> Iterator[str]:
        """The page piece by piece, for it is five megabytes."""
        css = own_text("report/report.css") + (own_text(self.style) if self.style else "")
        yield "<!doctype html>\n<html lang='en'>\n<head>\n<meta charset='utf-8'>\n"
        yield f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        yield "<meta name='viewport' content='width=device-width, initial-scale=1'>\n"
        yield f"<title>{escape(self.title)}</title>\n<style>\n{css}</style>\n"
        yield "</head>\n<body>\n"
        yield "\n".join(self.body)
        yield f"\n{_embedded('data', self.data)}"
        yield from (_embedded(f"data-{name}", part) for name, part in self.parts.items())
        yield "<script>"
        yield self.plotly_js
        yield "</script>\n"
        yield from (f"<script>\n{own_text(script)}</script>\n" for script in self.scripts)
        yield "</body>\n</html>\n"


def _embedded(name: str, values: Any) -> str:
    return f"<script type='application/json' id='{escape(name)}'>{json_text(values)}</script>\n"


def own_text(file: str | Path) -> str:
    """A file of the product's own by its name, such as a script; another one by its path."""
    found = file if isinstance(file, Path) else resources.files("meshpoint") / file
    return found.read_text(encoding="utf-8")


def json_text(values: dict[str, Any]) -> str:
    """JSON that cannot end the script element it stands in."""
    text = json.dumps(values, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def table(head: Sequence[Cell], rows: list[str], style: str = "") -> str:
    """A table of rows that are HTML already; `STACKED` ones need the names that
    `table_row` gives their cells."""
    cells = "".join(f"<th{class_of(style)}>{escape(text)}</th>" for text, style in head)
    body = "".join(rows)
    return f"<table{class_of(style)}><thead><tr>{cells}</tr></thead><tbody>\n{body}</tbody></table>"


def class_of(style: str) -> str:
    """The class attribute, or nothing."""
    return f' class="{style}"' if style else ""


def table_row(cells: Sequence[Cell], head: Sequence[Cell] = ()) -> str:
    """The cells of a table's row; head: of a stacked table, the names of these cells."""
    names = [f' data-name="{escape(name)}"' for name, _ in head] or [""] * len(cells)
    return "".join(
        f"<td{class_of(style)}{name}>{escape(text)}</td>"
        for (text, style), name in zip(cells, names, strict=True)
    )


def definitions(values: dict[str, str]) -> str:
    """Names and values, as a page's provenance."""
    items = "".join(
        f"<dt>{escape(name)}</dt><dd><code>{escape(value)}</code></dd>\n"
        for name, value in values.items()
    )
    return f"<dl>\n{items}</dl>"
