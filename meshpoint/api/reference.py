"""docs/reference/api.md, made of the docstrings: `python -m meshpoint.api.reference FILE`.

With `--check` behind the file it writes nothing, and ends with 1 where the file is out of date.
"""

from __future__ import annotations

import enum
import inspect
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import meshpoint
from meshpoint import api
from meshpoint.cli.reference import GENERATED
from meshpoint.gearbox.keys import field_docs

HEAD: Final = f"""\
# The Python API, name by name

{GENERATED} [api.md](../api.md) says what it is for.

Types: `PathLike` is a text or a `pathlib.Path`; `Strategy` a text or a class; `AsBuilt` a profile's
name, a file, or values by name; `Pairs` a tuple of `(from, to)`; `pa.Table` is a `pyarrow.Table`.
"""
INHERITED: Final = (object, tuple, Exception)


def api_page() -> str:
    """The page."""
    return "\n".join([HEAD, *_entries()]).rstrip("\n") + "\n"


def _entries() -> Iterator[str]:
    for name in meshpoint.__all__:
        value = getattr(api, name)
        if name == "__version__":
            yield "## `__version__`\n\nThe version of the product, as text.\n"
        elif inspect.ismodule(value):
            yield f"## `{name}`\n\n{inspect.getdoc(value)} `meshpoint show messages` lists them.\n"
        elif inspect.isclass(value):
            yield from _class(name, value)
        else:
            yield f"## `{name}`\n\n{_text(value)}\n\n`{name}{_signature(value)}`\n"


def _class(name: str, kind: type) -> Iterator[str]:
    docs = field_docs(kind)
    yield f"## class `{name}`\n\n{_text(kind)}\n"
    if issubclass(kind, enum.Enum):
        members = ", ".join(f"`{member.name}`" for member in kind)
        yield f"Members: {members}.\n"
        return
    if "__init__" in vars(kind) and not _is_plain(kind):
        yield f"`{name}{_signature(kind.__init__)}`\n"
    fields = getattr(kind, "_fields", None) or tuple(getattr(kind, "__dataclass_fields__", ()))
    if fields and docs.keys() >= set(fields):
        yield "Fields:\n"
        yield from (f"- `{field}`: {docs[field]}" for field in fields)
        yield "\nWith these:\n" if any(_members(kind)) else ""
    elif fields:
        yield f"Fields: {', '.join(f'`{field}`' for field in fields)}.\n"
    for member, value in _members(kind):
        if isinstance(value, property):
            yield f"- `{member}`: {_indented(value)}"
        else:
            yield f"- `{member}{_signature(value)}`: {_indented(value)}"
    yield ""


def _is_plain(kind: type[Any]) -> bool:
    """Whether nobody makes one, or its fields say how."""
    is_data = hasattr(kind, "__dataclass_fields__") or hasattr(kind, "_fields")
    return is_data or issubclass(kind, Exception) or getattr(kind, "_is_protocol", False)


def _members(kind: type[Any]) -> Iterator[tuple[str, Any]]:
    """Public methods and properties with a docstring, inherited ones of ours included."""
    seen: set[str] = set()
    for part in kind.__mro__:
        if part in INHERITED or not part.__module__.startswith("meshpoint"):
            continue
        for name, value in vars(part).items():
            value = value.__get__(None, part) if isinstance(value, staticmethod) else value
            value = property(value.func) if hasattr(value, "func") else value
            documented = inspect.isfunction(value) or isinstance(value, property)
            if name.startswith("_") or name in seen or not documented or not inspect.getdoc(value):
                continue
            seen.add(name)
            yield name, value


def _signature(function: Any) -> str:
    parameters = [
        parameter
        for name, parameter in inspect.signature(function).parameters.items()
        if name != "self"
    ]
    shown = inspect.Signature(parameters, return_annotation=inspect.Signature.empty)
    text = re.sub(r": '([^']*)'", r": \1", str(shown)).replace(" = ", "=")
    return re.sub(r"<\w+\.\w+: '?(\w+)'?>", r"'\1'", text)  # an enumeration's member as its value


def _text(value: Any) -> str:
    """A docstring; its lines `name: meaning` as a list, where no sentence goes on in them."""
    text = inspect.getdoc(value) or ""
    item = r"(\A|\n\n|[.:;]\n)([a-z_]+(?:, [a-z_]+)*): "
    text = re.sub(item, r"\1- `\2`: ", text)
    text = re.sub(r"\n    (?=\S)", "\n  ", text)
    return re.sub(r"\n(- `.*(?:\n(?:- `|  ).*)*)(?=\n\S|\Z)", r"\n\n\1\n", text).replace(
        "\n\n\n", "\n\n"
    )


def _indented(value: Any) -> str:
    """A docstring as one item of a list."""
    return re.sub(r"\n(?=\S)", "\n  ", _text(value))


def main(given: Sequence[str] | None = None) -> int:
    """Writes or checks the page."""
    words = sys.argv[1:] if given is None else list(given)
    path, page = Path(words[0]), api_page()
    if path.exists() and path.read_text(encoding="utf-8") == page:
        return 0
    if "--check" in words:
        sys.stderr.write(f"out of date: {path}; `make reference` writes it\n")
        return 1
    path.write_text(page, encoding="utf-8", newline="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
