"""What the makers of files do: write what is made from meshpoint.dbc, or compare it."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path


def write_or_compare(
    module: str, path: Path, content: bytes, arguments: list[str] | None = None
) -> int:
    """The command of a module that makes a file: an exit code, 1 where `--check` finds that the
    file is another."""
    parser = argparse.ArgumentParser(prog=f"python -m {module}")
    parser.add_argument("--check", action="store_true", help="compare only; exit 1 on a difference")
    if not parser.parse_args(arguments).check:
        path.write_bytes(content)
        return 0
    if path.exists() and path.read_bytes() == content:
        return 0
    print(f"{path.name} is not that of the DBC: run python -m {module}", file=sys.stderr)
    return 1
