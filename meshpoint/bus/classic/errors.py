"""What cannot be said on a classic bus."""

from __future__ import annotations


def not_protected(name: str) -> ValueError:
    """A message without a counter has no channel."""
    return ValueError(f"{name} is not a protected message")
