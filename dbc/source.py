"""The DBC file itself, for provenance and for tools that read it with another library."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Final

DBC_PATH: Final = Path(__file__).with_name("meshpoint.dbc")
"""Where the product's DBC is."""

DBC_CONTENT: Final = DBC_PATH.read_bytes()
"""Its bytes, as they were at import."""

DBC_SHA256: Final = hashlib.sha256(DBC_CONTENT).hexdigest()
"""Their SHA-256, hexadecimal."""
