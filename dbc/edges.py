"""The messages of the sensor wheels: of each wheel one of rising and one of falling edges."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

from meshpoint.dbc.fields import snake_case
from meshpoint.dbc.layout import CODECS


class EdgeMessages(NamedTuple):
    """Those of one wheel."""

    rise: type[Any]
    fall: type[Any]


EDGES: Final = {
    snake_case(name[len("Edges") : -len("Rise")]): EdgeMessages(
        codec.message_type, CODECS[name.replace("Rise", "Fall")].message_type
    )
    for name, codec in CODECS.items()
    if name.startswith("Edges") and name.endswith("Rise")
}
"""By the wheel's name in the data sheet; in the order of the rig's capture channels."""
EDGE_MESSAGES: Final = tuple(message for both in EDGES.values() for message in both)
"""All of them in that order, of each wheel the rising edges first."""
EDGE_IDS: Final = tuple(CODECS[message.__name__].spec.can_id for message in EDGE_MESSAGES)
"""Their identifiers."""
