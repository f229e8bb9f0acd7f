"""The DBC file of the classic profile."""

from __future__ import annotations

from pathlib import Path
from typing import Final

CLASSIC_DBC: Final = Path(__file__).with_name("meshpoint_classic.dbc")
"""Where it is."""
