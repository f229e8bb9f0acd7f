"""One place opens files for reading: it waits for no pipe, and reads no device for ever."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PARTS = ("meshpoint", "controller", "rig_sim", "dbc")
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
    "meshpoint/testbench/campaign/git_reference.py": "what git packed, and what a child said",
    "meshpoint/testbench/a2l/transport.py": "a file of the package",
    "meshpoint/testbench/firmware/build.py": "files of the package; what the compiler made",
    "meshpoint/testbench/show/messages.py": "a file of the package",
    "meshpoint/testbench/help/reference.py": "pages of this repository",
    "meshpoint/testbench/loop/node_patience.py": "the kernel's own files",
    "meshpoint/testbench/report/html.py": "a file of the package",
    "controller/calibration/file.py": "a folder, to bring a rename to disk; a new file",
    "dbc/classic/codecs.py": "a file of the package",
    "dbc/made.py": "files of the package",
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


def test_nothing_but_one_place_opens_a_file_to_read_it() -> None:
    found = {}
    for part in PARTS:
        for path in (ROOT / part).rglob("*.py"):
            lines = list(readings(path.read_text(encoding="utf-8")))
            if lines:
                found[path.relative_to(ROOT).as_posix()] = lines
    assert ONE_PLACE in found
    others = {name: lines for name, lines in found.items() if name not in EXCEPTIONS}
    assert set(others) == {ONE_PLACE}
    assert set(EXCEPTIONS) <= set(found), "an exception that is none any more"


@pytest.mark.parametrize(
    "line",
    [
        "open(path)", "open(path, 'rb')", "path.open('rb')", "path.open(mode='r')",
        "path.read_text()", "Path(name).read_bytes()", "os.open(path, 0)", "gzip.open(path)",
        "can.util.load_file_config(path)", "np.loadtxt(path)",
    ],
)  # fmt: skip
def test_a_file_opened_to_be_read_is_found(line: str) -> None:
    assert list(readings(line)) == [1]


@pytest.mark.parametrize(
    "line", ["open(path, 'w')", "path.open('x')", "chain.open(3)", "open_regular(path)"]
)
def test_what_writes_or_opens_no_file_is_not(line: str) -> None:
    assert not list(readings(line))
