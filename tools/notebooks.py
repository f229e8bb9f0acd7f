"""Runs the notebooks of examples/, each in a kernel of this Python, and keeps what they show.

    python tools/notebooks.py [NOTEBOOK ...]            runs these, or all, and writes them
    python tools/notebooks.py --check [NOTEBOOK ...]    writes nothing: do they still say the same?

What is kept is the same in every run with the packages of locks/: no times of execution, no version
of this Python. --check compares texts, and where pictures are, but not their bytes, which another
zlib packs otherwise. Ends with 1 where a cell fails or says something else, and says which.
"""

from __future__ import annotations

import argparse
import difflib
import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import matplotlib.font_manager  # noqa: F401  looks for fonts, which a kernel would speak of
import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
CELL_TIMEOUT_S = 600  # the last resort against a hang: a busy machine may compile for minutes


def read(path: Path) -> Any:
    """A notebook as it is kept."""
    return nbformat.read(path, as_version=4)


def run(notebook: Any, beside: Path) -> None:
    """Puts into its cells what they show, run in a folder with a copy of what lies beside it."""
    kept_metadata = dict(notebook.metadata)
    with tempfile.TemporaryDirectory(prefix="mp-") as scratch:  # short: there are sockets in it
        folder = shutil.copytree(beside, Path(scratch, "examples"))
        client = NotebookClient(
            notebook, kernel_name="python3", timeout=CELL_TIMEOUT_S,
            coalesce_streams=True, record_timing=False,
        )  # fmt: skip
        kernel = client.create_kernel_manager()  # no port of this machine is opened
        kernel.transport, kernel.connection_file = "ipc", str(Path(scratch, "kernel.json"))
        client.execute(cwd=str(folder), env=environment(scratch))
    notebook.metadata = nbformat.from_dict(kept_metadata)  # the kernel entered its Python's version


def environment(scratch: str) -> dict[str, str]:
    """Of the kernel: its commands are this Python's; nothing of this user decides how it looks."""
    return os.environ | {
        "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]),
        "IPYTHONDIR": str(Path(scratch, "ipython")),
        "MATPLOTLIBRC": os.devnull,
        "MPLBACKEND": "module://matplotlib_inline.backend_inline",
        "PYDEVD_DISABLE_FILE_VALIDATION": "1",  # it is told of Python's own frozen modules
    }


def said(notebook: Any) -> list[str]:
    """What its cells show, line by line; of a picture only that there is one."""
    lines: list[str] = []
    for number, cell in enumerate(notebook.cells):
        for output in cell.get("outputs", ()):
            shown = output.get("data", {"text/plain": output.get("text", "")})
            pictures = [kind for kind in shown if kind.startswith("image/")]
            told = [*pictures, *shown.get("text/plain", "").splitlines()]
            lines += [f"cell {number}: {line}" for line in told]
    return lines


def failed_cell(notebook: Any) -> str:
    """Which cell has failed, and of what."""
    for number, cell in enumerate(notebook.cells):
        for output in cell.get("outputs", ()):
            if output.output_type == "error":
                return f"cell {number}: {output.ename}: {output.evalue}"
    return "a cell failed"


def wrong_with(path: Path, check: bool) -> list[str]:
    """Runs a notebook, and writes it where it is not only to be checked; what is wrong with it."""
    kept, notebook = said(read(path)), read(path)
    try:
        run(notebook, path.parent)
    except CellExecutionError:
        return [f"{path.name}: {failed_cell(notebook)}"]
    if not check:
        nbformat.write(notebook, path)
        print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")
        return []
    found = list(difflib.unified_diff(kept, said(notebook), "kept", "now", n=0, lineterm=""))
    return [f"{path.name}: `make notebooks` keeps other outputs", *found] if found else []


def main(argv: list[str] | None = None) -> int:
    """Runs the notebooks that are named, or all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    parser.add_argument("notebooks", nargs="*", type=Path, metavar="NOTEBOOK")
    asked = parser.parse_args(argv)
    paths = asked.notebooks or sorted(EXAMPLES.glob("*.ipynb"))
    found = [line for path in paths for line in wrong_with(path, asked.check)]
    for line in found:
        print(line, file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
