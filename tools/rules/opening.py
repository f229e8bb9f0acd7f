"""One place opens files for reading: it waits for no pipe, and reads no device for ever."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from rules import PRODUCT, ROOT, name_of

ONE_PLACE = "meshpoint/gearbox/reading.py"
EXCEPTIONS = {
    "meshpoint/api/reference.py": "a page of this repository",
    "meshpoint/bus/authentication/frames.py": "a file of the package",
    "meshpoint/bus/local/hub.py": "/dev/null",
    "meshpoint/bus/local/listening.py": "a folder, for its lock",
    "meshpoint/bus/local/own_files.py": "a hub's own lock and log, which it writes",
    "meshpoint/bus/options.py": "the kernel's own files; python-can's own places",
    "meshpoint/bus/pace.py": "opened to be written, which waits for no pipe; of a fixed size",
    "meshpoint/bus/standard_error.py": "/dev/null",
    "meshpoint/kernels/digest.py": "files of the package",
    "meshpoint/kernels/folder.py": "its own cache: O_NOFOLLOW, owner, mode and size are checked",
    "meshpoint/campaigns/git_reference.py": "what git packed, and what a child said",
    "meshpoint/bridges/a2l_transport.py": "a file of the package",
    "firmware/build.py": "files of the package; what the compiler made",
    "meshpoint/cli/show_messages.py": "a file of the package",
    "meshpoint/cli/reference.py": "pages of this repository",
    "meshpoint/bench/node_patience.py": "the kernel's own files",
    "meshpoint/report/html.py": "a file of the package",
    "controller/run/kept.py": "a folder, to bring a rename to disk; a new file",
    "dbc/classic/codecs.py": "a file of the package",
    "dbc/made.py": "files of the package",
    "dbc/schema.py": "files of the package",
    "dbc/source.py": "a file of the package",
    "dbc/truck.py": "a file of the package",
}
READING = {"read_text", "read_bytes", "load_file_config", "fromfile", "genfromtxt", "loadtxt"}
MODULES = {"os", "gzip", "bz2", "lzma", "io", "codecs", "tarfile", "zipfile"}
WRITING = {"w", "wb", "x", "xb", "a", "ab"}


def opens_to_read(call: ast.Call) -> bool:
    """Whether a call opens or reads a file by its name."""
    name = call.func
    if isinstance(name, ast.Name):
        return name.id == "open" and mode_of(call, 1) not in WRITING
    if not isinstance(name, ast.Attribute):
        return False
    if name.attr != "open":
        # Of a file that is in the package, importlib's `files` may be read.
        return name.attr in READING
    if isinstance(name.value, ast.Name) and name.value.id in MODULES:
        return not any(word.arg == "fileobj" for word in call.keywords)
    is_path = bool(call.args or call.keywords) and isinstance(mode_of(call, 0), str)
    return is_path and mode_of(call, 0) not in WRITING


def mode_of(call: ast.Call, place: int) -> object:
    """The mode that a call of `open` names."""
    named = [word.value for word in call.keywords if word.arg == "mode"]
    found = named or call.args[place : place + 1]
    return found[0].value if found and isinstance(found[0], ast.Constant) else None


def readings(source: str) -> Iterator[int]:
    """The lines that open a file to read it."""
    if not any(word in source for word in ("open", *READING)):
        return
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and opens_to_read(node):
            yield node.lineno


def findings() -> Iterator[str]:
    """Of the whole product; and exceptions that are none any more."""
    found = {}
    for part in PRODUCT:
        for path in sorted((ROOT / part).rglob("*.py")):
            lines = list(readings(path.read_text(encoding="utf-8")))
            if lines:
                found[name_of(path)] = lines
    for name, lines in found.items():
        if name not in EXCEPTIONS and name != ONE_PLACE:
            yield f"{name}:{lines[0]}: opens a file to read it; {ONE_PLACE} does that"
    for name in sorted({ONE_PLACE, *EXCEPTIONS} - found.keys()):
        yield f"{name}: opens nothing any more, but tools/rules/opening.py names it"
