"""Copies of a controller, each of which goes on by itself."""

from __future__ import annotations

import copy
from typing import Final, TypeVar

from meshpoint.dbc.layout import CODECS

SHARED: Final = tuple(CODECS.values())
"""What a copy shares with its original: it never changes."""
Whole = TypeVar("Whole")


def copied(whole: Whole, *shared: object) -> Whole:
    """A copy that shares codecs, and what else is named, with its original."""
    return copy.deepcopy(whole, {id(each): each for each in (*SHARED, *shared)})
