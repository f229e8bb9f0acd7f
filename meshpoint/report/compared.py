"""A comparison as one HTML page: tables alone, nothing fetched."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from meshpoint.report.html import POLICY, Cell, own_text, table, table_row


def compared_page(
    title: str, verdict: str, tables: Sequence[tuple[str, Sequence[str], Sequence[Sequence[str]]]]
) -> str:
    """The page; tables: heading, names of columns, rows of text."""
    body = [f"<h1>{escape(title)}</h1>", f"<p>{escape(verdict)}</p>"]
    for heading, columns, rows in tables:
        head: list[Cell] = [(column, "") for column in columns]
        made = [f"<tr>{table_row([(cell, '') for cell in row])}</tr>\n" for row in rows]
        body.append(f"<h2>{escape(heading)}</h2>")
        body.append(f'<div class="scroll">{table(head, made)}</div>' if made else "<p>None.</p>")
    return "".join(
        (
            "<!doctype html>\n<html lang='en'>\n<head>\n<meta charset='utf-8'>\n",
            f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n',
            f"<title>{escape(title)}</title>\n<style>\n{own_text('report/report.css')}</style>\n",
            "</head>\n<body>\n",
            "\n".join(body),
            "\n</body>\n</html>\n",
        )
    )
