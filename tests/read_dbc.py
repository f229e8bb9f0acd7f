"""DBC files as cantools reads them, each once a process."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import cantools.database


@cache
def database(path: Path, frame_id_mask: int | None = None) -> Any:
    """A file, read without any code of ours; nobody changes it."""
    return cantools.database.load_file(path, frame_id_mask=frame_id_mask)
