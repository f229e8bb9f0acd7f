"""The version of the product."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def product_version() -> str:
    """The installed version, or `0+source` when run from a source tree that is not installed."""
    try:
        return version("meshpoint")
    except PackageNotFoundError:
        return "0+source"
