"""JUnit XML: statements about a run as test cases, for a CI server."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

from meshpoint.base.errors import unwritten


def write_junit(path: Path, command: str, cases: Sequence[tuple[str, str]], out: str) -> None:
    """A test case for each (name, why it failed), the latter empty where it passed; `out` is the
    suite's output. CommandError or RunError where it cannot be written."""
    text = "\n".join(
        [
            '<?xml version="1.0" encoding="utf-8"?>',
            f'<testsuite name="meshpoint {command}" tests="{len(cases)}" '
            f'failures="{sum(bool(why) for _, why in cases)}">',
            *(_case(command, name, why) for name, why in cases),
            f"<system-out>{escape(out)}</system-out>",
            "</testsuite>\n",
        ]
    )
    write_text(path, text)


def write_text(path: Path, text: str) -> None:
    """Writes a file. CommandError or RunError where it cannot be written."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise unwritten(path, error) from error


def _case(command: str, name: str, why: str) -> str:
    begin = f'<testcase classname="meshpoint.{command}" name={quoteattr(name)}'
    return f"{begin}><failure message={quoteattr(why)}/></testcase>" if why else f"{begin}/>"
