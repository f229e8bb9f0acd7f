"""What an XCP master may do with a controller."""

from __future__ import annotations

from enum import IntEnum


class XcpAccess(IntEnum):
    """By `meshpoint controller --xcp`."""

    OFF = 0
    READ = 1
    """Measure, and read the settings."""
    WRITE = 2
    """Change settings as well."""
