"""A plugin of pytest: one file is imported as a mutant. Environment: MUTATED_FILE is imported from
MUTATED_SOURCE."""

from __future__ import annotations

import importlib.machinery
import os
from pathlib import Path
from types import CodeType
from typing import Any

_FILE = os.environ["MUTATED_FILE"]
_SOURCE = Path(os.environ["MUTATED_SOURCE"]).read_text(encoding="utf-8")
_get_code: Any = importlib.machinery.SourceFileLoader.get_code


def _mutated(self: Any, fullname: str) -> CodeType | None:
    if os.path.realpath(self.path) == _FILE:
        return compile(_SOURCE, _FILE, "exec")
    code: CodeType | None = _get_code(self, fullname)
    return code


importlib.machinery.SourceFileLoader.get_code = _mutated  # type: ignore[method-assign]
